"""Why: the relative motion of the stiff pair after the instant at which the hypothesis joins its bodies.

**In time.** All of it is read off the trajectory of a solver. The separation of the pair is the integral of its
relative velocity from first touch, v1 - v2 for the balls, v2 for B2 and the table. For solvers with positions it is the
gap; the model has none, and its separation is the one that its velocities imply.

**Where the model has no limit**: e1 = 1 and e2 < 1, united while the table contact is compressed.
Once the balls are united (v1 = v2 at the return of contact 1) an elastic ball-ball contact rings for ever. With
s = F2 at the return and F = F2 at the end of compression of contact 2, both per the same unit, the velocity of B2 about
the latter instant is

    (m1 + m2) v2' = F + (m1 s/m2) cos(tau),    tau = omega1 t + phase,    omega1 -> infinity,

since the ring starts from rest under the relative acceleration s/m2 and never loses any of it. So v2 rises through zero
as tau + q sin(tau) through a level given by the phase, and for q = m1 s/(m2 F) > 1 it may do so several times. Every
rise is an end of compression, which leaves e2^2 of the energy of contact 2: after n of them the balls have e2^(n-1)
times the velocity of the closed form. The phase is that of omega1 times a time that does not depend on k2/k1: as
k2/k1 -> 0 it takes every value equally often, and the outcome has no limit. By the supplement's E22 and E2max, at
e1 = 1,

    q^2 = (3 - m2)/(m2 (1 + m2))   (m1 = 1),

which exceeds 1 exactly where m2 < 1, that is in the whole regime.

How often n occurs: tau + q sin(tau) falls once in a period, by 2 pi r with

    r = (sqrt(q^2 - 1) - arccos(1/q))/pi,

and the next fall is the same one, 2 pi higher. So a level is passed downwards by r falls in the mean, the whole part of
r or one more of them depending on the phase, and upwards once more than downwards. n therefore occurs in the share
1 - |n - 1 - r| of the phases, or never where that is negative. For m2 > 0.121 (q < 4.603, r < 1) n is 1 or 2, and r is
the share of the second; a lighter B2 always makes two ends or more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.answers import answer, said
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.hypothesis.cases import BY_KEY, Case, Point, distance
from impact_xval.experiments.hypothesis.solvers import MAX_STEPS, model_batch
from impact_xval.experiments.sweep.rows import Resolve
from impact_xval.model import Collision
from impact_xval.model.collision import Path

Floats = NDArray[np.float64]

#: Contrasts over which the outcomes of the model without a limit are counted, and how many.
RANGE, COUNT = (1e4, 1e6), 1500

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

    @property
    def at_once(self) -> bool:
        """Whether the pair collides again within no time to speak of."""
        return self.again_after <= AT_ONCE

    def rate_since(self, low: Mechanism) -> float:
        """Rate at which the largest relative speed falls with the contrast, from a lower one; NaN if it has none."""
        if not (low.joined and low.largest_rate > 0 < self.largest_rate and low.contrast < self.contrast):
            return math.nan
        return -math.log(self.largest_rate / low.largest_rate) / math.log(self.contrast / low.contrast)


def motion_of(case: Case, collision: Collision, path: Path) -> Motion:
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
    rates = (v1 - v2, v2)
    step = np.diff(time, prepend=time[0])

    def integral(rate: Floats) -> Floats:
        return np.cumsum(step * 0.5 * (rate + np.concatenate([rate[:1], rate[:-1]])))

    away = [integral(rate) for rate in rates]
    carries = (np.isin(state, (1, 3)), np.isin(state, (1, 2)))
    stiff, soft = case.stiff - 1, 2 - case.stiff
    soft_mass, soft_k = (c.m1, c.k1) if soft == 0 else (c.m2, c.k2)
    rate, loaded = rates[stiff], carries[stiff]
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
    settings = Settings(record_path=True, stiffness_ratio_cutoff=math.inf, mark=False, max_steps=MAX_STEPS)
    if isinstance(solver, Engine):
        settings = replace(settings, step_fraction=1 / ENGINE_STEPS)
    outcome = answer(solver, [collision], settings)[0]
    if outcome.path is None:
        return Mechanism(solver_name, case_key, contrast, outcome.status, outcome.reason or "no path"), None
    try:
        motion = motion_of(case, collision, outcome.path)
        return replace(measure(solver_name, case, contrast, motion), status=outcome.status), motion
    except Exception as error:  # a path that is none of such a collision
        return Mechanism(
            solver_name, case_key, contrast, "crashed", f"measuring its path: {said(error)}"
        ), None


@dataclass(frozen=True, slots=True)
class Branches:
    """Outcomes of the model at a point over many contrasts, sorted by the ends of compression of contact 2.

    Attributes
    ----------
    point : Point
    predicted : float
        Share of contrasts with two ends of compression, from `end_share`.
    measured : float
        Share of outcomes at e2 times the closed form.
    uncertainty : float
        95 % half-width of that share, binomial.
    elsewhere : float
        Share of outcomes after neither one nor two ends of compression: after more, or lost.
    once : float
        Velocity after one end of compression, per abs(v0).
    """

    point: Point
    predicted: float
    measured: float
    uncertainty: float
    elsewhere: float
    once: float

    @property
    def more_ends(self) -> int:
        """Ends of compression that every outcome has beyond the first."""
        return math.floor(mean_more_ends(self.point.mass_ratio))


def mean_more_ends(mass_ratio: float) -> float:
    """Mean of n - 1, r above, over the phases at e1 = 1: n is the whole part of r and one, or two, more."""
    mu = mass_ratio
    if mu >= 1:
        return 0.0
    q = math.sqrt((3 - mu) / (mu * (1 + mu)))
    return (math.sqrt(q * q - 1) - math.acos(1 / q)) / math.pi


def end_share(mass_ratio: float, n: int) -> float:
    """Share of phases with n ends of compression at e1 = 1, neither more nor fewer."""
    r = mean_more_ends(mass_ratio)
    return max(0.0, 1 - abs(n - 1 - r))


def count_branches(point: Point, seed: int) -> Branches:
    """Solve the model at many contrasts, drawn at random, and sort the outcomes."""
    rng = np.random.default_rng(seed)
    x = np.exp(rng.uniform(np.log(RANGE[0]), np.log(RANGE[1]), COUNT))
    mu, e2 = point.mass_ratio, point.e2
    mass, first, second = (np.full(COUNT, value) for value in (mu, point.e1, e2))
    found = model_batch(1 / x, mass, first, second)
    once = e2 / math.sqrt(1 + mu)  # the closed form at e1 = 1
    near = [distance(mu, found.v1 - v, found.v2 - v) < 0.1 * (1 - e2) * once for v in (once, e2 * once)]
    share = float(np.mean(near[1]))
    half = 1.96 * math.sqrt(max(share * (1 - share), 0.25 / COUNT) / COUNT)
    lost = float(np.mean(~(near[0] | near[1])))
    return Branches(point, end_share(mu, 2), share, half, lost, once)
