"""A chunk of cells by each solver, as the rows of a part, and what a process needs before its first cell.

A call of a process is one solver's. What crashes or hangs is found by halving (`process.in_halves`), and becomes rows
with that status. Solvers are imported and kernels compiled outside of every limit of a cell: by one process of an
installation, while others wait for its lock, and read them from the cache then.
"""

from __future__ import annotations

import contextlib
import gc
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np
import pyarrow as pa
from filelock import FileLock
from numba.core import event

from impact_xval.compliant_baselines.answers import answer, one_line, stated_version, why_unavailable
from impact_xval.compliant_baselines.engines.stepping import scan
from impact_xval.compliant_baselines.registry import is_engine, is_ours
from impact_xval.experiments.config.cells import Block, experiment_cells
from impact_xval.experiments.config.experiment import REFERENCE, Config, parse_config
from impact_xval.experiments.measures.hausdorff import distances
from impact_xval.experiments.sweep.pool import TO_STATE, Slot, in_flight
from impact_xval.experiments.sweep.process import FaultError, WorkerError, in_halves, retry_once
from impact_xval.experiments.sweep.rows import (
    Experiment,
    Lost,
    Resolve,
    completed,
    settings_of,
    solve_by,
    without_ladder,
)
from impact_xval.experiments.tables.folder import part_bytes
from impact_xval.model.chain.kernel import follow_chains
from impact_xval.model.compiled import cache_folder, is_compiled
from impact_xval.model.pair.kernel import collide_all

#: In the order in which they are locked.
_KERNELS: tuple[Any, ...] = (collide_all, distances, follow_chains, scan)

#: Seconds for what follows the solvers of a chunk, or the cells of a run; not their limit, for these are references in
#: closed form, and tables must not depend on how busy a machine is.
TO_COMPLETE = 600.0

Versions = dict[str, str]
#: In the place of a version; why not follows.
UNAVAILABLE = "unavailable: "


def begin_compiling(pool: Any, experiment: Experiment) -> None:
    """Have kernels compiled that are not, by two workers: that of N balls takes as long as all others together."""
    pair, chains, others = experiment.layout.pair, [], []
    for name in filter(is_ours, experiment.config.solvers):
        kernel, *_ = kernels_of(name, pair=pair)
        if not is_compiled(kernel):
            (chains if kernel is follow_chains else others).append(name)
    for names in filter(None, (chains, others)):
        pool.submit(Slot.compile, compile_own, experiment.resolve, names, pair)


def warm(_: object, resolve: Resolve, name: str, pair: bool) -> bool:
    """Solve ordinary cells by a solver, of two balls or chains, so that all is imported and compiled; whether any was.

    Such a process may differ in a last bit from those that read the kernels. The parts of a kernel are weak symbols of
    it: where they have just been compiled alone, these are linked, and they were optimised in other surroundings.
    """
    experiment, blocks = _usual(resolve, pair)
    with event.install_recorder("numba:compile") as compiled, _compiling(*kernels_of(name, pair=pair)):
        for block in blocks:
            solve_by(experiment, name, block, {})
    return bool(compiled.buffer)


def compile_own(_: object, resolve: Resolve, names: Sequence[str], pair: bool) -> None:
    """Have each solver solve cells by itself, so that another process can compile the kernels of others meanwhile.

    With the model, distances of nothing are measured, for all others need them.
    """
    experiment, blocks = _usual(resolve, pair)
    alone = replace(settings_of(experiment.config), mark=False)
    own = {kernels_of(name, pair=pair)[0] for name in names}
    with _compiling(*own, *([distances] if collide_all in own else [])):
        for name in names:
            for block in blocks:
                answer(resolve(name), block.collisions, alone)
        if collide_all in own:
            distances(np.empty((0, 2)), np.empty((0, 2)), np.zeros(1, int), np.zeros(1, int))


def _usual(resolve: Resolve, pair: bool) -> tuple[Experiment, list[Block]]:
    """Return an experiment of cells that any solver does at once, one of them and two.

    A column of an array is contiguous where that has one row only, and numba compiles for either.
    """
    grid = {"stiffness_ratio": [1.0, 2.0], "mass_ratio": [2.0], "e1": [0.9], "e2": [0.7]}
    chain = {"arrangement": "cradle", "balls": [2], "e": [0.8, 0.9]}
    usual = parse_config({"grid": grid} if pair else {"chain": chain})
    cells = experiment_cells(usual)
    return Experiment(usual, resolve), [cells.block(range(n)) for n in (1, 2)]


@contextlib.contextmanager
def _compiling(*kernels: Any) -> Iterator[None]:
    """Hold the locks of kernels that are not compiled yet, in one order everywhere."""
    with contextlib.ExitStack() as held:
        for kernel in _KERNELS:
            if kernel in kernels and not is_compiled(kernel):
                held.enter_context(FileLock(cache_folder(kernel) / "compiling.lock"))
                held.callback(gc.enable)
                gc.disable()  # looking for garbage takes up to a tenth of the time of compiling
        yield


def kernels_of(name: str, *, pair: bool) -> list[Any]:
    """Kernels that rows of a solver need, its own first: references, and marks of engines, follow chains."""
    model = collide_all if pair else follow_chains
    if not is_ours(name):
        return [model, distances] if pair else [model]
    own = [scan] if is_engine(name) else []
    if not pair:
        return [*own, model]
    return [model] if name == REFERENCE else [*own, follow_chains, distances, model]


def are_compiled(name: str, *, pair: bool) -> bool:
    """Whether the kernels that rows of a solver need are in the cache."""
    return all(map(is_compiled, kernels_of(name, pair=pair)))


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


def solve_chunk(slot: Slot, number: int, block: Block) -> Report:
    """Solve a chunk of cells by each solver of the experiment, whatever they do."""
    names = slot.context.config.solvers
    chunk = Chunk(slot, block)
    rows = pa.concat_tables([part for name in names for part in chunk.solved_by(name)])
    by_cell = np.arange(len(rows)).reshape(len(names), -1).T.ravel()
    rows = pa.concat_tables(chunk.completed(rows.take(by_cell)))
    return Report(number, part_bytes(rows), dict(chunk.seconds), solver_versions(slot), chunk.faults)


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
        said = solver_versions(self._slot)[name]
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

        def call() -> pa.Table:
            return self._slot.call(None, solve_by, name, cells, self._lost, timeout=TO_COMPLETE)

        def give_up(fault: FaultError) -> pa.Table:
            raise fault

        return retry_once(call, give_up)

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
    """Versions of the project and of every solver; why not, for one that is unavailable. They are asked once."""
    if not slot.versions:
        found = {"impact-xval": version("impact-xval")}
        for name in slot.context.config.solvers:
            said, reason = stated(slot, slot.context.resolve, name)
            found[name] = said if reason is None else UNAVAILABLE + reason
        slot.versions = found
    return slot.versions


def stated(slot: Slot, resolve: Resolve, name: str) -> tuple[str, str | None]:
    """Ask a solver for its version, and why it cannot run; both in its own process."""
    return retry_once(
        lambda: slot.call(name, _stated, resolve, name, timeout=TO_STATE),
        lambda fault: ("", f"asked what it is, it gave no answer: {fault.reason}"),
    )


def _stated(_: object, resolve: Resolve, name: str) -> tuple[str, str | None]:
    solver = resolve(name)
    return stated_version(solver), why_unavailable(solver)
