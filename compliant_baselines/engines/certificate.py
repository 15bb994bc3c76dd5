"""Running an engine at shorter and shorter steps until its limit is known: a certificate for each column."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Protocol

import numpy as np

from impact_xval.compliant_baselines.contact.column import Column
from impact_xval.compliant_baselines.contract.convergence import Convergence, Limit, limit_of
from impact_xval.compliant_baselines.engines.engine_run import Run, states_of

#: Factor within which two measures of a regularisation agree.
ALIKE = 2.0


#: Share of the shorter contact period for which a state must be held to be told from one that only a step made.
SHORTEST_STATE = 2.5e-3


class Runner(Protocol):
    """What is needed of an engine."""

    #: How many times as much regularisation the engine is run with to see what its own does; None: none.
    regularisation_probe: float | None

    def run_columns(self, columns: Sequence[Column], max_steps: int) -> list[Run]:
        """Run every column until its collision is over or `max_steps` steps are taken; in order."""
        ...


@dataclass(slots=True)
class _Case:
    """A column on its way to its limit: its runs, from the longest step to the shortest."""

    column: Column
    runs: list[Run]
    #: What regularisation was seen to do, in m/s, at ever shorter steps.
    regularisation: list[float] = field(default_factory=list)
    failure: str = ""

    def limit(self) -> Limit | None:
        if len(self.runs) < 3:
            return None
        velocities = np.array([run.reported for run in self.runs])
        last = self.runs[-1]
        ratio = self.column.m2 / self.column.m1
        paths = {(states_of(run, SHORTEST_STATE).names, run.fall is None) for run in self.runs[-2:]}
        limit = limit_of(
            velocities,
            last.starts,
            last.column.step,
            ratio,
            *self.regularisation[-1:],
            alike=len(paths) == 1,
            flight_doubt=self.flight_doubt(),
        )
        return replace(limit, flight=last.fall is not None)

    def flight_doubt(self) -> float:
        """Bound, in m/s, what gravity does in a contact that a first flight may or may not precede.

        Its lead is extrapolated as velocities are. Where it changes its sign on the way to a step of zero, or is too
        short to tell, the flight is in doubt, and gravity acts in the contact that decides on it or does not.
        """
        (before, _), (now, contact) = (run.lead for run in self.runs[-2:])
        sure = now * before > 0 and now * (2 * now - before) > 0 and abs(now) > 2 * self.runs[-1].column.step
        if sure or not isfinite(now) or not self.column.gravity:
            return 0.0
        return self.column.gravity * 0.5 * (self.column.contact1, self.column.contact2)[contact - 1].period

    def refine(self) -> Column:
        return replace(self.column, step=self.column.step / 2 ** len(self.runs))

    def probe(self, run: Run, coarse: Run, factor: float) -> None:
        """Take the run of a probe, beside that of the same step with the engine's own regularisation."""
        if run.over:
            moved = np.abs(np.subtract(run.reported, coarse.reported)).max()
            self.regularisation.append(float(moved) / (factor - 1))

    def wants_more(self, convergence: Convergence) -> bool:
        limit = self.limit()
        if self.failure or len(self.runs) > convergence.halvings or limit is None:
            return False
        return limit.error > convergence.tolerance * abs(self.column.v1) and not self.settled(convergence)

    def doubtful(self, convergence: Convergence) -> bool:
        """Whether regularisation seems to leave more than the tolerance."""
        tolerance = convergence.tolerance * abs(self.column.v1)
        return bool(self.regularisation) and self.regularisation[-1] > tolerance

    def settled(self, convergence: Convergence) -> bool:
        """Whether it does so at two lengths of the step alike: what it leaves no step brings back."""
        if len(self.regularisation) < 2 or not self.doubtful(convergence):
            return False
        before, now = self.regularisation[-2:]
        return before / ALIKE <= now <= before * ALIKE


def certify(
    runner: Runner, runs: Sequence[Run], convergence: Convergence, max_steps: int
) -> list[tuple[Limit | None, str]]:
    """Find the limits of columns that have been run at the longest step.

    Parameters
    ----------
    runner : Runner
        The engine.
    runs : sequence of Run
        Its runs at the step a user would take, all of them over.
    convergence : Convergence
        What is wanted.
    max_steps : int
        Steps a run at the longest step may take; at shorter ones as many times more.

    Returns
    -------
    list of (Limit or None, str)
        None where shorter steps did not come to an end; and why the limit is not converged, empty if it is.
    """
    cases = [_Case(run.column, [run]) for run in runs]
    factor = runner.regularisation_probe or 1.0
    probed = [case for case in cases if factor > 1 and case.column.mapping == "calibrated"]
    probes = [replace(case.column, regularisation=factor) for case in probed]
    halves = [replace(case.column, step=case.column.step / 2**n) for case in cases for n in (1, 2)]
    # One call for all of them: an engine shares out what it is given.
    answers = runner.run_columns([*halves, *probes], 4 * max_steps)
    for i, case in enumerate(cases):
        for run in answers[2 * i : 2 * i + 2]:
            _take(case, run)
    for case, run in zip(probed, answers[2 * len(cases) :], strict=True):
        case.probe(run, case.runs[0], factor)
    while going := [case for case in cases if case.wants_more(convergence)]:
        longest = max_steps * 2 ** max(len(case.runs) for case in going)
        # Beside a grazing a probe at a long step may show what is the step's: seen again at the shortest.
        again = [case for case in going if case.doubtful(convergence)]
        finest = [replace(case.runs[-1].column, regularisation=factor) for case in again]
        for case, run in zip(again, runner.run_columns(finest, longest), strict=True):
            case.probe(run, case.runs[-1], factor)
        going = [case for case in going if case.wants_more(convergence)]
        for case, run in zip(
            going, runner.run_columns([case.refine() for case in going], longest), strict=True
        ):
            _take(case, run)
    return [(case.limit(), _reason(case, convergence)) for case in cases]


def _take(case: _Case, run: Run) -> None:
    if case.failure:
        return
    if run.over:
        case.runs.append(run)
    else:
        case.failure = f"at a step of {run.column.step:.3g} s: {run.problem()}"


def _reason(case: _Case, convergence: Convergence) -> str:
    """Say why the limit does not satisfy; nothing if it does."""
    limit, speed = case.limit(), abs(case.column.v1)
    if limit is None:
        return f"no limit of small steps: {case.failure}"
    if limit.error <= convergence.tolerance * speed:
        return ""
    text = (
        f"the limit of small steps is known to {limit.error / speed:.1e} of |v0|, beyond the tolerance of "
        f"{convergence.tolerance:g}"
    )
    if case.settled(convergence):
        return (
            f"{text}: the engine's own regularisation of contacts is {limit.regularisation / speed:.1e} of it"
        )
    return f"{text}, at the finest step, {limit.step:.3g} s" + (f" ({case.failure})" if case.failure else "")
