"""A chunk of cells by each solver, as the rows of a part; a call of a sandbox is one solver's.

What crashes or hangs is found by halving (`sandbox.in_halves`), and becomes rows with that status.
"""

from __future__ import annotations

import contextlib
import functools
import math
import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np
import pyarrow as pa

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contact.column import shorter_period
from impact_xval.compliant_baselines.contract.answers import answer, said, stated_version, why_unavailable
from impact_xval.compliant_baselines.contract.registry import kind_of
from impact_xval.compliant_baselines.contract.solver import Convergence, Settings, Solver
from impact_xval.compliant_baselines.contract.state_runs import compared_states
from impact_xval.experiments.config.configuration import REFERENCE, Config, parse_config
from impact_xval.experiments.config.grid import GridCell, collision_of
from impact_xval.experiments.measures.divergence import divergence
from impact_xval.experiments.sweep.executors import in_flight, in_this_process
from impact_xval.experiments.sweep.kernels import compile_once, kernels_of
from impact_xval.experiments.sweep.sandbox import TO_PREPARE, FaultError, Sandbox, SandboxError, in_halves
from impact_xval.experiments.sweep.third_party import longest
from impact_xval.experiments.tables.schema import CERTIFICATE, MEASURES, ROW_SCHEMA
from impact_xval.experiments.tables.store import part_bytes, read_part
from impact_xval.model.collision import RESULT_STATUSES, Outcome, Status
from impact_xval.model.columns.column import ColumnOutcome

#: Finds a solver by its name; a function at the top level of a module, so that worker processes can find it.
Resolve = Callable[[str], Solver]

#: Given the rows of a chunk by one solver as soon as they are there; called from any thread.
OnRows = Callable[[pa.Table], None]

#: Status and reason of what is lost: of a solver (by name) at a cell (by index).
Lost = dict[tuple[str, int], tuple[Status, str]]
Versions = dict[str, str]

#: Diagnostics in m/s; tables and JSON state them per abs(v0).
_VELOCITY = re.compile(r"v\d+_limit|limit_error|velocity_error|regularisation|rest_speed")

#: Largest measure, and number of a certificate; the square of a larger one leaves double precision.
_LARGEST = 1e150


@dataclass
class Experiment:
    """What every process of a run is given once.

    Attributes
    ----------
    config : Config
        The experiment; its first solver is the reference.
    resolve : callable
        Finds a solver by its name.
    ready : set of str
        The engines, and solvers of other distributions, that this process is ready for (`make_ready`).
    """

    config: Config
    resolve: Resolve = get_solver
    ready: set[str] = field(default_factory=set, init=False, repr=False)
    _models: tuple[Any, list[Outcome]] = field(default=(None, []), init=False, repr=False)

    def outcomes(self, name: str, cells: Sequence[GridCell], lost: Lost) -> list[Outcome]:
        """Solve cells by a solver; those that are lost to it are failures."""
        asked = [cell.collision for cell in cells if (name, cell.index) not in lost]
        found = iter(answer(self.resolve(name), asked, settings_of(self.config)) if asked else [])
        return [
            Outcome.failure(name, *lost[name, cell.index]) if (name, cell.index) in lost else next(found)
            for cell in cells
        ]

    def models(self, cells: Sequence[GridCell], lost: Lost) -> list[Outcome]:
        """Solve cells by the reference; kept for the next solver of the same cells."""
        if self._models[0] != list(cells):
            self._models = list(cells), self.outcomes(REFERENCE, cells, lost)
        return self._models[1]


@dataclass(frozen=True, slots=True)
class Report:
    """What came of a chunk.

    Attributes
    ----------
    number : int
        Number of the chunk.
    data : bytes
        Its rows, by cell, then by solver, as the content of a part.
    seconds : dict
        Wall time by solver.
    versions : dict
        Of the project and of every solver where the chunk was computed.
    faults : int
        Processes that died or were ended.
    """

    number: int
    data: bytes
    seconds: dict[str, float]
    versions: Versions | None
    faults: int


def solve_chunk(
    sandbox: Sandbox, number: int, cells: Sequence[GridCell], on_rows: OnRows | None = None
) -> Report:
    """Solve a chunk of cells by each solver of the experiment that the sandbox was given, whatever they do."""
    config: Config = sandbox.context.config
    chunk = _Chunk(sandbox, cells, config)
    pieces = []
    for name in config.solvers:
        pieces.append(pa.concat_tables(chunk.solved_by(name)))
        if on_rows is not None and name != REFERENCE:  # it diverges from nothing
            on_rows(pieces[-1])
    rows = pa.concat_tables(pieces)
    by_cell = np.arange(len(rows)).reshape(len(config.solvers), -1).T.ravel()
    return Report(number, part_bytes(rows.take(by_cell)), chunk.seconds, sandbox.prepared, chunk.faults)


def solve_chunks(
    executor: Any, chunks: Iterable[tuple[int, Sequence[GridCell]]], on_rows: OnRows | None = None
) -> Iterator[Report]:
    """Solve numbered chunks of cells, twice as many at a time as there are workers; the reports as they come.

    Parameters
    ----------
    executor : Executor
    chunks : iterable
        Number and cells of each.
    on_rows : callable, optional
        Given rows solver by solver, or where the executor's threads are other processes', a whole chunk.
    """
    here = in_this_process(executor)
    submitted = in_flight(
        lambda chunk: executor.submit(solve_chunk, *chunk, on_rows if here else None),
        chunks,
        lambda: max(2, 2 * executor.workers),
    )
    for report in submitted:
        if on_rows is not None and not here:
            on_rows(read_part(report.data))
        yield report


class _Chunk:
    def __init__(self, sandbox: Sandbox, cells: Sequence[GridCell], config: Config) -> None:
        self._sandbox, self._cells, self._timeout = sandbox, cells, config.cell_timeout
        self._lost: Lost = {}
        self.seconds = dict.fromkeys(config.solvers, 0.0)
        self.faults = 0

    def solved_by(self, name: str) -> list[pa.Table]:
        rows, failed = functools.partial(self._rows, name), functools.partial(self._failed, name)
        return in_halves(rows, len(self._cells), failed)

    def _rows(self, name: str, place: slice) -> pa.Table:
        make_ready(self._sandbox, name)
        start, cells = time.perf_counter(), self._cells[place]
        limit = longest(name, len(cells), self._timeout)
        try:
            return self._sandbox.call(solve_by, name, cells, self._lost, timeout=limit)
        except FaultError:
            self.faults += 1
            raise
        finally:
            self.seconds[name] += time.perf_counter() - start

    def _failed(self, name: str, place: slice, fault: FaultError) -> pa.Table:
        cell = self._cells[place.start].index
        self._lost[name, cell] = fault.status, fault.reason

        def give_up(_: slice, fault: FaultError) -> pa.Table:
            raise SandboxError(f"cell {cell}, outside of every solver: {fault.reason}")

        return in_halves(lambda _: self._rows(name, place), 1, give_up)[0]


def prepare(experiment: Experiment) -> Versions:
    """Make a process ready: solve a cell by every solver that needs no engine, so that all is imported and compiled.

    The first rows are theirs, and wait for no engine. What engines need is compiled while other processes are at the
    rest.
    """
    solvers = experiment.config.solvers
    engine_free = [name for name in solvers if kind_of(name) != "engine"]
    compile_once(kernels_of(engine_free), meanwhile=kernels_of(solvers))
    versions = solver_versions(experiment)
    for name in engine_free:
        _try_out(experiment, name)
    return versions


def make_ready(sandbox: Sandbox, name: str) -> None:
    """Make a sandbox ready for a solver, so that no limit of a call covers what is imported and compiled."""
    sandbox.start()
    if kind_of(name) == "engine":
        with contextlib.suppress(FaultError):  # its cells are to say so
            sandbox.call(_ready_for, name, timeout=TO_PREPARE)


def _ready_for(experiment: Experiment, name: str) -> None:
    if name not in experiment.ready:
        experiment.ready.add(name)
        compile_once(kernels_of([name]))
        _try_out(experiment, name)


def _try_out(experiment: Experiment, name: str) -> None:
    """Solve an ordinary cell; one of the experiment may take as long as it is let."""
    ordinary = parse_config({})
    cell = GridCell(0, 1.0, 1.0, collision_of(ordinary, ordinary.figure_cell))
    solve_by(Experiment(ordinary, experiment.resolve), name, [cell], {})


def solve_all(experiment: Experiment, cells: Sequence[GridCell]) -> pa.Table:
    """Solve cells by every solver; the rows by solver, then by cell."""
    return pa.concat_tables([solve_by(experiment, name, cells, {}) for name in experiment.config.solvers])


def solve_by(experiment: Experiment, name: str, cells: Sequence[GridCell], lost: Lost) -> pa.Table:
    """Solve cells by one solver and compare it with the reference.

    Parameters
    ----------
    experiment : Experiment
    name : str
        Of the solver.
    cells : sequence of GridCell
    lost : dict
        Solvers that are not called for a cell, with the status and reason of that row.

    Returns
    -------
    Table
        A row for each cell, with the columns of `schema.ROW_SCHEMA`.
    """
    models = experiment.models(cells, lost)
    outcomes = models if name == REFERENCE else experiment.outcomes(name, cells, lost)
    rows = [_guarded(experiment.config, name, *each) for each in zip(cells, models, outcomes, strict=True)]
    return pa.Table.from_pylist(rows, schema=ROW_SCHEMA)


def solver_versions(experiment: Experiment) -> Versions:
    """Versions of the project and of every solver; why not, for one that is unavailable."""
    versions = {"impact-xval": version("impact-xval")}
    for name in experiment.config.solvers:
        solver = experiment.resolve(name)
        reason = why_unavailable(solver)
        versions[name] = stated_version(solver) if reason is None else f"unavailable: {reason}"
    return versions


def settings_of(config: Config) -> Settings:
    """Return the settings of every solver of an experiment; outcomes carry their paths."""
    return Settings(
        scenario=config.scenario,
        gravity=config.gravity,
        step_fraction=config.step_fraction,
        max_steps=config.max_steps,
        mapping=config.mapping,
        shortest_state=config.shortest_state,
        record_path=True,
        stiffness_ratio_cutoff=config.stiffness_ratio_cutoff,
        grazing_threshold=config.grazing_threshold,
        convergence=Convergence(config.convergence.tolerance, config.convergence.halvings)
        if config.convergence.enabled
        else None,
    )


def scaled_diagnostics(outcome: Outcome | ColumnOutcome, speed: float) -> dict[str, float]:
    """Return the diagnostics of an outcome with velocities per a speed in m/s; the others as they are, times in s."""
    return {
        name: value / speed if _VELOCITY.fullmatch(name) and value is not None else value
        for name, value in outcome.diagnostics.items()
    }


def _marked(model: Outcome, outcome: Outcome) -> str:
    """Say what a comparison of an outcome with the model's lies beside: a jump of either, or a cut-off."""
    both = (model, outcome) if outcome is not model else (model,)
    return "; ".join(f"{each.solver}: {each.marked}" for each in both if each.marked)


def _guarded(config: Config, name: str, cell: GridCell, model: Outcome, outcome: Outcome) -> dict[str, Any]:
    """Make the row of a cell and solver, whatever the measures make of its outcome."""
    try:
        row = _row(config, name, cell, model, outcome)
        for column in (*MEASURES, *CERTIFICATE):
            value = row.get(column)
            if isinstance(value, float) and not abs(value) <= _LARGEST:
                raise ArithmeticError(f"{column} = {value!r}; legal: at most {_LARGEST:g}")
    except Exception as error:
        failure = Outcome.failure(name, "crashed", f"measuring its outcome: {said(error)}")
        return _facts(config, name, cell, model, failure)
    return row


def _facts(config: Config, name: str, cell: GridCell, model: Outcome, outcome: Outcome) -> dict[str, Any]:
    """Give what a row holds without being measured."""
    c, diagnostics = cell.collision, scaled_diagnostics(outcome, abs(cell.collision.v0))
    return {
        "cell": cell.index,
        "stiffness_ratio": cell.stiffness_ratio,
        "mass_ratio": cell.mass_ratio,
        **{name: getattr(c, name) for name in ("e1", "e2", "m1", "m2", "k1", "k2", "v0")},
        "solver": name,
        "status": outcome.status,
        "reason": outcome.reason or None,
        "grazing_margin": outcome.grazing_margin,
        "marked": _marked(model, outcome) or None,
        "gravity_number": config.gravity_number(c.m2),
        "step": diagnostics.get("step"),
        "n_steps": _whole(diagnostics.get("n_steps")),
        "duration": diagnostics.get("duration"),
        **{column: diagnostics.get(column) for column in CERTIFICATE},
        "model_states": " ".join(model.states) or None,
        "model_status": model.status,
        "model_grazing_margin": model.grazing_margin,
    }


def _row(config: Config, name: str, cell: GridCell, model: Outcome, outcome: Outcome) -> dict[str, Any]:
    c = cell.collision
    shortest = config.shortest_state * shorter_period(c)
    paths = compared_states(model, shortest), compared_states(outcome, shortest)
    row = _facts(config, name, cell, model, outcome)
    row["model_states_compared"] = " ".join(paths[0]) or None
    if name != REFERENCE:  # the model's divergence from itself is in no table
        row |= divergence(c, model, outcome, paths)
    # A result that is not converged keeps the numbers it came to, but is no measure of anything.
    if outcome.status in (*RESULT_STATUSES, "unconverged") and math.isfinite(outcome.v1):
        row |= {
            "v1": outcome.v1,
            "v2": outcome.v2,
            "impulse1": outcome.impulse1,
            "impulse2": outcome.impulse2,
            "states": " ".join(outcome.states),
            "states_compared": " ".join(paths[1]),
            "n_states": len(outcome.states),
            "n_events": outcome.n_events,
            "retained_energy": outcome.retained_energy(c),
        }
    return row


def _whole(value: float | None) -> int | None:
    return None if value is None else int(value)
