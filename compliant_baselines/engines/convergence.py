"""The limit of an engine's velocities as the length of its time steps goes to zero, and the error of this limit.

docs/convergence.md says at which step lengths an engine runs in addition to the user's step length h, how velocities
are extrapolated, and which terms the error has. In this module "step" without further words is the length of the time
steps of a run. Balls that part for good have v1 >= v2 >= 0. If an extrapolated limit does not satisfy this, the balls
meet once more as the step goes to zero. The limit is then replaced by the nearest velocities that satisfy it, which are
those after a plastic meeting.

Some engines soften contacts by a regularisation, which changes velocities however short the step is. The change is
measured at the longest step, 4h. If it exceeds the tolerance there, it is measured again at the shortest step so far.
If the two measurements differ, the step is halved further.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from impact_xval.compliant_baselines.engines.plane_run import PlaneRun, project_to_parting
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, periods
from impact_xval.compliant_baselines.engines.stepping import Run, project_to_separated
from impact_xval.compliant_baselines.solver import Convergence
from impact_xval.compliant_baselines.states import SHORTEST_STATE

#: Factor on the last change of velocities. The product is the least error that is stated for a limit of first order.
#: Three changes can agree by accident, and the extrapolated limits then seem not to differ.
DOUBT = 0.1

#: Factor on the change of the limit when a second order is extrapolated. The product is stated as an error of the
#: limit. The change is a third of the last correction. Four runs show the ratio of a quarter, which second order has,
#: only once, and this can be chance. Measured on PyBullet's limits in 1,400 random cells at steps of 0.01 of the
#: period: six limits are wrong by more than three stated errors, as many as without a second order.
CHANGE = 2.0

#: Longest step, over the shorter contact period, of four runs that can show a second order. At a step of 0.1 all four
#: runs damp the vibration of a stiff table completely. Then 7 of PyBullet's 194 limits were wrong, against 2 of 174
#: limits of first order.
RESOLVED = 1 / 16

#: Fraction of the largest correction of all velocities. Corrections that are smaller than this fraction are not used to
#: find the order of convergence.
SMALL = 0.1

#: Factor on the velocity changes in the first time step of each contact. The product is stated as an error of the
#: limit. The limit is twice the velocity at the shortest step minus the velocity at twice this step. Each of these two
#: velocities may contain any part of the changes, from nothing to all.
CHANCE = 0.5

#: Largest relative difference of the velocity changes in the first time steps of contacts at which three runs are taken
#: as equal. Equal changes show that impulses do not depend on the step: rigid engines in single precision differ by
#: 1e-6. With a dashpot, the impulse in a first time step is halved when the step is halved.
WHOLE = 0.01

#: Factor by which extrapolation enlarges errors. If each of the last two runs Vn and V(n-1) is wrong by at most x, then
#: their limit 2 Vn - V(n-1) is wrong by at most this factor times x.
MEETINGS = 3.0

#: Largest change of a speed of separation between the last two runs, over this speed, with which the limit may be taken
#: from a straight line through both runs. Bodies that part slowly have the speed that is left of a vibration. This
#: speed is the length of a vector, which is not a linear function of the step where it is smallest.
STRAIGHT = 1 / 3

#: Largest factor on the last change of a rate, whose product with this change is stated as error if changes grow from
#: run to run. If time steps of length h damp a vibration to the fraction x, then x^2 is left at 2h and x^4 at 4h. For a
#: small x the distance to the limit, over the last change, is about the factor by which the changes grow. This factor
#: is bounded here, because the change before the last may be zero.
GROWTH = 100.0

#: Largest number of time steps of a run at a shorter step, over the number to be expected from the run at h. Balls that
#: meet soon at one step length may meet after millions of time steps at another step length.
PATIENCE = 8

#: Factor within which two numbers are taken as equal. The numbers are two measurements of a regularisation, or a ratio
#: of corrections and a quarter.
ALIKE = 2.0

#: Part of the reason of an unknown limit, if shorter steps would not help.
NO_HELP = "halving the step does not help"

#: A run of a scene in a line or in a plane.
AnyRun = TypeVar("AnyRun", Run, PlaneRun)

#: Function that runs a scene for at most a given number of time steps.
Follow = Callable[[Scene, int], AnyRun]


@dataclass(frozen=True, slots=True)
class Limit:
    """The limit of velocities as the step goes to zero; velocities and errors are in m/s."""

    velocities: tuple[float, ...]
    #: Estimated error of the velocities by the step, without the effect of the engine's regularisation.
    step_error: float
    #: Order of convergence, fitted to the runs; NaN if some runs do not differ.
    order: float
    #: Largest change of a velocity by the engine's regularisation of contacts.
    regularisation: float
    #: Step in s of the run with the shortest step.
    step: float
    #: True if gravity ended in a first flight in the run with the shortest step.
    has_first_flight: bool
    #: True if B2 settled on the table in the run with the shortest step.
    b2_settled: bool

    @property
    def error(self) -> float:
        """Bound in m/s on the error of these velocities, compared with the contacts that were asked for."""
        return self.step_error + self.regularisation

    @property
    def diagnostics(self) -> dict[str, float]:
        """Velocities and accuracy of this limit, under their names in `Outcome.diagnostics`."""
        return {f"v{i}_limit": v for i, v in enumerate(self.velocities, 1)} | self.quality

    @property
    def quality(self) -> dict[str, float]:
        """Accuracy of this limit, under the names in `Outcome.diagnostics`; unknown values are left out."""
        numbers = {
            "limit_error": self.error,
            "regularisation": self.regularisation,
            "finest_step": self.step,
            "order": self.order,
        }
        return {key: value for key, value in numbers.items() if not math.isnan(value)}


class Extrapolation(NamedTuple):
    """Velocities extrapolated to a step of zero; the fields are explained in `Limit`."""

    velocities: tuple[float, ...]
    step_error: float
    order: float


class Parting(NamedTuple):
    """Two functions of velocities in m/s, which say whether and how the bodies of a scene part."""

    #: Function that returns the speeds of separation of all contacts in m/s, shape (n, contacts), from velocities of
    #: the shape (n, N axes).
    rates: Callable[[Floats], Floats]
    #: Function that returns the nearest velocities at which no bodies in contact approach, shape (N axes,).
    project: Callable[[Floats], tuple[float, ...]]


def parting_in_line(masses: Sequence[float], table: bool = True) -> Parting:
    """Return the `Parting` of balls in a line; `table` says if there is a table below the last ball.

    The unit of the masses does not matter.
    """

    def rates(velocities: Floats) -> Floats:
        return np.diff(np.pad(velocities, ((0, 0), (0, 1))) if table else velocities, axis=1)

    def project(velocities: Floats) -> tuple[float, ...]:
        return project_to_separated(velocities.tolist(), masses, table)

    return Parting(rates, project)


def parting_of(scene: Scene) -> Parting:
    """Return the `Parting` of the bodies of a scene."""
    if scene.graph is None:
        return parting_in_line([m / scene.masses[0] for m in scene.masses], scene.table)
    J = scene.graph.jacobian

    def rates(velocities: Floats) -> Floats:
        return -(velocities @ J.T)

    def project(velocities: Floats) -> tuple[float, ...]:
        return tuple(project_to_parting(velocities, scene).tolist())

    return Parting(rates, project)


def extrapolate(
    velocities: Floats,
    touch_doubt: float,
    parting: Parting,
    *,
    same_states: bool = True,
    orders: int = 2,
    gravity_doubt: float = 0.0,
) -> Extrapolation:
    """Extrapolate final velocities to a step of zero.

    Parameters
    ----------
    velocities
        Final velocities in m/s of n >= 3 runs, shape (n, N axes). Each run has half the step of the run before.
    touch_doubt
        Bound in m/s on how much velocities depend on the instants within a step at which contacts touch
        (`_touch_doubt`).
    parting
        Conditions under which the bodies part.
    same_states
        True if the last two runs pass through the same states and end in the same way.
    orders
        Number of orders that may be extrapolated: 1 or 2.
    gravity_doubt
        Bound in m/s on how much velocities depend on the instants within a step at which gravity and the collision end.
    """
    limits = 2 * velocities[1:] - velocities[:-1]
    doubt = DOUBT * np.abs(velocities[-1] - velocities[-2])
    if orders == 2 and _are_of_second_order(np.diff(limits, axis=0)):
        first_order, limits = limits, (4 * limits[1:] - limits[:-1]) / 3
        doubt = CHANGE * np.abs(limits[-1] - first_order[-1])
    smooth_error = np.maximum(np.abs(limits[-1] - limits[-2]), doubt)
    rates = parting.rates(velocities)
    before, last = np.abs(np.diff(rates[-3:], axis=0))
    growth = last / np.maximum(before, last / GROWTH + np.finfo(float).tiny)
    bent = (last > STRAIGHT * np.abs(rates[-1])) | (growth > 1) | (not same_states)
    error = max(
        float(smooth_error.max()),
        float((last * np.maximum(growth, 1))[bent].max(initial=0.0)),
        touch_doubt,
        gravity_doubt,
    )
    inside = parting.project(limits[-1])
    moves, order = np.abs(np.diff(velocities, axis=0)).max(axis=1), math.nan
    if np.all(moves > 0):
        steps = np.arange(len(moves), dtype=np.float64)
        logs: Floats = np.log2(moves)
        order = -float(np.polyfit(steps, logs, 1)[0])
    return Extrapolation(inside, error, order)


def _are_of_second_order(corrections: Floats) -> bool:
    """Return True if limits converge at second order: their last correction is a quarter of the one before.

    `corrections` are the differences of successive limits, shape (n, balls). A velocity is ignored if both of its last
    corrections are small.
    """
    if len(corrections) < 2:
        return False
    before, last = corrections[-2:] * np.sign(corrections[-1])
    small = (np.abs(before) <= SMALL * np.abs(before).max()) & (last <= SMALL * last.max())
    quarter = (4 / ALIKE * last <= before) & (before <= 4 * ALIKE * last)
    return bool(np.all(small | quarter))


class _Regularisation:
    """Measurements of how the engine's regularisation of contacts changes velocities."""

    def __init__(self, factor: float | None, tolerance: float) -> None:
        #: Factor by which a second run has more regularisation.
        self.factor = factor or 1.0
        #: Allowed error of velocities in m/s.
        self.tolerance = tolerance
        #: Measured changes of velocities in m/s, from longer to shorter steps; 0 for an engine without regularisation.
        self.moves = [] if factor else [0.0]

    def measure(self, follow: Follow[AnyRun], base: AnyRun, max_steps: int) -> None:
        """Run a scene again with more regularisation, and record how the velocities of the run `base` change."""
        more = follow(replace(base.scene, regularisation=self.factor), max_steps)
        if more.over:
            moved = np.abs(np.subtract(more.reported, base.reported)).max()
            self.moves.append(float(moved) / (self.factor - 1))

    def is_doubtful(self) -> bool:
        """Return True if the change by the regularisation is unknown, or exceeds the tolerance."""
        return not (self.moves and self.moves[-1] <= self.tolerance)

    def stays(self) -> bool:
        """Return True if the change by the regularisation exceeds the tolerance and is the same at two step lengths.

        Then no shorter step makes it smaller.
        """
        if len(self.moves) < 2 or not self.is_doubtful():
            return False
        before, now = self.moves[-2:]
        return before / ALIKE <= now <= before * ALIKE

    def is_enough(self, limit: Limit | None) -> bool:
        """Return True if a limit has the requested accuracy, or if shorter steps cannot improve it."""
        if limit is None or not self.moves:
            return False
        return limit.error <= self.tolerance or self.stays()


def _flight_doubt(before: AnyRun, last: AnyRun) -> float:
    """Return a bound in m/s on how much gravity changes velocities if it is in doubt whether the first flight happens.

    The lead of a flight is the time by which a gap closes after the flight has begun, or before it would have begun. It
    is extrapolated to a step of zero as velocities are. The flight is in doubt if the lead changes its sign on the way,
    or is too short to have a clear sign. A contact ends or prevents the flight when its gap closes. In this contact
    gravity then may or may not act.
    """
    earlier, (now, contact), scene = before.flight_lead.time, last.flight_lead, last.scene
    if not scene.gravity or not math.isfinite(now):
        return 0.0
    limit = 2 * now - earlier
    same_sign = now * earlier > 0 and now * limit > 0
    if same_sign and abs(now) > 2 * scene.step:
        return 0.0
    return scene.gravity * 0.5 * periods(scene)[contact]


def _touch_doubt(runs: Sequence[AnyRun]) -> float:
    """Return a bound in m/s on how much velocities change by the instants of touch, and by a meeting yet to come.

    A dashpot misses a part of its first step, and the impulse of this step shrinks with the step. A rigid contact gives
    its whole impulse in its first step, whatever the step's length. So nothing is missing. There are three exceptions.
    Neighbouring contacts may begin in the same step, and their impulses then depend on one another. The engine may
    solve contacts only to its `World.accuracy`. Or the engine gives slow contacts no restitution.

    In a plane normals turn, and impulses turn with them. The change is at most the angle times the speed.
    """
    meeting_left = MEETINGS * max(run.meeting_left for run in runs[-2:])
    turning = max(run.turning for run in runs[-2:]) * runs[-1].scene.speed
    return turning + _start_doubt(runs, meeting_left)


def _start_doubt(runs: Sequence[AnyRun], meeting_left: float) -> float:
    """Return a bound in m/s on how much the first time steps of contacts change velocities; at least `meeting_left`.

    `meeting_left` is the bound in m/s on the change by a meeting that is still to come.
    """
    starts = [run.starts for run in runs[-3:]]
    changed, last = max(starts) - min(starts), runs[-1]
    if changed <= WHOLE * last.starts:
        inaccurate = last.accuracy * last.starts
        return max(changed, last.starts_together, inaccurate, meeting_left) + last.dropped
    return max(CHANCE * last.starts, meeting_left) + last.dropped


def _limit_of(runs: Sequence[AnyRun], regularisation: Sequence[float]) -> Limit | None:
    """Return the limit of runs, given from the longest step to the shortest; None if there are fewer than three.

    `regularisation` are the measured changes of velocities in m/s by the engine's regularisation.
    """
    if len(runs) < 3:
        return None
    last, scene = runs[-1], runs[-1].scene
    courses = [
        (run.merged_states(SHORTEST_STATE).names(False), run.first_flight is None, run.end)
        for run in runs[:-4:-1]
    ]
    resolved = 8 * scene.step <= RESOLVED * min(periods(scene))
    extrapolation = extrapolate(
        np.array([run.reported for run in runs]),
        _touch_doubt(runs),
        parting_of(scene),
        same_states=courses[0] == courses[1],
        orders=2 if courses[0] == courses[1] == courses[2] and resolved else 1,
        gravity_doubt=max(_flight_doubt(runs[-2], last), scene.gravity * scene.step),
    )
    return Limit(
        *extrapolation,
        regularisation=regularisation[-1] if regularisation else 0.0,
        step=scene.step,
        has_first_flight=last.first_flight is not None,
        b2_settled=last.b2_settled,
    )


def _percentage(share: float) -> str:
    """Return a fraction as a percentage with two digits: ``110 %``, not ``1.1e+02 %``."""
    return f"{float(f'{100 * share:.2g}'):g} %"


def estimate_limit(
    follow: Follow[AnyRun], probe: float | None, first: AnyRun, convergence: Convergence, max_steps: int
) -> tuple[Limit | None, str]:
    """Find the limit of a scene's velocities, from runs at longer and shorter steps.

    Parameters
    ----------
    follow
        Function that runs a scene.
    probe
        The engine's `regularisation_probe`.
    first
        The finished run at the user's step h.
    convergence
        Requested accuracy of the limit, and largest number of halvings.
    max_steps
        Largest number of time steps of the run at h and of runs at longer steps. A run at the step h/n may take n times
        this number. It may also take at most n `PATIENCE` times the number of time steps of the run at h.

    Returns
    -------
    tuple
        The limit, or None if too few runs came to an end; and the reason why the limit is not converged, or ``""``.
    """
    scene, runs, failure = first.scene, [first], ""
    tolerance = convergence.tolerance * scene.speed
    regularisation = _Regularisation(probe if scene.mapping == "calibrated" else None, tolerance)
    for multiple in (2, 4):
        longer = follow(replace(scene, step=scene.step * multiple), first.n_steps)
        if not longer.over:
            break
        runs.insert(0, longer)
    if len(runs) == 3 and regularisation.is_doubtful():
        regularisation.measure(follow, runs[0], first.n_steps)
    limit = _limit_of(runs, regularisation.moves)
    for halvings in range(1, convergence.halvings + 1):
        most = min(max_steps, PATIENCE * first.n_steps) * 2**halvings
        if not regularisation.is_enough(limit) and regularisation.is_doubtful():
            # Near a grazing touch, a run at a long step may measure the error of the step instead. So it is measured
            # again here.
            regularisation.measure(follow, runs[-1], most)
            limit = _limit_of(runs, regularisation.moves)
        if regularisation.is_enough(limit):
            break
        shorter = follow(replace(scene, step=scene.step / 2**halvings), most)
        if not shorter.over:
            failure = f"at a step of {shorter.scene.step:.3g} s: {shorter.problem()}"
            break
        runs.append(shorter)
        limit = _limit_of(runs, regularisation.moves)
    if limit is None:
        why = failure or "runs at longer steps take more of them than that at h, or come to no end"
        return None, f"how v changes as the step is halved is not known: {why}"
    if limit.error <= tolerance:
        return limit, ""
    return limit, _why_unconverged(limit, tolerance, scene.speed, runs[-1], regularisation.stays(), failure)


def _why_unconverged(
    limit: Limit, tolerance: float, speed: float, last: AnyRun, regularisation_stays: bool, failure: str
) -> str:
    """Return the reason why the error of a limit exceeds a tolerance in m/s.

    `failure` is the reason why the run at the next shorter step failed, or ``""``.
    """
    error, allowed = _percentage(limit.error / speed), _percentage(tolerance / speed)
    cause = ""
    if regularisation_stays:
        softens = _percentage(limit.regularisation / speed)
        cause = f"the engine softens contacts by itself, which changes v by {softens}"
    elif last.dropped > tolerance:
        cause = "the engine gives slow impacts no restitution"
    if cause:
        return f"v is off by up to {error} of |v0|, more than the {allowed} that are allowed, and {NO_HELP}: {cause}"
    failed = f" ({failure})" if failure else ""
    return (
        f"halving the step may still change v by {error} of |v0|, more than the {allowed} that are allowed; the "
        f"shortest step with an answer is {limit.step:.3g} s{failed}"
    )
