"""A chunk of cells by each solver, as the rows of a part; a call of a process is one solver's.

What crashes or hangs is found by halving (`process.in_halves`), and becomes rows with that status.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np
import pyarrow as pa

from impact_xval.compliant_baselines.answers import one_line
from impact_xval.compliant_baselines.registry import is_ours
from impact_xval.experiments.config.cells import Block
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.sweep.pool import Slot, in_flight
from impact_xval.experiments.sweep.process import FaultError, WorkerError, in_halves
from impact_xval.experiments.sweep.rows import Experiment, Lost, completed, solve_by, without_ladder
from impact_xval.experiments.sweep.warmup import compile_own, kernels_of, stated, warm
from impact_xval.experiments.tables.folder import part_bytes
from impact_xval.model.chain.kernel import follow_chains
from impact_xval.model.compiled import is_compiled

#: Seconds for what follows the solvers of a chunk, or the cells of a run; not their limit, for these are references in
#: closed form, and tables must not depend on how busy a machine is.
TO_COMPLETE = 600.0

Versions = dict[str, str]
#: In the place of a version; why not follows.
UNAVAILABLE = "unavailable: "


@dataclass(frozen=True, slots=True)
class Report:
    """What came of a chunk."""

    number: int
    data: bytes  # the content of a part: rows by cell, then by solver
    seconds: dict[str, float]  # wall time by solver
    versions: Versions  # where it was computed
    faults: int  # processes that died or were ended


def solve_chunks(pool: Any, chunks: Iterable[tuple[int, Block]]) -> Iterator[Report]:
    """Solve numbered chunks of cells, twice as many at a time as there are workers; the reports as they come."""
    return in_flight(lambda chunk: pool.submit(solve_chunk, *chunk), chunks, lambda: max(2, 2 * pool.workers))


def begin_compiling(pool: Any, experiment: Experiment) -> None:
    """Have kernels compiled that are not, by two workers: that of N balls takes as long as all others together."""
    pair, chains, others = experiment.layout.pair, [], []
    for name in filter(is_ours, experiment.config.solvers):
        kernel, *_ = kernels_of(name, pair=pair)
        if not is_compiled(kernel):
            (chains if kernel is follow_chains else others).append(name)
    for names in filter(None, (chains, others)):
        pool.submit(Slot.compile, compile_own, experiment.resolve, names, pair)


def solve_chunk(slot: Slot, number: int, block: Block) -> Report:
    """Solve a chunk of cells by each solver of the experiment, whatever they do."""
    names = slot.context.config.solvers
    chunk = Chunk(slot, block)
    rows = pa.concat_tables([part for name in names for part in chunk.solved_by(name)])
    by_cell = np.arange(len(rows)).reshape(len(names), -1).T.ravel()
    rows = pa.concat_tables(chunk.completed(rows.take(by_cell)))
    return Report(number, part_bytes(rows), dict(chunk.seconds), slot.once(solver_versions), chunk.faults)


class Chunk:
    """Cells that are solved by the processes of a slot, and what was lost of them."""

    def __init__(self, slot: Slot, block: Block) -> None:
        self._slot, self._cells = slot, block
        self._config: Config = slot.context.config
        self._lost: Lost = {}
        self.seconds: dict[str, float] = defaultdict(float)
        self.faults = 0

    def solved_by(self, name: str) -> list[pa.Table]:
        """Rows of a solver, in pieces: where it dies, without an answer."""
        said = self._slot.once(solver_versions)[name]
        if said.startswith(UNAVAILABLE):
            fault = FaultError("unavailable", said.removeprefix(UNAVAILABLE))
            return [self._failed(name, slice(None), fault)]
        return in_halves(partial(self._rows, name), len(self._cells), partial(self._failed, name))

    def _rows(self, name: str, place: slice) -> pa.Table:
        experiment: Experiment = self._slot.context
        self._slot.prepare(name, warm, experiment.resolve, name, experiment.layout.pair)
        start, limit = time.perf_counter(), self._config.cell_timeout
        try:
            return self._slot.call(name, solve_by, name, self._cells[place], self._lost, timeout=limit)
        except FaultError:
            self.faults += 1
            raise
        finally:
            self.seconds[name] += time.perf_counter() - start

    def _failed(self, name: str, place: slice, fault: FaultError) -> pa.Table:
        """Rows of cells that are lost to a solver, by our process: it asks that solver nothing."""
        cells = self._cells[place]
        self._lost |= dict.fromkeys(
            ((name, cell) for cell in cells.index.tolist()), (fault.status, fault.reason)
        )

        def call(_: slice) -> pa.Table:
            return self._slot.call(None, solve_by, name, cells, self._lost, timeout=TO_COMPLETE)

        def give_up(_: slice, fault: FaultError) -> pa.Table:
            raise fault

        return in_halves(call, 1, give_up)[0]

    def completed(self, rows: pa.Table) -> list[pa.Table]:
        """Add to rows, by cell, what needs several solvers; a cell for which that fails has no ladder."""
        each = len(self._config.solvers)

        def of(place: slice) -> pa.Table:
            return rows.slice(place.start * each, (place.stop - place.start) * each)

        def call(place: slice) -> pa.Table:
            try:
                return self._slot.call(None, completed, self._cells[place], of(place), timeout=TO_COMPLETE)
            except WorkerError as error:
                last = str(error).strip().rpartition("\n")[2]
                raise FaultError("crashed", one_line(last)) from None

        def failed(place: slice, fault: FaultError) -> pa.Table:
            return without_ladder(self._slot.context, of(place), fault.status, f"ladder: {fault.reason}")

        return in_halves(call, len(self._cells), failed)


def solver_versions(slot: Slot) -> Versions:
    """Versions of the project and of every solver; why not, for one that is unavailable."""
    experiment: Experiment = slot.context
    found = {"impact-xval": version("impact-xval")}
    for name in experiment.config.solvers:
        said, reason = stated(slot, experiment.resolve, name)
        found[name] = said if reason is None else UNAVAILABLE + reason
    return found
