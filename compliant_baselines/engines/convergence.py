"""What an engine's velocities tend to as its step goes to zero, and how well that is known: the convergence estimate.

docs/convergence.md says at which steps beside h, the step that a user takes, an engine is run, how velocities are
extrapolated, and what the error is made of. Balls that part for good have v1 >= v2 >= 0: a limit outside means that
they meet once more as the step goes to zero, and is replaced by the nearest point inside, which is what a plastic
meeting makes of it.

What the engine's own regularisation of contacts does to the velocities, which no step removes, is measured by one more
run at 4h with `probe` times as much of it; it is of first order in the regularisation. Where it exceeds the tolerance
it is measured again at the shortest step, and the step is halved further unless two measures agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_xval.compliant_baselines.engines.scene import Floats, Scene
from impact_xval.compliant_baselines.engines.stepping import Run
from impact_xval.compliant_baselines.solver import Convergence
from impact_xval.compliant_baselines.states import SHORTEST_STATE
from impact_xval.model.chain.rest import REST, STUCK

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


@dataclass(frozen=True, slots=True)
class Limit:
    """The limit dt -> 0; velocities and errors in m/s."""

    velocities: tuple[float, ...]
    #: Estimated error of all of them, as the engine's own limit, and by how much its regularisation moves them.
    step_error: float
    regularisation: float
    #: Fitted order of convergence, NaN where there is nothing but rounding, and the shortest step, in s.
    order: float
    step: float
    #: Whether at that step gravity ended in a first flight, and whether B2 came to rest on the table.
    flight: bool = False
    rest: bool = False

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


def parted(velocities: Sequence[float], weights: Sequence[float], table: bool = True) -> tuple[float, ...]:
    """Nearest velocities with v1 >= v2 >= ..., and >= 0 on a table, in the kinetic norm; `weights` are masses.

    Neighbours in the wrong order are pooled until none are (isotonic regression).
    """
    pools: list[tuple[float, float, int]] = []
    for velocity, weight in zip(velocities, weights, strict=True):
        v, w, n = velocity, weight, 1
        while pools and v > pools[-1][0]:
            above, mass, count = pools.pop()
            v, w, n = (mass * above + w * v) / (mass + w), mass + w, n + count
        pools.append((v, w, n))
    return tuple(max(v, 0.0) if table else v for v, _, n in pools for _ in range(n))


def limit_of(
    velocities: Floats,
    starts: float,
    step: float,
    weights: Sequence[float],
    regularisation: float = 0.0,
    *,
    table: bool = True,
    alike: bool = True,
    orders: int = 2,
    gravity_doubt: float = 0.0,
) -> Limit:
    """Extrapolate final velocities in m/s, shape (n, balls), n >= 3, at steps each half of the one before, to zero.

    Of the last run are `Run.starts` in m/s and the step in s; weights are masses over that of the first ball. In m/s is
    also what regularisation does, and `gravity_doubt`, what the instants of a first flight and of the end may change.
    `alike` says that the last two runs pass through the same states to the same end, and `orders`, by how many orders
    it may be extrapolated: 1 or 2.
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
        CHANCE * abs(starts),
        gravity_doubt,
    )
    inside = parted(limits[-1].tolist(), weights, table)
    moves, order = np.abs(np.diff(velocities, axis=0)).max(axis=1), math.nan
    if np.all(moves > 0):
        order = -float(np.polyfit(np.arange(len(moves)), np.log2(moves), 1)[0])
    return Limit(inside, error, regularisation, order, step)


def _of_second_order(corrections: Floats) -> bool:
    """Whether limits are of second order: the last of their corrections, shape (n, balls), is a quarter of the other.

    A velocity that is hardly corrected both times has no say.
    """
    if len(corrections) < 2:
        return False
    before, last = corrections[-2:] * np.sign(corrections[-1])
    small = (np.abs(before) <= SMALL * np.abs(before).max()) & (last <= SMALL * last.max())
    return bool(np.all(small | ((4 / ALIKE * last <= before) & (before <= 4 * ALIKE * last))))


class _Case:
    """A scene on its way to its limit: its runs, from the longest step to the shortest (`estimate_limit`)."""

    def __init__(
        self,
        run: Callable[[Scene, int], Run],
        probe: float | None,
        first: Run,
        convergence: Convergence,
        max_steps: int,
    ) -> None:
        self.run, self.runs, self.convergence, self.max_steps = run, [first], convergence, max_steps
        #: At the step h, and the steps that the run took there: those that one at a longer step may take.
        self.scene, self.longest = first.scene, first.n_steps
        #: Largest error, in m/s.
        self.tolerance = convergence.tolerance * self.scene.speed
        #: How many times as much regularisation shows what that of the engine does; 1 where there is none to see.
        self.factor = probe if probe and self.scene.mapping == "calibrated" else 1.0
        #: What regularisation was seen to do, in m/s, at ever shorter steps.
        self.regularisation: list[float] = []
        self.failure = ""
        #: What is known of the limit by now.
        self.limit: Limit | None = None

    def at(self, times: float) -> Scene:
        """Return the scene at a multiple of the step h."""
        return replace(self.scene, step=self.scene.step * times)

    @property
    def shortest(self) -> float:
        """Shortest step over h."""
        return self.runs[-1].scene.step / self.scene.step

    @property
    def most(self) -> int:
        """Steps that the run at the next shorter step may take."""
        return round(min(self.max_steps, PATIENCE * self.longest) * 2 / self.shortest)

    def approach(self) -> None:
        """Run at the steps that the limit needs."""
        for times in (2, 4):
            longer = self.run(self.at(times), self.longest)
            if not longer.over:
                break
            self.runs.insert(0, longer)
        if len(self.runs) == 3:
            self.probe(self.runs[0], self.longest)
        self.extrapolate()
        while self.wants_more():
            if self.doubtful():  # beside a grazing a probe at a long step may show what is the step's
                self.probe(self.runs[-1], self.most)
                self.extrapolate()
                if not self.wants_more():
                    break
            shorter = self.run(self.at(self.shortest / 2), self.most)
            if shorter.over:
                self.runs.append(shorter)
                self.extrapolate()
            else:
                self.failure = f"at a step of {shorter.scene.step:.3g} s: {shorter.problem()}"

    def extrapolate(self) -> None:
        """Find the limit, where there are three runs."""
        if len(self.runs) < 3:
            return
        last = self.runs[-1]
        paths = [
            (run.states(SHORTEST_STATE).names(False), run.fall is None, run.end) for run in self.runs[:-4:-1]
        ]
        resolved = 8 * last.scene.step <= RESOLVED * min(self.scene.periods)
        limit = limit_of(
            np.array([run.reported for run in self.runs]),
            last.starts,
            last.scene.step,
            [m / self.scene.masses[0] for m in self.scene.masses],
            *self.regularisation[-1:],
            table=self.scene.table,
            alike=paths[0] == paths[1],
            orders=2 if paths[0] == paths[1] == paths[2] and resolved else 1,
            gravity_doubt=max(self.flight_doubt(), self.scene.gravity * last.scene.step),
        )
        self.limit = replace(limit, flight=last.fall is not None, rest=last.end in (REST, STUCK))

    def flight_doubt(self) -> float:
        """Bound, in m/s, what gravity does in a contact that a first flight may or may not precede.

        Its lead is extrapolated as velocities are. Where it changes its sign on the way to a step of zero, or is too
        short to tell, the flight is in doubt, and gravity acts in the contact that decides on it or does not.
        """
        (before, _), (now, contact) = (run.lead for run in self.runs[-2:])
        if not self.scene.gravity or not math.isfinite(now):
            return 0.0
        limit = 2 * now - before
        if now * before > 0 and now * limit > 0 and abs(now) > 2 * self.runs[-1].scene.step:
            return 0.0
        return self.scene.gravity * 0.5 * self.scene.periods[contact]

    def probe(self, own: Run, most: int) -> None:
        """See what regularisation does by a run with more of it, beside one of the same step with the engine's own."""
        if self.factor > 1:
            run = self.run(replace(own.scene, regularisation=self.factor), most)
            if run.over:
                moved = np.abs(np.subtract(run.reported, own.reported)).max()
                self.regularisation.append(float(moved) / (self.factor - 1))

    def wants_more(self) -> bool:
        """Whether a shorter step is to be run."""
        if self.failure or self.shortest <= 2.0**-self.convergence.halvings:
            return False
        if self.limit is None or (self.factor > 1 and not self.regularisation):
            return True
        return self.limit.error > self.tolerance and not self.settled()

    def doubtful(self) -> bool:
        """Whether what regularisation leaves is not known, or seems to be more than the tolerance."""
        return self.factor > 1 and not (self.regularisation and self.regularisation[-1] <= self.tolerance)

    def settled(self) -> bool:
        """Whether it does so at two lengths of the step alike: what it leaves no step brings back."""
        if len(self.regularisation) < 2 or self.regularisation[-1] <= self.tolerance:
            return False
        before, now = self.regularisation[-2:]
        return before / ALIKE <= now <= before * ALIKE

    def problem(self) -> str:
        """Why the limit does not satisfy; nothing if it does."""
        limit, speed = self.limit, self.scene.speed
        if limit is None:
            why = self.failure or "runs at longer steps take more of them than that at h, or come to no end"
            return f"no limit dt -> 0: {why}"
        if limit.error <= self.tolerance:
            return ""
        text = (
            f"the limit dt -> 0 is known to {limit.error / speed:.1e} of |v0|, beyond the tolerance of "
            f"{self.tolerance / speed:g}"
        )
        if self.settled():
            share = limit.regularisation / speed
            return f"{text}, and no shorter step helps: the engine's own regularisation of contacts leaves {share:.1e}"
        failed = f" ({self.failure})" if self.failure else ""
        return f"{text}, at the finest step, {limit.step:.3g} s{failed}"


def estimate_limit(
    run: Callable[[Scene, int], Run],
    probe: float | None,
    first: Run,
    convergence: Convergence,
    max_steps: int,
) -> tuple[Limit | None, str]:
    """Find the limit of a scene, of which `first` is the run, which is over, at the step h that a user takes.

    `run` runs a scene for at most so many steps, and `probe` is the engine's `regularisation_probe`. A run at the step
    h, or a longer one, may take `max_steps`; at shorter ones as many times more, and no more than `PATIENCE` times what
    the run at h took. The limit is None where shorter steps did not come to an end; the text says why it is not
    converged, and is empty if it is.
    """
    case = _Case(run, probe, first, convergence, max_steps)
    case.approach()
    return case.limit, case.problem()
