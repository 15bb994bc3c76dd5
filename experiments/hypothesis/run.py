"""The run: what every solver does in every limit, over the maps and along its motion, and what comes of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.hypothesis.cases import BY_KEY, CASES, Case, Point, distance, draw
from impact_xval.experiments.hypothesis.columns import PLACES, ColumnResult, columns_solvers, examine_columns
from impact_xval.experiments.hypothesis.config import HypothesisConfig, spaced
from impact_xval.experiments.hypothesis.maps import axes, error_map, map_ratios
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
from impact_xval.experiments.hypothesis.solvers import SolverUnderTest, outcomes_of, under_test
from impact_xval.experiments.hypothesis.verdicts import CaseResult, Series, examine
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.sweep.pool import Slot, available_cores, open_pool
from impact_xval.experiments.sweep.process import FaultError, in_halves
from impact_xval.experiments.sweep.rows import Resolve
from impact_xval.experiments.sweep.warmup import stated

Floats = NDArray[np.float64]

#: Called with how much work is done, of how much, and a line to show ("" if none).
Progress = Callable[[int, int, str], None]

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
    mechanisms : list of Mechanism
    motions : dict
        Relative motion by (solver, limit) at `DRAWN_CONTRAST`.
    branches : list of Branches
        Of the model where it has no limit.
    maps : DataFrame
        Their cells (`maps.error_map`), those of engines last.
    columns : list of ColumnResult
        By place, then by solver.
    control : dict
        By engine, all limits together: `distance` of its results from the exact column of its own law, and their own
        `error`.
    versions : dict
        By solver.
    unavailable : dict
        Why, by solver.
    seconds : dict
        Wall time by stage.
    """

    config: HypothesisConfig
    series: list[Series]
    verdicts: list[CaseResult]
    mechanisms: list[Mechanism]
    motions: dict[tuple[str, str], Motion]
    branches: list[Branches]
    maps: pd.DataFrame
    columns: list[ColumnResult]
    control: dict[str, pd.DataFrame]
    versions: dict[str, str]
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
        return list(dict.fromkeys(zip(self.maps.e1, self.maps.e2, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """A solver, the ratios of the collisions it is given, and what is made of their outcomes."""

    solver: SolverUnderTest
    ratios: Floats
    make: Callable[[pd.DataFrame], Any]


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
    points = {case.key: (*draw(case, config.points, config.seed), *config.given(case.key)) for case in CASES}
    workers = workers or config.workers or available_cores()
    with open_pool(resolve, workers, isolate=isolate) as pool:
        said = {name: pool.here(stated, resolve, name) for name in in_order_of_laws(config.solvers)}
        unavailable = {name: reason for name, (_, reason) in said.items() if reason is not None}
        for name, reason in unavailable.items():
            progress(0, 0, f"{name} is left out: {reason}")
        solvers = tuple(under_test(name, config.steps, resolve) for name in said if name not in unavailable)
        series, maps = _series(config, solvers, points), _maps(config, solvers)
        done = _solve(config, solvers, points, [*series, *maps], pool, progress)
    found = [done.made[task] for task in series]
    return Results(
        config=config,
        series=found,
        verdicts=[_examined(config, one) for one in found],
        mechanisms=[mechanism for mechanism, _ in done.followed],
        motions={
            (m.solver, m.case): motion
            for m, motion in done.followed
            if motion and m.case in DRAWN and m.contrast == DRAWN_CONTRAST
        },
        branches=done.branches,
        maps=pd.concat([done.made[task] for task in maps], ignore_index=True),
        columns=done.columns,
        control=_control(found, config),
        versions={name: version for name, (version, _) in said.items()},
        unavailable=unavailable,
        seconds=done.seconds,
    )


@dataclass(frozen=True, slots=True)
class _Done:
    """What came of the tasks, and what was seen of the solvers beside them."""

    made: dict[_Task, Any]
    followed: list[tuple[Mechanism, Motion | None]]
    branches: list[Branches]
    columns: list[ColumnResult]
    seconds: dict[str, float]


def _series(
    config: HypothesisConfig, solvers: Sequence[SolverUnderTest], points: dict[str, tuple[Point, ...]]
) -> list[_Task]:
    """Plan the series by limit, then by solver."""
    return [
        _Task(one, ratios_of(case, points[case.key], x), partial(Series, one, case, points[case.key], x))
        for case in CASES
        for one in solvers
        for x in [contrasts(config, case, one)]
    ]


def _maps(config: HypothesisConfig, solvers: Iterable[SolverUnderTest]) -> list[_Task]:
    """Plan the maps by solver, those of the engines last; of each in the order of its restitutions."""
    return [
        _Task(one, ratios, partial(error_map, one.name, ratios))
        for one in sorted(solvers, key=lambda one: one.kind == "stepped")
        for e1, e2 in dict.fromkeys(config.map.restitutions[: 1 if one.costly else None])
        for ratios in [map_ratios(*axes(config.map, one), e1, e2)]
    ]


def _solve(
    config: HypothesisConfig,
    solvers: Iterable[SolverUnderTest],
    points: dict[str, tuple[Point, ...]],
    tasks: Sequence[_Task],
    pool: Any,
    progress: Progress,
) -> _Done:
    """Hand out the work of the engines, and all trajectories; meanwhile do that of the exact solvers here."""
    own = [task for task in tasks if task.solver.kind == "exact"]
    others = [task for task in tasks if task.solver.kind != "exact"]
    pieces = _hand_out(others, pool, config.cell_timeout)
    observed = [
        pool.submit(_follow, one, key, contrast, config.cell_timeout)
        for one in solvers
        for key in POINTS
        for contrast in (ENGINE_CONTRASTS if one.kind == "stepped" else CONTRASTS)
    ]
    handed = [future for parts in pieces.values() for future in parts] + observed
    here = len(own) + len(PLACES) * len(columns_solvers(config))
    total = here + len(handed)
    made, columns = {}, []
    start = time.perf_counter()
    for done, task in enumerate(own, start=1):
        made[task] = task.make(task.solver.solve(*task.ratios))
        progress(done + sum(future.done() for future in handed), total, "")
    elastic = [p for p in points["zero-early"] if p.e1 == 1 and p.e2 < 1]
    branches = [count_branches(p, config.seed) for p in elastic if "state-transition" in config.solvers]
    for column in examine_columns(config):
        columns.append(column)
        progress(len(own) + len(columns) + sum(future.done() for future in handed), total, "")
    seconds = {"model and references": time.perf_counter() - start}
    for future in as_completed([future for future in handed if not future.done()]):
        future.result()
        progress(here + sum(f.done() for f in handed), total, "")
    for task, parts in pieces.items():
        made[task] = task.make(pd.concat([part.result() for part in parts], ignore_index=True))
    seconds["all, engines included"] = time.perf_counter() - start
    return _Done(made, [future.result() for future in observed], branches, columns, seconds)


def contrasts(config: HypothesisConfig, case: Case, one: SolverUnderTest) -> Floats:
    """Return the contrasts of a series."""
    low, high = config.plastic_contrast if case.plastic else config.contrast
    per_decade = max(4, config.per_decade // 2) if case.plastic else config.per_decade
    if one.kind == "stepped":
        low, high = config.engine_plastic_contrast if case.plastic else config.engine_contrast
        per_decade = config.engine_per_decade
        if one.costly and high > 100 * low:
            low, high = low * 10**0.5, high / 10**0.5
    return spaced((low, high), per_decade)


def ratios_of(case: Case, points: Sequence[Point], contrast: Floats) -> Floats:
    """Return k2/k1, m2/m1, e1, e2 of every point and contrast, shape (4, n m)."""
    return np.array([point.ratios(case, float(x)) for point in points for x in contrast]).reshape(-1, 4).T


def _warm(resolve: Resolve, one: SolverUnderTest) -> None:
    """Have a solver do once what it will have to do, so that all is imported and compiled."""
    case, contrast = _EASY
    ratios = np.array(POINTS[case].ratios(BY_KEY[case], contrast))
    if one.kind != "exact":
        one.solve(*ratios[:, None])
    observe(one.name, case, contrast, resolve)


def _follow(
    slot: Slot, one: SolverUnderTest, case: str, contrast: float, timeout: float
) -> tuple[Mechanism, Motion | None]:
    def call(_: slice) -> tuple[Mechanism, Motion | None]:
        slot.prepare(one.name, _warm, one)
        return slot.call(one.name, _observe, one.name, case, contrast, timeout=timeout)

    def failure(_: slice, fault: FaultError) -> tuple[Mechanism, Motion | None]:
        return Mechanism(one.name, case, contrast, fault.status, fault.reason), None

    return in_halves(call, 1, failure)[0]


def _observe(resolve: Resolve, solver: str, case: str, contrast: float) -> tuple[Mechanism, Motion | None]:
    return observe(solver, case, contrast, resolve)


def _hand_out(tasks: Iterable[_Task], pool: Any, timeout: float) -> dict[_Task, list[Future[pd.DataFrame]]]:
    """Hand out the work of the engines in pieces, those with the most steps first; of each task in order."""
    pieces = [
        (task, task.ratios[:, first : first + _PIECE])
        for task in tasks
        for first in range(0, task.ratios.shape[1], _PIECE)
    ]
    steps = [float(np.sum(np.sqrt(np.maximum(ratios[0], 1 / ratios[0])))) for _, ratios in pieces]
    most_first = sorted(range(len(pieces)), key=lambda i: -steps[i])
    futures: dict[int, Future[pd.DataFrame]] = {}
    for i in most_first:
        solver, ratios = pieces[i][0].solver, pieces[i][1]
        futures[i] = pool.submit(_isolated, solver, ratios, timeout)
    handed: dict[_Task, list[Future[pd.DataFrame]]] = {}
    for i, (task, _) in enumerate(pieces):
        handed.setdefault(task, []).append(futures[i])
    return handed


def _isolated(slot: Slot, one: SolverUnderTest, ratios: Floats, timeout: float) -> pd.DataFrame:
    """Solve collisions by a solver in its process, whatever becomes of it, within a time for all of its steps."""

    def call(place: slice) -> pd.DataFrame:
        slot.prepare(one.name, _warm, one)
        return slot.call(one.name, _solved, one, ratios[:, place], timeout=timeout)

    def failure(_: slice, fault: FaultError) -> pd.DataFrame:
        return outcomes_of([np.nan], [np.nan], np.nan, fault.status, reason=fault.reason)

    return pd.concat(in_halves(call, ratios.shape[1], failure), ignore_index=True)


def _solved(_: object, one: SolverUnderTest, ratios: Floats) -> pd.DataFrame:
    return one.solve(*ratios)


def _examined(config: HypothesisConfig, series: Series) -> CaseResult:
    stepped = series.solver.kind == "stepped"
    return examine(series, config.engine_fit_decades if stepped else config.fit_decades)


def _control(series: Iterable[Series], config: HypothesisConfig) -> dict[str, pd.DataFrame]:
    """Compare the engines with the exact Kelvin-Voigt column, which is their law: `Results.control`."""
    exact = under_test("kelvin-voigt", config.steps)
    found: dict[str, list[pd.DataFrame]] = {}
    for one in series:
        if one.solver.kind == "stepped" and one.solver.family == "kelvin-voigt":
            ratios, mine = ratios_of(one.case, one.points, one.contrast), one.outcomes
            law = exact.solve(*ratios)
            away = distance(ratios[1], mine.v1 - law.v1, mine.v2 - law.v2)
            found.setdefault(one.solver.name, []).append(mine[["error"]].assign(distance=away))
    return {name: pd.concat(frames).dropna() for name, frames in found.items()}
