"""Rows of the table of a run: solvers solve cells, their outcomes are compared with the model's, and rows are made.

`solve_by_model` and `solve_and_compare` do the first two steps for one solver, in the worker process of this solver.
`complete_rows` does the last step, which needs the comparisons of all solvers. All steps work on arrays with one entry
per cell. `chunk` calls these functions; `solve_all` calls them without worker processes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.answers import answer, answer_graphs, describe_exception
from impact_xval.compliant_baselines.registry import exact_solver_for
from impact_xval.compliant_baselines.solver import Convergence, Settings, Solver
from impact_xval.experiments.config.cells import CellBlock, ColumnArrays
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.measures.divergence import (
    Comparison,
    Floats,
    SolverResults,
    asymmetry,
    divergence,
    masses_and_starts,
    masses_and_starts_of_graphs,
    results_of,
    results_of_graphs,
    retained_energy,
    retained_momentum,
    retained_momentum_of_graphs,
)
from impact_xval.experiments.measures.ladder import ladders
from impact_xval.experiments.measures.layout import LADDER_PREFIX, engines_with_ladders, layout_of
from impact_xval.experiments.tables.schema import Layout, to_table
from impact_xval.model.collisions import Collisions
from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
from impact_xval.model.outcome import Outcome
from impact_xval.model.status import Status

#: Function that returns a solver by its name. The function must be at the top level of a module, because worker
#: processes import it.
Resolve = Callable[[str], Solver]

_Piece = TypeVar("_Piece")

#: Largest absolute value of the divergence D and of the difference in retained energy. Statistics square these numbers,
#: and the square of a larger number would overflow.
_LARGEST = 1e150


@dataclass(frozen=True)
class Experiment:
    """Configuration of an experiment, and the function that returns its solvers by name.

    This object is sent to every worker process of a run.
    """

    config: Config
    resolve: Resolve = get_solver

    @cached_property
    def layout(self) -> Layout:
        """Columns of the rows that this experiment makes."""
        return layout_of(self.config)

    @property
    def others(self) -> list[str]:
        """Names of the solvers that are compared with the model."""
        return [name for name in self.config.solvers if name != REFERENCE]


def solve_all(experiment: Experiment, block: CellBlock) -> pa.Table:
    """Solve cells by every solver in this process; return their rows, ordered by cell and then by solver."""
    model = solve_by_model(experiment, block)
    comparisons = {name: solve_and_compare(experiment, name, block, model) for name in experiment.others}
    return complete_rows(experiment, block, {REFERENCE: model_as_comparison(model)} | comparisons)


def solve_by_model(experiment: Experiment, block: CellBlock) -> SolverResults:
    """Solve cells by the model and return its results as arrays.

    If the outcome of a cell cannot be put into arrays, this cell has no result. All other cells keep their results.
    """
    return SolverResults.concatenate(
        _isolate_errors(
            lambda place: _results_of_solver(experiment, REFERENCE, block[place]),
            len(block),
            lambda place, reason: results_without_outcome(
                experiment, REFERENCE, block[place], "crashed", reason
            ),
        )
    )


def solve_and_compare(
    experiment: Experiment, name: str, block: CellBlock, model: SolverResults
) -> Comparison:
    """Solve cells by a solver and compare its results with the model's in the same cells.

    If the outcome of a cell cannot be measured, this cell has no result. All other cells keep their results.
    """

    def attempt(place: slice) -> Comparison:
        cells = block[place]
        return _compare(experiment, name, cells, model[place], _results_of_solver(experiment, name, cells))

    def failure(place: slice, reason: str) -> Comparison:
        return compare_failure(experiment, name, block[place], model[place], "crashed", reason)

    return Comparison.concatenate(_isolate_errors(attempt, len(block), failure))


def compare_failure(
    experiment: Experiment, name: str, block: CellBlock, model: SolverResults, status: Status, reason: str
) -> Comparison:
    """Return the comparison of a solver that has no result in any of the cells. The solver is not called.

    `status` and `reason` stand in every row, and say why there is no result.
    """
    results = results_without_outcome(experiment, name, block, status, reason)
    return _compare(experiment, name, block, model, results)


def results_without_outcome(
    experiment: Experiment, name: str, block: CellBlock, status: Status, reason: str
) -> SolverResults:
    """Return results that say for every cell why the solver has no outcome. The solver is not called."""
    if experiment.layout.kind == "graph":
        failures = [GraphCollisionOutcome.failure(name, graph, status, reason) for graph in block.graphs]
        return _graphs_to_results(experiment, block, failures)
    outcomes = [Outcome.failure(name, collision, status, reason) for collision in block.collisions]
    return _to_results(experiment, block, outcomes)


def model_as_comparison(model: SolverResults) -> Comparison:
    """Return the model's results in the form in which other solvers are compared with it, without any measures.

    Measures are left out because the model's divergence from itself is zero everywhere.
    """
    return Comparison(replace(model, curves=None), marked=_name_marks(REFERENCE, model.mark), measures={})


def _isolate_errors(
    attempt: Callable[[slice], _Piece], n: int, failure: Callable[[slice, str], _Piece]
) -> list[_Piece]:
    """Call a function for n cells, and return its results in order, one for each range of cells that succeeded.

    The first call is for all cells at once. A range of cells whose call raises an exception is split into halves, down
    to single cells. If the call for a single cell raises an exception, `failure` returns the result in place of the
    call.
    """

    def pieces(start: int, stop: int) -> list[_Piece]:
        try:
            return [attempt(slice(start, stop))]
        except Exception as error:
            if stop - start <= 1:
                return [failure(slice(start, stop), f"measuring its outcome: {describe_exception(error)}")]
        middle = (start + stop) // 2
        return [*pieces(start, middle), *pieces(middle, stop)]

    return pieces(0, n)


def _results_of_solver(experiment: Experiment, name: str, block: CellBlock) -> SolverResults:
    """Call a solver for cells and return its results as arrays."""
    settings = settings_of(experiment.config, paths=experiment.layout.pair)
    if experiment.layout.kind == "graph":
        outcomes = answer_graphs(experiment.resolve(name), block.graphs, settings)
        return _graphs_to_results(experiment, block, outcomes)
    return _to_results(experiment, block, answer(experiment.resolve(name), block.collisions, settings))


def _to_results(experiment: Experiment, block: CellBlock, outcomes: Sequence[Outcome]) -> SolverResults:
    """Return the outcomes of pairs or chains as arrays with one entry per cell."""
    config, layout = experiment.config, experiment.layout
    has_paths = layout.pair and config.measures == "all"
    shortest = config.shortest_state * shortest_periods(block) if has_paths else None
    counts = layout.counts
    return results_of(outcomes, np.abs(block.parameters["v0"]), counts.balls, counts.contacts, shortest)


def _graphs_to_results(
    experiment: Experiment, block: CellBlock, outcomes: Sequence[GraphCollisionOutcome]
) -> SolverResults:
    """Return the outcomes of contact graphs as arrays with one entry per cell."""
    return results_of_graphs(outcomes, np.abs(block.parameters["v0"]), experiment.layout.counts.components)


def _masses_and_starts(experiment: Experiment, block: CellBlock) -> tuple[Floats, Floats]:
    """Return the masses in kg and the velocities at first touch in m/s of cells of any kind.

    Both arrays have one row per cell.
    """
    counts = experiment.layout.counts
    if experiment.layout.kind == "graph":
        return masses_and_starts_of_graphs(block.graphs, len(counts.components))
    return masses_and_starts(block.collisions, counts.balls)


def _compare(
    experiment: Experiment, name: str, block: CellBlock, model: SolverResults, results: SolverResults
) -> Comparison:
    """Return the comparison of a solver's results with the model's in the same cells.

    An ArithmeticError is raised if a measure of any cell is larger than `_LARGEST`.
    """
    masses, starts = _masses_and_starts(experiment, block)
    measures = divergence(masses, starts, np.abs(block.parameters["v0"]), model, results)
    both = model.has_result & results.has_result
    for key in ("velocity_divergence", "dretained_energy"):
        sizes = np.abs(measures[key][both])
        if not np.all(sizes <= _LARGEST):
            raise ArithmeticError(f"{key} = {float(sizes.max())!r}; legal: at most {_LARGEST:g}")
    marked = _join_marks(_name_marks(REFERENCE, model.mark), _name_marks(name, results.mark))
    return Comparison(replace(results, curves=None), marked, measures)


def complete_rows(
    experiment: Experiment, block: CellBlock, comparisons: Mapping[str, Comparison]
) -> pa.Table:
    """Return the rows of cells, ordered by cell and then by solver, with all columns.

    Two groups of columns need the results of several solvers. The first is the distance of an engine's limit at a time
    step of zero from the exact solver of its law. The second are the ladders, which split an engine's divergence from
    the model into contributions.
    """
    model = comparisons[REFERENCE]
    engines = {name: comparisons[name] for name in engines_with_ladders(experiment.config)}
    return _rows(
        experiment,
        block,
        comparisons,
        limit_distances=_limit_distances(experiment, block, comparisons),
        ladder_columns=ladders(experiment.config, block, model, engines),
    )


def rows_without_ladders(
    experiment: Experiment,
    block: CellBlock,
    comparisons: Mapping[str, Comparison],
    status: Status,
    reason: str,
) -> pa.Table:
    """Return the rows of cells, ordered by cell and then by solver, where the ladders could not be computed.

    A ladder splits an engine's divergence from the model into contributions. `status` and `reason` stand in the rows of
    engines, and say why there is no ladder.
    """
    ladder_columns = {
        name: {
            "status": np.full(len(block), status, dtype=object),
            "reason": np.full(len(block), f"ladder: {reason}", dtype=object),
            "marked": comparisons[name].marked,
            "limit_error": comparisons[name].results.diagnostic("limit_error"),
        }
        for name in engines_with_ladders(experiment.config)
    }
    return _rows(experiment, block, comparisons, limit_distances={}, ladder_columns=ladder_columns)


def _rows(
    experiment: Experiment,
    block: CellBlock,
    comparisons: Mapping[str, Comparison],
    limit_distances: Mapping[str, Floats],
    ladder_columns: Mapping[str, ColumnArrays],
) -> pa.Table:
    """Return the rows of cells, ordered by cell and then by solver.

    `limit_distances` and `ladder_columns` hold, by solver, the values of the columns that need the results of several
    solvers. If a solver is not in them, its values in these columns are empty.
    """
    names = experiment.config.solvers
    tables = []
    for name in names:
        columns = _columns_of_solver(experiment, name, block, comparisons[REFERENCE], comparisons[name])
        columns["limit_distance"] = limit_distances.get(name, np.full(len(block), np.nan))
        for key, values in ladder_columns.get(name, {}).items():
            columns[LADDER_PREFIX + key] = values
        tables.append(to_table(columns, len(block), experiment.layout.part_schema))
    by_cell = np.arange(len(names) * len(block)).reshape(len(names), len(block)).T.ravel()
    return pa.concat_tables(tables).take(by_cell)


def _columns_of_solver(
    experiment: Experiment, name: str, block: CellBlock, model: Comparison, comparison: Comparison
) -> ColumnArrays:
    """Return the columns of a solver's rows, without the columns that need the results of several solvers."""
    results = comparison.results
    is_reported = results.has_numbers
    masses, starts = _masses_and_starts(experiment, block)

    def where_reported(values: np.ndarray) -> Floats:
        return np.where(is_reported, values, np.nan)

    def texts_where_reported(texts: list[str]) -> NDArray[np.object_]:
        return np.where(is_reported, np.array(texts, dtype=object), "")

    columns: ColumnArrays = {
        **results.diagnostics,  # `to_table` drops all diagnostics that are no columns of the table
        "cell": block.index,
        **block.parameters,
        "solver": np.full(len(block), name, dtype=object),
        "status": results.status,
        "marked": comparison.marked,
        "reason": results.reason,
        "differences": results.differences,
        **{
            f"v{i}": where_reported(v)
            for i, v in zip(experiment.layout.counts.components, results.velocities.T, strict=True)
        },
        **{f"impulse{i}": where_reported(v) for i, v in enumerate(results.impulses.T, 1)},
        "states": texts_where_reported(results.states),
        "states_compared": texts_where_reported(results.compared),
        "n_states": where_reported(results.n_states),
        "n_events": where_reported(results.n_events),
        "grazing_margin": results.margin,
        "retained_energy": where_reported(retained_energy(masses, starts, results)),
        "model_states": np.array(model.results.states, dtype=object),
        "model_states_compared": np.array(model.results.compared, dtype=object),
        "model_status": model.results.status,
        "model_grazing_margin": model.results.margin,
    }
    if experiment.layout.pair:
        scales = (block.parameters[key] for key in ("m2", "m1", "k1"))
        columns["gravity_number"] = experiment.config.gravity_number(*scales)
    if experiment.layout.kind == "graph":
        columns["retained_momentum"] = retained_momentum_of_graphs(block.graphs, masses, starts, results)
        columns["asymmetry"] = where_reported(asymmetry(block.parameters, results))
    else:
        columns["retained_momentum"] = where_reported(retained_momentum(masses, starts, results))
    return columns | comparison.measures


def _limit_distances(
    experiment: Experiment, block: CellBlock, comparisons: Mapping[str, Comparison]
) -> dict[str, Floats]:
    """Return, by solver, the distance of its limit from the exact solution of its law, in every cell.

    The limit is the outcome of an engine at a time step of zero, extrapolated from runs at several steps.

    The distance is the largest difference of a ball's velocity over abs(v0). It is NaN in a cell where the limit or the
    exact solution is missing. A solver is skipped if the run has no exact solver of its law.
    """
    speed = np.abs(block.parameters["v0"])[:, None]
    distances = {}
    for name, comparison in comparisons.items():
        law = exact_solver_for(name, experiment.config.mapping)
        if law in comparisons and law != name:
            exact = comparisons[law].results.velocities_of() / speed
            of_balls = np.abs(comparison.results.limits() - exact)
            both = ~np.isnan(of_balls[:, 0])
            distance = np.full(len(block), np.nan)
            distance[both] = np.nanmax(of_balls[both], axis=1, initial=0.0)
            distances[name] = distance
    return distances


def _join_marks(first: NDArray[np.object_], second: NDArray[np.object_]) -> NDArray[np.object_]:
    """Join two texts in every cell; a semicolon stands between two texts that are not empty."""
    between = np.where((first != "") & (second != ""), "; ", "").astype(object)
    return first + between + second


def _name_marks(name: str, marks: NDArray[np.object_]) -> NDArray[np.object_]:
    """Put the name of a solver before its mark in every cell, but leave an empty mark empty.

    A mark is a text that says why the cell is left out of statistics.
    """
    return np.array([f"{name}: {mark}" if mark else "" for mark in marks], dtype=object)


def shortest_periods(block: CellBlock) -> Floats:
    """Return the shorter of the two contact periods of each pair in s.

    The result is 0 if a contact is rigid, and infinite if both contacts have stiffness 0.
    """
    pairs = Collisions.of(block.collisions)
    m, k = pairs.masses, pairs.stiffnesses
    with np.errstate(divide="ignore", over="ignore"):
        rates = k / np.column_stack([1 / (1 / m[:, 0] + 1 / m[:, 1]), m[:, 1]])
        return 2 * np.pi / np.sqrt(rates.max(axis=1))


def settings_of(config: Config, *, paths: bool = True) -> Settings:
    """Return the settings with which every solver of an experiment is called.

    With `paths`, outcomes have paths over time, provided that the experiment computes all measures.
    """
    convergence, full = config.convergence, config.measures == "all"
    shared = config.model_dump(include={field.name for field in fields(Settings)} - {"convergence"})
    limit = Convergence(convergence.tolerance, convergence.halvings) if convergence.enabled else None
    return Settings(**shared, record_path=paths and full, mark=full, convergence=limit)
