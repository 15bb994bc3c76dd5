"""Why: the relative motion of the stiff pair after the instant at which the hypothesis joins its bodies.

All of it is read off the trajectory a solver leaves. The separation of the pair is the integral of its relative
velocity from first touch, v1 - v2 for the balls, v2 for B2 and the table. For solvers with positions it is the gap; the
model has none, and its separation is the one that its velocities imply.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.experiments.hypothesis.cases import BY_KEY, Case, Point
from impact_xval.experiments.sweep.solving import Resolve, answer
from impact_xval.model import Collision
from impact_xval.model.collision import ImpulseCurve

Floats = NDArray[np.float64]

#: The points whose motion is looked at: e1 = 0.9 and e2 = 0.7 where both are free.
POINTS = {
    "zero-apart": Point(5.0, 0.9, 0.7),
    "zero-early": Point(0.5, 0.9, 0.7),
    "zero-late": Point(2 / math.sqrt(3), 0.9, 0.7),
    "infinity": Point(2 / math.sqrt(3), 0.9, 0.7),
    "plastic-ball-ball": Point(2 / math.sqrt(3), math.nan, 0.7, 1.0),
    "plastic-ball-table": Point(2 / math.sqrt(3), 0.9, math.nan, 1.0),
}
CONTRASTS = (1e2, 1e3, 1e4, 1e5)

#: A return of contact within so many half periods of the soft contact is at once.
AT_ONCE = 1e-6

#: Contrasts of engines, and their steps in a period of the stiffer contact.
ENGINE_CONTRASTS, ENGINE_STEPS = (1e2, 1e3), 500


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Relative motion of the stiff pair.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Per half period of the soft contact, pi sqrt(M/k).
    rate : ndarray, shape (n,)
        Relative velocity per abs(v0), positive where the pair separates.
    separation : ndarray, shape (n,)
        Per largest compression of the soft contact.
    loaded : ndarray of bool, shape (n,)
        Whether the stiff contact carries force.
    joined : int or None
        Index of the instant at which the hypothesis joins the pair; None if it never does.
    """

    time: Floats
    rate: Floats
    separation: Floats
    loaded: NDArray[np.bool_]
    joined: int | None


@dataclass(frozen=True, slots=True)
class Mechanism:
    """Numbers of one solver, limit and contrast; NaN where there is nothing to measure.

    Attributes
    ----------
    solver, case : str
    contrast : float
    status, reason : str
    joined : bool
        Whether the instant exists.
    joined_at : float
        When, per half period of the soft contact.
    gap_then : float
        Separation at that instant, per largest compression of the soft contact.
    largest_rate : float
        Largest relative speed after it, per abs(v0).
    largest_gap : float
        Largest separation after it, per largest compression of the soft contact.
    opens : bool
        Whether the stiff contact is open then, or opens later.
    again_after : float
        Time from then to the next collision of the pair; infinite if there is none.
    again_speed : float
        Its speed of approach, per abs(v0).
    """

    solver: str
    case: str
    contrast: float
    status: str
    reason: str = ""
    joined: bool = False
    joined_at: float = math.nan
    gap_then: float = math.nan
    largest_rate: float = math.nan
    largest_gap: float = math.nan
    opens: bool = False
    again_after: float = math.nan
    again_speed: float = math.nan


def motion_of(case: Case, collision: Collision, path: ImpulseCurve) -> Motion:
    """Read the relative motion of the stiff pair off a path.

    The pair is joined at the first return to equal velocities: for the balls at k2/k1 -> 0, after their first
    impact is over; for B2 and the table at k2/k1 -> infinity, at once (v2 = 0); in a plastic limit, at the end of the
    first compression of that contact.
    """
    c = collision
    speed = -c.v0
    finite = np.isfinite(path.time)
    time, v1, v2 = path.time[finite], path.v1[finite] / speed, path.v2[finite] / speed
    state = path.state[finite]
    rate1, rate2 = v1 - v2, v2
    step = np.diff(time, prepend=time[0])

    def integral(rate: Floats) -> Floats:
        return np.cumsum(step * 0.5 * (rate + np.concatenate([rate[:1], rate[:-1]])))

    away = (integral(rate1), integral(rate2))
    carries = (np.isin(state, (1, 3)), np.isin(state, (1, 2)))
    stiff, soft = case.stiff - 1, 2 - case.stiff
    soft_mass, soft_k = (c.m1, c.k1) if soft == 0 else (c.m2, c.k2)
    rate, loaded = (rate1, rate2)[stiff], carries[stiff]
    deepest = float(max(-away[soft].min(), 1e-300))
    joined: int | None = 0
    if case.key != "infinity":
        after = 1
        if not case.plastic:
            apart = np.flatnonzero(~loaded)
            after = int(apart[0]) + 1 if apart.size else len(rate)
        sign = 1.0 if case.plastic else -1.0
        meets = np.flatnonzero((sign * rate[after:] >= 0) & (sign * rate[after - 1 : -1] < 0))
        if meets.size:
            joined = int(meets[0]) + after
            joined -= int(abs(rate[joined - 1]) < abs(rate[joined]) and not loaded[joined])
        else:
            joined = None
    half_period = math.pi * math.sqrt(soft_mass / soft_k)
    return Motion(time / half_period, rate, away[stiff] / deepest, loaded, joined)


def measure(solver: str, case: Case, contrast: float, motion: Motion) -> Mechanism:
    """Measure a motion."""
    start = motion.joined
    if start is None:
        return Mechanism(solver, case.key, contrast, "ok")
    after = slice(start, None)
    loaded = motion.loaded[after]
    opened = np.flatnonzero(~loaded)
    again, again_speed = math.inf, math.nan
    if opened.size:
        back = np.flatnonzero(loaded[opened[0] :])
        if back.size:
            i = start + int(opened[0]) + int(back[0])
            again = float(motion.time[i] - motion.time[start])
            again_speed = float(max(0.0, -motion.rate[max(i - 1, 0)]))
    # The separation that ends the collision grows for ever: it counts only up to the last force.
    carries = np.flatnonzero(motion.loaded)
    end = max(int(carries[-1]) + 1 if carries.size else 0, start + 1)
    return Mechanism(
        solver,
        case.key,
        contrast,
        "ok",
        joined=True,
        joined_at=_crossing(motion, start),
        gap_then=float(motion.separation[start]),
        largest_rate=float(np.abs(motion.rate[after]).max()),
        largest_gap=float(motion.separation[start:end].max()),
        opens=math.isfinite(again) and again > AT_ONCE,
        again_after=again,
        again_speed=again_speed,
    )


def _crossing(motion: Motion, index: int) -> float:
    """Time at which the relative velocity passes zero next to an index."""
    for i in (index, index + 1):
        if 0 < i < motion.rate.size and motion.rate[i - 1] * motion.rate[i] < 0:
            share = motion.rate[i - 1] / (motion.rate[i - 1] - motion.rate[i])
            return float(motion.time[i - 1] + share * (motion.time[i] - motion.time[i - 1]))
    return float(motion.time[index])


def observe(
    solver_name: str, case_key: str, contrast: float, resolve: Resolve = get_solver
) -> tuple[Mechanism, Motion | None]:
    """Solve the point of a case at a contrast with its path, and measure it."""
    case = BY_KEY[case_key]
    collision = Collision.from_ratios(*POINTS[case_key].ratios(case, contrast))
    solver = resolve(solver_name)
    settings = Settings(record_path=True, stiffness_ratio_cutoff=math.inf, mark=False, max_steps=50_000_000)
    if isinstance(solver, EngineSolver):
        settings = replace(settings, step_fraction=1 / ENGINE_STEPS)
    outcome = answer(solver, [collision], settings)[0]
    if outcome.path is None:
        return Mechanism(solver_name, case_key, contrast, outcome.status, outcome.reason or "no path"), None
    motion = motion_of(case, collision, outcome.path)
    return replace(measure(solver_name, case, contrast, motion), status=outcome.status), motion
