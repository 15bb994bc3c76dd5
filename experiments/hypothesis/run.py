"""The run: what every solver does in every limit, over the maps and along its motion, and what comes of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.answers import why_unavailable
from impact_xval.experiments.hypothesis.cases import BY_KEY, CASES, Case, Point, distance, draw
from impact_xval.experiments.hypothesis.config import HypothesisConfig
from impact_xval.experiments.hypothesis.maps import ErrorMap, axes, error_map, map_ratios
from impact_xval.experiments.hypothesis.mechanism import (
    CONTRASTS,
    ENGINE_CONTRASTS,
    POINTS,
    Branches,
    Mechanism,
    Motion,
    count_branches,
    observe,
)
from impact_xval.experiments.hypothesis.solvers import Outcomes, SolverUnderTest, isolated, under_test
from impact_xval.experiments.hypothesis.verdicts import CaseResult, Group, Series, examine
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.sweep.executors import available_cores, open_executor
from impact_xval.experiments.sweep.sandbox import FaultError, Sandbox, in_halves
from impact_xval.experiments.sweep.solving import Resolve

Floats = NDArray[np.float64]

#: Called with how much work is done, of how much, and a line to show ("" if none).
Progress = Callable[[int, int, str], None]

#: What is solved of a solver: ``("series", limit)``, ``("redrawn", limit)`` or ``("map", e1, e2)``.
Key = tuple[str | float, ...]

#: The limits whose relative motion is drawn, and at which contrast.
DRAWN, DRAWN_CONTRAST = ("zero-early", "zero-late", "infinity"), 1e3

#: Case and contrast of a collision that any solver does at once.
_EASY = "infinity", 10.0

#: Cells of one piece of work of an engine.
_PIECE = 12


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Everything a run found.

    Attributes
    ----------
    config : HypothesisConfig
    series : list of Series
        By limit, then by solver.
    verdicts : list of CaseResult
        In the order of `series`.
    redrawn : dict
        Group by (solver, limit, class; ``all`` for all) with another seed; exact solvers only.
    mechanisms : list of Mechanism
    motions : dict
        Relative motion by (solver, limit) at `DRAWN_CONTRAST`.
    branches : list of Branches
        Of the model where it has no limit.
    maps : list of ErrorMap
        Those of engines last.
    control : dict
        By engine: k2/k1, distance of its outcomes from the exact column of its own law, and their own error, rows of
        one array, all limits together.
    unavailable : dict
        Why, by solver.
    seconds : dict
        Wall time by stage.
    """

    config: HypothesisConfig
    series: list[Series]
    verdicts: list[CaseResult]
    redrawn: dict[tuple[str, str, str], Group]
    mechanisms: list[Mechanism]
    motions: dict[tuple[str, str], Motion]
    branches: list[Branches]
    maps: list[ErrorMap]
    control: dict[str, Floats]
    unavailable: dict[str, str]
    seconds: dict[str, float] = field(default_factory=dict)

    def verdict(self, solver: str, case: str) -> CaseResult | None:
        """Return the verdict of a solver on a limit, if it was tested."""
        return next((v for v in self.verdicts if v.solver == solver and v.case.key == case), None)

    @property
    def solvers(self) -> list[str]:
        """The solvers that were tested, grouped by the law they were asked for."""
        return in_order_of_laws(name for name in self.config.solvers if name not in self.unavailable)

    @property
    def mapped(self) -> list[tuple[float, float]]:
        """The restitutions e1, e2 of the maps."""
        return list(dict.fromkeys((one.e1, one.e2) for one in self.maps))


@dataclass(frozen=True, slots=True)
class _Plan:
    """What is solved: the points of each limit, and the tasks that follow from them."""

    config: HypothesisConfig
    solvers: tuple[SolverUnderTest, ...]
    points: dict[str, tuple[Point, ...]]
    redrawn: dict[str, tuple[Point, ...]]

    def tasks(self, *, exact: bool) -> Iterator[tuple[SolverUnderTest, Key, Floats]]:
        """Yield solver, key and ratios of all that is solved by exact solvers, or by the others."""
        chosen = [one for one in self.solvers if (one.kind == "exact") == exact]
        for case in CASES:
            for one in chosen:
                x = contrasts(self.config, case, one)
                yield one, ("series", case.key), ratios_of(case, self.points[case.key], x)
                if exact:
                    yield one, ("redrawn", case.key), ratios_of(case, self.redrawn[case.key], x)
        for one in chosen:
            kappa, masses = axes(self.config.map, one)
            for e1, e2 in map_restitutions(self.config, one):
                yield one, ("map", e1, e2), map_ratios(kappa, masses, e1, e2)


def run_hypothesis(
    config: HypothesisConfig,
    *,
    workers: int | None = None,
    isolate: bool = True,
    progress: Progress = lambda done, total, line: None,
    resolve: Resolve = get_solver,
) -> Results:
    """Test the hypothesis.

    Parameters
    ----------
    config : HypothesisConfig
    workers : int, optional
        Processes for engines; by default that of the configuration, else one for every core. No result depends on it.
    isolate : bool
        False runs all solvers in this process, one after the other: one that crashes ends the run.
    progress : callable
        Called after every piece of work.
    resolve : callable
        Finds a solver by its name; at the top level of a module.

    Returns
    -------
    Results
    """
    reasons = {name: why_unavailable(resolve(name)) for name in in_order_of_laws(config.solvers)}
    unavailable = {name: reason for name, reason in reasons.items() if reason is not None}
    for name, reason in unavailable.items():
        progress(0, 0, f"{name} is left out: {reason}")
    solvers = tuple(under_test(name, config.steps, resolve) for name in reasons if name not in unavailable)
    points = {case.key: (*draw(case, config.points, config.seed), *config.given(case.key)) for case in CASES}
    redrawn = {case.key: tuple(draw(case, config.points, config.seed + 1)) for case in CASES}
    plan = _Plan(config, solvers, points, redrawn)
    workers = workers or config.workers or available_cores()
    with open_executor(_Context(solvers, resolve), _prepare, workers, isolate=isolate) as executor:
        done = _solve(plan, executor, progress)
    series = _series(plan, "series", points, done.outcomes)
    return Results(
        config=config,
        series=series,
        verdicts=[_examined(plan, one) for one in series],
        redrawn={
            (found.solver, found.case.key, group.name): group
            for found in (_examined(plan, one) for one in _series(plan, "redrawn", redrawn, done.outcomes))
            for group in (found.whole, *found.classes)
        },
        mechanisms=[mechanism for mechanism, _ in done.followed],
        motions={
            (m.solver, m.case): motion
            for m, motion in done.followed
            if motion is not None and m.case in DRAWN and m.contrast == DRAWN_CONTRAST
        },
        branches=done.branches,
        maps=_maps(plan, done.outcomes),
        control=_control(plan, done.outcomes),
        unavailable=unavailable,
        seconds=done.seconds,
    )


@dataclass(frozen=True, slots=True)
class _Done:
    """What the solvers gave."""

    outcomes: dict[tuple[str, Key], Outcomes]
    followed: list[tuple[Mechanism, Motion | None]]
    branches: list[Branches]
    seconds: dict[str, float]


def _solve(plan: _Plan, executor: Any, progress: Progress) -> _Done:
    """Hand out the work of the engines, and all trajectories; meanwhile do that of the exact solvers here."""
    config = plan.config
    pieces = _hand_out(plan, executor)
    observed = [
        executor.submit(_follow, one.name, key, contrast, config.cell_timeout)
        for one in plan.solvers
        for key in POINTS
        for contrast in (ENGINE_CONTRASTS if one.kind == "stepped" else CONTRASTS)
    ]
    handed = [future for parts in pieces.values() for future in parts] + observed
    own = list(plan.tasks(exact=True))
    total = len(own) + len(handed)
    outcomes: dict[tuple[str, Key], Outcomes] = {}
    start = time.perf_counter()
    for done, (one, key, ratios) in enumerate(own, start=1):
        outcomes[one.name, key] = one.solve(*ratios)
        progress(done + sum(future.done() for future in handed), total, "")
    elastic = [p for p in plan.points["zero-early"] if p.e1 == 1 and p.e2 < 1]
    branches = [count_branches(p, config.seed) for p in elastic if "state-transition" in config.solvers]
    seconds = {"model and references": time.perf_counter() - start}
    for future in as_completed([future for future in handed if not future.done()]):
        future.result()
        progress(len(own) + sum(f.done() for f in handed), total, "")
    outcomes |= {key: Outcomes.join([f.result() for f in parts]) for key, parts in pieces.items()}
    seconds["all, engines included"] = time.perf_counter() - start
    return _Done(outcomes, [future.result() for future in observed], branches, seconds)


def contrasts(config: HypothesisConfig, case: Case, one: SolverUnderTest) -> Floats:
    """Return the contrasts of a series."""
    low, high = config.plastic_contrast if case.plastic else config.contrast
    per_decade = max(4, config.per_decade // 2) if case.plastic else config.per_decade
    if one.kind == "stepped":
        low, high = config.engine_plastic_contrast if case.plastic else config.engine_contrast
        per_decade = config.engine_per_decade
        if one.costly and high > 100 * low:
            low, high = low * 10**0.5, high / 10**0.5
    decades = math.log10(high / low)
    return np.logspace(math.log10(low), math.log10(high), round(decades * per_decade) + 1)


def ratios_of(case: Case, points: Sequence[Point], contrast: Floats) -> Floats:
    """Return k2/k1, m2/m1, e1, e2 of every point and contrast, shape (4, n m)."""
    return np.array([point.ratios(case, float(x)) for point in points for x in contrast]).reshape(-1, 4).T


def map_restitutions(config: HypothesisConfig, one: SolverUnderTest) -> list[tuple[float, float]]:
    """Return the restitutions e1, e2 of the maps of a solver."""
    return config.map.restitutions[: 1 if one.costly else None]


@dataclass(frozen=True, slots=True)
class _Context:
    """What every process is given once."""

    solvers: tuple[SolverUnderTest, ...]
    resolve: Resolve


def _prepare(context: _Context) -> None:
    """Have every solver do once what it will have to do, so that all is imported and compiled."""
    case, contrast = _EASY
    ratios = np.array(POINTS[case].ratios(BY_KEY[case], contrast))
    for one in context.solvers:
        if one.kind != "exact":
            one.solve(*ratios[:, None])
        observe(one.name, case, contrast, context.resolve)


def _follow(
    sandbox: Sandbox, solver: str, case: str, contrast: float, timeout: float
) -> tuple[Mechanism, Motion | None]:
    def call(_: slice) -> tuple[Mechanism, Motion | None]:
        return sandbox.call(_observe, solver, case, contrast, timeout=timeout)

    def failure(_: slice, fault: FaultError) -> tuple[Mechanism, Motion | None]:
        return Mechanism(solver, case, contrast, fault.status, fault.reason), None

    return in_halves(call, 1, failure)[0]


def _observe(context: _Context, solver: str, case: str, contrast: float) -> tuple[Mechanism, Motion | None]:
    return observe(solver, case, contrast, context.resolve)


def _hand_out(plan: _Plan, executor: Any) -> dict[tuple[str, Key], list[Future[Outcomes]]]:
    """Hand out the work of the engines in pieces, those with the most steps first; of each task in order."""
    pieces = []
    for one, key, ratios in plan.tasks(exact=False):
        for first in range(0, ratios.shape[1], _PIECE):
            part = ratios[:, first : first + _PIECE]
            steps = float(np.sum(np.sqrt(np.maximum(part[0], 1 / part[0]))))
            pieces.append((steps, one, key, first, part))
    futures: dict[tuple[str, Key], dict[int, Future[Outcomes]]] = {}
    for _, one, key, first, part in sorted(pieces, key=lambda piece: -piece[0]):
        future = executor.submit(isolated, one.solve, part, plan.config.cell_timeout)
        futures.setdefault((one.name, key), {})[first] = future
    return {key: [by_first[first] for first in sorted(by_first)] for key, by_first in futures.items()}


def _series(
    plan: _Plan, kind: str, points: dict[str, tuple[Point, ...]], outcomes: dict[tuple[str, Key], Outcomes]
) -> list[Series]:
    return [
        Series(
            one,
            case,
            points[case.key],
            contrasts(plan.config, case, one),
            outcomes[one.name, (kind, case.key)],
        )
        for case in CASES
        for one in plan.solvers
        if (one.name, (kind, case.key)) in outcomes
    ]


def _examined(plan: _Plan, series: Series) -> CaseResult:
    stepped = series.solver.kind == "stepped"
    return examine(series, plan.config.engine_fit_decades if stepped else plan.config.fit_decades)


def _maps(plan: _Plan, outcomes: dict[tuple[str, Key], Outcomes]) -> list[ErrorMap]:
    """Make the maps by solver, those of the engines last; of each in the order of its restitutions."""
    return [
        error_map(one.name, e1, e2, *axes(plan.config.map, one), outcomes[one.name, ("map", e1, e2)])
        for one in sorted(plan.solvers, key=lambda one: one.kind == "stepped")
        for e1, e2 in map_restitutions(plan.config, one)
    ]


def _control(plan: _Plan, outcomes: dict[tuple[str, Key], Outcomes]) -> dict[str, Floats]:
    """Compare the engines with the exact Kelvin-Voigt column, which is their law: `Results.control`."""
    exact = under_test("kelvin-voigt", plan.config.steps)
    found: dict[str, list[Floats]] = {}
    for one, key, ratios in plan.tasks(exact=False):
        if key[0] == "series" and one.kind == "stepped" and one.family == "kelvin-voigt":
            mine, law = outcomes[one.name, key], exact.solve(*ratios)
            away = distance(ratios[1], mine.v1 - law.v1, mine.v2 - law.v2)
            found.setdefault(one.name, []).append(np.array([ratios[0], away, mine.error]))
    return {name: np.concatenate(rows, axis=1) for name, rows in found.items()}
