"""A chunk of cells by each solver, as the rows of a part; a call of a sandbox is one solver's.

What crashes or hangs is found by halving (`sandbox.in_halves`), and becomes rows with that status.
"""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import pyarrow as pa

from impact_xval.compliant_baselines.answers import stated_version, why_unavailable
from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.config.cells import Block, experiment_cells
from impact_xval.experiments.config.experiment import REFERENCE, Config, parse_config
from impact_xval.experiments.sweep.executors import in_flight, in_this_process
from impact_xval.experiments.sweep.kernels import compile_once, kernels_for
from impact_xval.experiments.sweep.rows import Experiment, Lost, completed, solve_by, without_ladder
from impact_xval.experiments.sweep.sandbox import (
    TO_PREPARE,
    FaultError,
    Sandbox,
    SandboxError,
    in_halves,
    last_line,
)
from impact_xval.experiments.sweep.third_party import longest
from impact_xval.experiments.tables.schema import Layout
from impact_xval.experiments.tables.store import part_bytes, read_part

#: Seconds for what follows the solvers of a chunk; not their limit, for these are references in closed form, and tables
#: must not depend on how busy a machine is.
_TO_COMPLETE = 600.0

#: Given the rows of a chunk by one solver as soon as they are there; called from any thread.
OnRows = Callable[[pa.Table], None]

Versions = dict[str, str]


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


def solve_chunk(sandbox: Sandbox, number: int, block: Block, on_rows: OnRows | None = None) -> Report:
    """Solve a chunk of cells by each solver of the experiment that the sandbox was given, whatever they do."""
    config: Config = sandbox.context.config
    chunk = _Chunk(sandbox, block, config)
    pieces = []
    for name in config.solvers:
        pieces.append(pa.concat_tables(chunk.solved_by(name)))
        if on_rows is not None and name != REFERENCE:  # it diverges from nothing
            on_rows(pieces[-1])
    rows = pa.concat_tables(pieces)
    by_cell = np.arange(len(rows)).reshape(len(config.solvers), -1).T.ravel()
    rows = pa.concat_tables(chunk.completed(rows.take(by_cell)))
    return Report(number, part_bytes(rows), chunk.seconds, sandbox.prepared, chunk.faults)


def solve_chunks(
    executor: Any,
    chunks: Iterable[tuple[int, Block]],
    layout: Layout,
    on_rows: OnRows | None = None,
) -> Iterator[Report]:
    """Solve numbered chunks of cells, twice as many at a time as there are workers; the reports as they come.

    Parameters
    ----------
    executor : Executor
    chunks : iterable
        Number and cells of each.
    layout : Layout
        Of the rows.
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
            on_rows(read_part(report.data, layout))
        yield report


class _Chunk:
    def __init__(self, sandbox: Sandbox, block: Block, config: Config) -> None:
        self._sandbox, self._cells, self._timeout = sandbox, block, config.cell_timeout
        self._solvers = len(config.solvers)
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
        cell = int(self._cells.index[place.start])
        self._lost[name, cell] = fault.status, fault.reason

        def give_up(_: slice, fault: FaultError) -> pa.Table:
            raise SandboxError(f"cell {cell}, outside of every solver: {fault.reason}")

        return in_halves(lambda _: self._rows(name, place), 1, give_up)[0]

    def completed(self, rows: pa.Table) -> list[pa.Table]:
        """Add to rows, by cell, what needs several solvers; a cell for which that fails has no ladder."""

        def of(place: slice) -> pa.Table:
            return rows.slice(place.start * self._solvers, (place.stop - place.start) * self._solvers)

        def call(place: slice) -> pa.Table:
            try:
                return self._sandbox.call(completed, self._cells[place], of(place), timeout=_TO_COMPLETE)
            except SandboxError as error:
                raise FaultError("crashed", last_line(str(error))) from None

        def failed(place: slice, fault: FaultError) -> pa.Table:
            return without_ladder(self._sandbox.context, of(place), fault.status, f"ladder: {fault.reason}")

        return in_halves(call, len(self._cells), failed)


def prepare(experiment: Experiment) -> Versions:
    """Make a process ready: solve a cell by every solver that needs no engine, so that all is imported and compiled.

    The first rows are theirs, and wait for no engine. What engines need is compiled while other processes are at the
    rest.
    """
    solvers = experiment.config.solvers
    engine_free = [name for name in solvers if not is_engine(name)]
    compile_once(
        kernels_for(experiment.config, engine_free), meanwhile=kernels_for(experiment.config, solvers)
    )
    versions = solver_versions(experiment)
    for name in engine_free:
        _try_out(experiment, name)
    return versions


def make_ready(sandbox: Sandbox, name: str) -> None:
    """Make a sandbox ready for a solver, so that no limit of a call covers what is imported and compiled."""
    sandbox.start()
    if is_engine(name):
        with contextlib.suppress(FaultError):  # its cells are to say so
            sandbox.call(_ready_for, name, timeout=TO_PREPARE)


def _ready_for(experiment: Experiment, name: str) -> None:
    if name not in experiment.ready:
        experiment.ready.add(name)
        compile_once(kernels_for(experiment.config, [name]))
        _try_out(experiment, name)


def _try_out(experiment: Experiment, name: str) -> None:
    """Solve an ordinary cell; one of the experiment may take as long as it is let."""
    pair = experiment.layout.pair
    usual = parse_config(
        {"grid": {"stiffness_ratio": [1.0], "mass_ratio": [2.0], "e1": [0.9], "e2": [0.7]}}
        if pair
        else {"column": {"arrangement": "cradle", "balls": [2]}}
    )
    block = experiment_cells(usual).block(range(1))
    solve_by(Experiment(usual, experiment.resolve), name, block, {})


def solver_versions(experiment: Experiment) -> Versions:
    """Versions of the project and of every solver; why not, for one that is unavailable."""
    versions = {"impact-xval": version("impact-xval")}
    for name in experiment.config.solvers:
        solver = experiment.resolve(name)
        reason = why_unavailable(solver)
        versions[name] = stated_version(solver) if reason is None else f"unavailable: {reason}"
    return versions
