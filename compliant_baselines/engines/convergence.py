"""What an engine's velocities tend to as its step goes to zero, and how well that is known: the convergence estimate.

docs/convergence.md says at which steps beside h, the step that a user takes, an engine is run, how velocities are
extrapolated, and what the error is made of. Balls that part for good have v1 >= v2 >= 0: a limit outside means that
they meet once more as the step goes to zero, and is replaced by the nearest point inside, which is what a plastic
meeting makes of it.

What the engine's own regularisation of contacts does to the velocities, no step removes. Where it exceeds the tolerance
at 4h it is measured again at the shortest step, and the step is halved further unless two measures agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_xval.compliant_baselines.engines.scene import Floats, Scene, periods
from impact_xval.compliant_baselines.engines.stepping import Run, parted
from impact_xval.compliant_baselines.solver import Convergence
from impact_xval.compliant_baselines.states import SHORTEST_STATE
from impact_xval.model.chain.record import ChainEnding

#: Share of the last correction that is doubted at least: three differences can agree by accident.
DOUBT = 0.1

#: How many times what the second order changes is doubted, which is a third of the last correction: four runs show one
#: quarter, which can be chance. Of PyBullet's limits in 1,400 random cells at steps of 0.01 of the period six are
#: further off than three stated errors, as many as without a second order.
CHANGE = 2.0

#: Longest step, in the shorter contact period, of four runs that can show a second order: at 0.1 a stiff table's
#: vibration is damped away at all of them alike, and 7 of PyBullet's 194 limits were wrong (2 of 174 by first order).
RESOLVED = 1 / 16

#: Share of the largest correction of a velocity below which those of the others do not tell their order.
SMALL = 0.1

#: Share of what contacts do in their first steps that may be missing from the limit: L takes twice what the shortest
#: step has of it and once what the step before has, either between nothing and all of it.
CHANCE = 0.5

#: Share of what contacts do in their first steps that may differ among three runs, for impulses that are whole at any
#: length of the step. Those of a dashpot are halved with it; rigid engines of single precision differ by 1e-6.
WHOLE = 0.01

#: A limit 2 Vn - V(n-1) takes so many times the change that a meeting which is left may make in each of the two runs.
MEETINGS = 3.0

#: Share of what is left of a parting rate that its last change may be, for a straight line to lead to its limit. Bodies
#: that part slowly do so by what remains of a vibration: the length of a vector, which turns around where it is
#: shortest.
STRAIGHT = 1 / 3

#: How often the last change of a rate counts at most where changes grow; one may follow none at all. Of a vibration
#: that steps damp, x is left at h, x^2 at 2h and x^4 at 4h: for a small x the limit is about as many times the last
#: change away as changes grow.
GROWTH = 100.0

#: How many times the steps that its length asks for a run at a shorter step may take: balls that meet soon at one step
#: may do so after millions of them at another.
PATIENCE = 8

#: Factor within which two measures of a regularisation agree, and a fall of corrections with the quarter expected.
ALIKE = 2.0

#: Runs a scene for at most so many steps.
Follow = Callable[[Scene, int], Run]


@dataclass(frozen=True, slots=True)
class Limit:
    """The limit dt -> 0; velocities and errors in m/s."""

    velocities: tuple[float, ...]
    #: Estimated error of all of them, as the engine's own limit.
    step_error: float
    #: Fitted order of convergence, NaN where there is nothing but rounding.
    order: float
    #: By how much the engine's regularisation moves the velocities.
    regularisation: float
    #: The shortest step, in s; whether there gravity ended in a first flight, and B2 came to rest on the table.
    step: float
    flight: bool
    rest: bool

    @property
    def error(self) -> float:
        """By how much velocities may differ from what the contacts asked for do, in m/s."""
        return self.step_error + self.regularisation

    @property
    def stated(self) -> dict[str, float]:
        """The numbers that are known, as `diagnostics` of an outcome name them."""
        numbers = {f"v{i}_limit": v for i, v in enumerate(self.velocities, 1)} | {
            "limit_error": self.error,
            "regularisation": self.regularisation,
            "finest_step": self.step,
            "order": self.order,
        }
        return {key: value for key, value in numbers.items() if not math.isnan(value)}


def limit_of(
    velocities: Floats,
    touch_doubt: float,
    weights: Sequence[float],
    *,
    table: bool = True,
    alike: bool = True,
    orders: int = 2,
    gravity_doubt: float = 0.0,
) -> tuple[tuple[float, ...], float, float]:
    """Extrapolate final velocities in m/s, shape (n, balls), n >= 3, at steps each half of the one before, to zero.

    `weights` are masses over that of the first ball. `touch_doubt` is what the instants of touching may change, in
    m/s, and `gravity_doubt` what those of a first flight and of the end may. `alike` says that the last two runs pass
    through the same states to the same end, and `orders`, by how many orders it may be extrapolated: 1 or 2. Gives the
    first three of `Limit`.
    """
    limits = 2 * velocities[1:] - velocities[:-1]
    doubt = DOUBT * np.abs(velocities[-1] - velocities[-2])
    if orders == 2 and _of_second_order(np.diff(limits, axis=0)):
        first, limits = limits, (4 * limits[1:] - limits[:-1]) / 3
        doubt = CHANGE * np.abs(limits[-1] - first[-1])
    smooth = np.maximum(np.abs(limits[-1] - limits[-2]), doubt)
    bodies = np.pad(velocities, ((0, 0), (0, 1))) if table else velocities
    rates = np.diff(bodies, axis=1)
    before, last = np.abs(np.diff(rates[-3:], axis=0))
    grown = last / np.maximum(before, last / GROWTH + np.finfo(float).tiny)
    bent = (last > STRAIGHT * np.abs(rates[-1])) | (grown > 1) | (not alike)
    error = max(
        float(smooth.max()),
        float((last * np.maximum(grown, 1))[bent].max(initial=0.0)),
        touch_doubt,
        gravity_doubt,
    )
    inside = parted(limits[-1].tolist(), weights, table)
    moves, order = np.abs(np.diff(velocities, axis=0)).max(axis=1), math.nan
    if np.all(moves > 0):
        order = -float(np.polyfit(np.arange(len(moves)), np.log2(moves), 1)[0])
    return inside, error, order


def _of_second_order(corrections: Floats) -> bool:
    """Whether limits are of second order: the last of their corrections, shape (n, balls), is a quarter of the other.

    A velocity that is hardly corrected both times has no say.
    """
    if len(corrections) < 2:
        return False
    before, last = corrections[-2:] * np.sign(corrections[-1])
    small = (np.abs(before) <= SMALL * np.abs(before).max()) & (last <= SMALL * last.max())
    return bool(np.all(small | ((4 / ALIKE * last <= before) & (before <= 4 * ALIKE * last))))


class _Regularisation:
    """What the engine's regularisation of contacts does to velocities, by runs with `factor` times as much of it."""

    def __init__(self, factor: float | None, tolerance: float) -> None:
        self.factor, self.tolerance = factor or 1.0, tolerance
        #: In m/s, at ever shorter steps; an engine without any has done nothing.
        self.moves = [] if factor else [0.0]

    def measure(self, run: Follow, own: Run, most: int) -> None:
        """Run once more at the step of a run, with more regularisation."""
        more = run(replace(own.scene, regularisation=self.factor), most)
        if more.over:
            moved = np.abs(np.subtract(more.reported, own.reported)).max()
            self.moves.append(float(moved) / (self.factor - 1))

    def doubtful(self) -> bool:
        """Whether what it does is not known, or seems to be more than the tolerance."""
        return not (self.moves and self.moves[-1] <= self.tolerance)

    def settled(self) -> bool:
        """Whether it is more than the tolerance at two lengths of the step alike: what it does no step brings back."""
        if len(self.moves) < 2 or not self.doubtful():
            return False
        before, now = self.moves[-2:]
        return before / ALIKE <= now <= before * ALIKE

    def lets_end(self, limit: Limit | None) -> bool:
        """Whether a limit is known as well as it is asked for, or as any step makes it known."""
        if limit is None or not self.moves:
            return False
        return limit.error <= self.tolerance or self.settled()


def _flight_doubt(before: Run, last: Run) -> float:
    """Bound, in m/s, what gravity does in a contact that a first flight may or may not precede.

    Its lead is extrapolated as velocities are. Where it changes its sign on the way to a step of zero, or is too
    short to tell, the flight is in doubt, and gravity acts in the contact that decides on it or does not.
    """
    (earlier, _), (now, contact), scene = before.lead, last.lead, last.scene
    if not scene.gravity or not math.isfinite(now):
        return 0.0
    limit = 2 * now - earlier
    if now * earlier > 0 and now * limit > 0 and abs(now) > 2 * scene.step:
        return 0.0
    return scene.gravity * 0.5 * periods(scene)[contact]


def _touch_doubt(runs: Sequence[Run]) -> float:
    """Bound in m/s what the instants may change at which contacts are met, and a meeting that is left.

    A dashpot misses a share of its first step, and what it does there shrinks with the step. A rigid contact does all
    it does in its first step, whatever its length: nothing is missing, unless contacts beside one another fall into one
    step, whose impulses then depend on one another, or the engine solves them only to its `World.accuracy`, or gives
    slow ones no restitution.
    """
    left = MEETINGS * max(run.meeting_left for run in runs[-2:])
    starts = [run.starts for run in runs[-3:]]
    changed, last = max(starts) - min(starts), runs[-1]
    if changed <= WHOLE * last.starts:
        return max(changed, last.starts_together, last.accuracy * last.starts, left) + last.dropped
    return max(CHANCE * last.starts, left) + last.dropped


def _extrapolated(runs: Sequence[Run], regularisation: Sequence[float]) -> Limit | None:
    """Find the limit of runs, from the longest step to the shortest; None if they are fewer than three."""
    if len(runs) < 3:
        return None
    last, scene = runs[-1], runs[-1].scene
    paths = [(run.states(SHORTEST_STATE).names(False), run.fall is None, run.end) for run in runs[:-4:-1]]
    resolved = 8 * scene.step <= RESOLVED * min(periods(scene))
    found = limit_of(
        np.array([run.reported for run in runs]),
        _touch_doubt(runs),
        [m / scene.masses[0] for m in scene.masses],
        table=scene.table,
        alike=paths[0] == paths[1],
        orders=2 if paths[0] == paths[1] == paths[2] and resolved else 1,
        gravity_doubt=max(_flight_doubt(runs[-2], last), scene.gravity * scene.step),
    )
    moved = regularisation[-1] if regularisation else 0.0
    return Limit(
        *found,
        moved,
        scene.step,
        flight=last.fall is not None,
        rest=last.end in (ChainEnding.LOWER_SETTLED, ChainEnding.BOTH_SETTLED),
    )


def _percentage(share: float) -> str:
    """Write a share with two digits: ``110 %``, not ``1.1e+02 %``."""
    return f"{float(f'{100 * share:.2g}'):g} %"


def estimate_limit(
    run: Follow, probe: float | None, first: Run, convergence: Convergence, max_steps: int
) -> tuple[Limit | None, str]:
    """Find the limit of a scene, of which `first` is the run, which is over, at the step h that a user takes.

    `probe` is the engine's `regularisation_probe`. A run at a longer step may take as many steps as that at h; one at a
    shorter step `max_steps` as many times more, and no more than `PATIENCE` times what the run at h took. The limit is
    None where too few runs came to an end; the text says why it is not converged, and is empty if it is.
    """
    scene, runs, failure = first.scene, [first], ""
    tolerance = convergence.tolerance * scene.speed
    own = _Regularisation(probe if scene.mapping == "calibrated" else None, tolerance)
    for times in (2, 4):
        longer = run(replace(scene, step=scene.step * times), first.n_steps)
        if not longer.over:
            break
        runs.insert(0, longer)
    if len(runs) == 3 and own.doubtful():
        own.measure(run, runs[0], first.n_steps)
    limit = _extrapolated(runs, own.moves)
    for halved in range(1, convergence.halvings + 1):
        most = min(max_steps, PATIENCE * first.n_steps) * 2**halved
        if not own.lets_end(limit) and own.doubtful():
            # Beside a grazing a probe at a long step may show what is the step's.
            own.measure(run, runs[-1], most)
            limit = _extrapolated(runs, own.moves)
        if own.lets_end(limit):
            break
        shorter = run(replace(scene, step=scene.step / 2**halved), most)
        if not shorter.over:
            failure = f"at a step of {shorter.scene.step:.3g} s: {shorter.problem()}"
            break
        runs.append(shorter)
        limit = _extrapolated(runs, own.moves)
    if limit is None:
        why = failure or "runs at longer steps take more of them than that at h, or come to no end"
        return None, f"how v changes as the step is halved is not known: {why}"
    if limit.error <= tolerance:
        return limit, ""
    error, allowed, left = (
        _percentage(each / scene.speed) for each in (limit.error, tolerance, limit.regularisation)
    )
    why = ""
    if own.settled():
        why = f"the engine softens contacts by itself, which changes v by {left}"
    elif runs[-1].dropped > tolerance:
        why = "the engine gives slow impacts no restitution"
    if why:
        return limit, (
            f"v is off by up to {error} of |v0|, more than the {allowed} that are allowed, and halving the step does "
            f"not help: {why}"
        )
    failed = f" ({failure})" if failure else ""
    return limit, (
        f"halving the step may still change v by {error} of |v0|, more than the {allowed} that are allowed; the "
        f"shortest step tried is {limit.step:.3g} s{failed}"
    )
