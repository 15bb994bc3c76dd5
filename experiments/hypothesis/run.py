"""The run: everything that is asked of the solvers, and what comes of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from impact_xval.experiments.hypothesis.isolation import (
    Job,
    ask,
    follow,
    open_executor,
)
from impact_xval.experiments.hypothesis.ringing import Branches, count_branches
from impact_xval.experiments.hypothesis.series import Series, examine, ratios_of
from impact_xval.experiments.hypothesis.subjects import Answers, Subject, subject
from numpy.typing import NDArray

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.hypothesis.cases import CASES, Case, Point, draw
from impact_xval.experiments.hypothesis.config import HypothesisConfig
from impact_xval.experiments.hypothesis.maps import (
    ErrorMap,
    axes,
    error_map,
    map_ratios,
)
from impact_xval.experiments.hypothesis.mechanism import (
    CONTRASTS,
    ENGINE_CONTRASTS,
    POINTS,
    Mechanism,
    Motion,
)
from impact_xval.experiments.hypothesis.verdicts import CaseResult, Group
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.sweep.executors import available_cores
from impact_xval.experiments.sweep.solving import Resolve

Floats = NDArray[np.float64]

#: Told how much work is done, of how much, and a line worth saying ("" if none).
Progress = Callable[[int, int, str], None]

#: The limits whose relative motion is drawn, and at which contrast.
DRAWN, DRAWN_CONTRAST = ("zero-early", "zero-late", "infinity"), 1e3

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
        By engine: distances of its outcomes from the exact column of its own law, all limits together.
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
        False asks all solvers in this process, one after the other: one that crashes ends the run.
    progress : callable
        Called after every piece of work.
    resolve : callable
        Finds a solver by its name; at the top level of a module.

    Returns
    -------
    Results
    """
    workers = workers or config.workers or available_cores()
    seconds: dict[str, float] = {}
    subjects, unavailable = [], {}
    for name in in_order_of_laws(config.solvers):
        reason = resolve(name).unavailable()
        if reason is None:
            subjects.append(subject(name, config.steps, resolve))
        else:
            unavailable[name] = reason
            progress(0, 0, f"{name} is left out: {reason}")
    points = {case.key: (*draw(case, config.points, config.seed), *config.given(case.key)) for case in CASES}
    handed = [one for one in subjects if one.kind != "exact"]
    exact = [one for one in subjects if one.kind == "exact"]

    with open_executor(Job(tuple(subjects), resolve), workers, isolate=isolate) as executor:
        pieces = _hand_out(config, handed, points, executor)
        observed = [
            executor.submit(follow, one.name, key, contrast, config.cell_timeout)
            for one in subjects
            for key in POINTS
            for contrast in (ENGINE_CONTRASTS if one.kind == "stepped" else CONTRASTS)
        ]
        work = [future for piece in pieces.values() for future in piece] + observed
        series_asked = [(case, one) for case in CASES for one in exact]
        maps_asked = [(one, e) for one in exact for e in map_restitutions(config, one)]
        total = len(work) + 2 * len(series_asked) + len(maps_asked)
        done = 0

        def advance(line: str = "") -> None:
            nonlocal done
            done += 1
            ready = sum(future.done() for future in work)
            progress(done + ready, total, line)

        start = time.perf_counter()
        answers: dict[tuple[str, str], Answers] = {}
        redrawn: dict[tuple[str, str, str], Group] = {}
        for case, one in series_asked:
            contrast = contrasts(config, case, one)
            answers[one.name, case.key] = one.ask(*ratios_of(case, points[case.key], contrast))
            advance()
        for case, one in series_asked:
            again = tuple(draw(case, config.points, config.seed + 1))
            contrast = contrasts(config, case, one)
            series = Series(one, case, again, contrast, one.ask(*ratios_of(case, again, contrast)))
            found = examine(series, config.fit_decades)
            for group in (found.whole, *found.classes):
                redrawn[one.name, case.key, group.name] = group
            advance()
        maps: dict[tuple[str, float, float], ErrorMap] = {}
        for one, (e1, e2) in maps_asked:
            kappa, masses = axes(config.map, one)
            found = one.ask(*map_ratios(kappa, masses, e1, e2))
            maps[one.name, e1, e2] = error_map(one.name, e1, e2, kappa, masses, found)
            advance()
        branches = [
            count_branches(point, config.seed)
            for point in points["zero-early"]
            if point.e1 == 1 and point.e2 < 1 and "state-transition" in config.solvers
        ]
        seconds["model and references"] = time.perf_counter() - start
        pending = [future for future in work if not future.done()]
        for future in as_completed(pending):
            future.result()
            progress(done + sum(f.done() for f in work), total, "")
        for one in handed:
            for case in CASES:
                answers[one.name, case.key] = Answers.join([f.result() for f in pieces[one.name, case.key]])
            kappa, masses = axes(config.map, one)
            for e1, e2 in map_restitutions(config, one):
                joined = Answers.join([f.result() for f in pieces[one.name, f"map {e1} {e2}"]])
                maps[one.name, e1, e2] = error_map(one.name, e1, e2, kappa, masses, joined)
        mechanisms, motions = [], {}
        for future in observed:
            mechanism, motion = future.result()
            mechanisms.append(mechanism)
            if motion is not None and mechanism.case in DRAWN and mechanism.contrast == DRAWN_CONTRAST:
                motions[mechanism.solver, mechanism.case] = motion
    seconds["all, engines included"] = time.perf_counter() - start

    all_series, verdicts = [], []
    for case in CASES:
        for one in subjects:
            contrast = contrasts(config, case, one)
            series = Series(one, case, points[case.key], contrast, answers[one.name, case.key])
            all_series.append(series)
            decades = config.engine_fit_decades if one.kind == "stepped" else config.fit_decades
            verdicts.append(examine(series, decades))
    return Results(
        config,
        all_series,
        verdicts,
        redrawn,
        mechanisms,
        motions,
        branches,
        _in_order(subjects, maps),
        _control(subjects, points, config, answers),
        unavailable,
        seconds,
    )


def contrasts(config: HypothesisConfig, case: Case, one: Subject) -> Floats:
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


def map_restitutions(config: HypothesisConfig, one: Subject) -> list[tuple[float, float]]:
    """Return the restitutions e1, e2 of the maps of a solver."""
    return config.map.restitutions[: 1 if one.costly else None]


def _hand_out(
    config: HypothesisConfig,
    handed: list[Subject],
    points: dict[str, tuple[Point, ...]],
    executor: Any,
) -> dict[tuple[str, str], list[Future[Answers]]]:
    """Hand out the work of the engines, in pieces of cells in order; the long ones first."""
    asked: list[tuple[Subject, str, Floats]] = []
    for one in handed:
        for case in CASES:
            asked.append((one, case.key, ratios_of(case, points[case.key], contrasts(config, case, one))))
        kappa, masses = axes(config.map, one)
        for e1, e2 in map_restitutions(config, one):
            asked.append((one, f"map {e1} {e2}", map_ratios(kappa, masses, e1, e2)))
    pieces: list[tuple[float, Subject, str, int, Floats]] = []
    for one, key, ratios in asked:
        for first in range(0, ratios.shape[1], _PIECE):
            part = ratios[:, first : first + _PIECE]
            steps = float(np.sum(np.sqrt(np.maximum(part[0], 1 / part[0]))))
            pieces.append((steps, one, key, first, part))
    futures: dict[tuple[str, str], dict[int, Future[Answers]]] = {}
    for _, one, key, first, part in sorted(pieces, key=lambda piece: -piece[0]):
        future = executor.submit(ask, one.ask, part, config.cell_timeout)
        futures.setdefault((one.name, key), {})[first] = future
    return {key: [by_first[first] for first in sorted(by_first)] for key, by_first in futures.items()}


def _in_order(subjects: list[Subject], maps: dict[tuple[str, float, float], ErrorMap]) -> list[ErrorMap]:
    """List the maps by solver, those of the engines last; of each in the order of its restitutions."""
    ordered = sorted(subjects, key=lambda one: one.kind == "stepped")
    return [found for one in ordered for (name, _, _), found in maps.items() if name == one.name]


def _control(
    subjects: list[Subject],
    points: dict[str, tuple[Point, ...]],
    config: HypothesisConfig,
    answers: dict[tuple[str, str], Answers],
) -> dict[str, Floats]:
    """Distance of every outcome of an engine from the exact Kelvin-Voigt column: rows k2/k1, distance, own error."""
    found: dict[str, Floats] = {}
    for one in (one for one in subjects if one.kind == "stepped" and one.family == "kelvin-voigt"):
        rows = []
        for case in CASES:
            ratios = ratios_of(case, points[case.key], contrasts(config, case, one))
            exact = subject("kelvin-voigt", config.steps).ask(*ratios)
            mine = answers[one.name, case.key]
            away = np.sqrt(np.square(mine.v1 - exact.v1) + ratios[1] * np.square(mine.v2 - exact.v2))
            rows.append(np.array([ratios[0], away, mine.error]))
        found[one.name] = np.concatenate(rows, axis=1)
    return found
