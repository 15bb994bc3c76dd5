"""Solution of a chunk of cells by each solver of an experiment, and compilation of the kernels that solvers need.

Solvers run in worker processes.

A worker process solves the cells of a chunk by one solver at a time. If the process crashes or hangs, the chunk is
halved until the cells that cause this are found (`process.in_halves`). The rows of these cells get a status that says
so, and all other cells keep their results.

The time limit of a cell does not include the import of solvers and the compilation of kernels. One process compiles a
kernel; other processes of this installation wait for its lock and then read the kernel from the cache.

`run` calls `begin_compiling` and `solve_chunks`; the command ``solvers`` calls `ask_version`.
"""

from __future__ import annotations

import contextlib
import gc
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any, TypeVar, TypeVarTuple

import numpy as np
import pyarrow as pa
from filelock import FileLock
from numba.core import event

from impact_xval.compliant_baselines.answers import (
    answer,
    answer_graphs,
    one_line,
    stated_version,
    why_unavailable,
)
from impact_xval.compliant_baselines.engines.scanner import scan
from impact_xval.compliant_baselines.registry import is_engine, is_ours, kind_of
from impact_xval.experiments.config.cells import CellBlock, experiment_cells
from impact_xval.experiments.config.errors import TomlTable
from impact_xval.experiments.config.experiment import REFERENCE, CellKind, parse_config
from impact_xval.experiments.measures.divergence import Comparison, SolverResults
from impact_xval.experiments.measures.hausdorff import distances
from impact_xval.experiments.sweep.pool import TO_STATE, Slot, SlotPool, answers_in_flight
from impact_xval.experiments.sweep.process import FaultError, WorkerError, in_halves, retry_once
from impact_xval.experiments.sweep.rows import (
    Experiment,
    Resolve,
    compare_failure,
    complete_rows,
    model_as_comparison,
    results_without_outcome,
    rows_without_ladders,
    settings_of,
    solve_and_compare,
    solve_by_model,
)
from impact_xval.experiments.tables.folder import part_bytes
from impact_xval.model.chain.kernel import follow_chains
from impact_xval.model.compiled import is_compiled, kernel_cache_folder
from impact_xval.model.pair.kernel import collide_all

#: Function that Numba compiles. This type is defined here, because Numba defines no type for the functions that `njit`
#: returns.
Kernel = Any

#: Time limit in seconds of the steps that follow the solvers: making the rows of a chunk, and the tables and pages of a
#: run. These steps call only references in closed form. The time limit of a cell does not apply to these steps, because
#: tables must not depend on how busy a machine is.
TO_COMPLETE = 600.0

_Answer = TypeVar("_Answer")
_Context = TypeVar("_Context")
_Arguments = TypeVarTuple("_Arguments")

#: Versions of the project and of solvers, by name.
Versions = dict[str, str]
#: Beginning of the text in place of a version, for a solver that cannot run here. The reason follows this beginning.
UNAVAILABLE = "unavailable: "


def begin_compiling(pool: SlotPool[Experiment], experiment: Experiment) -> None:
    """Let two worker processes compile the kernels that are missing in the cache.

    One worker compiles the kernel of chains, which takes as long as all other kernels together. The other worker
    compiles all other kernels.
    """
    kind = experiment.layout.kind
    chains: list[str] = []
    others: list[str] = []
    for name in filter(is_ours, experiment.config.solvers):
        kernel, *_ = kernels_of(name, kind)
        if not is_compiled(kernel):
            (chains if kernel is follow_chains else others).append(name)
    for names in filter(None, (chains, others)):
        pool.submit(_compile_in, names, kind)


def _compile_in(slot: Slot[Experiment], names: Sequence[str], kind: CellKind) -> None:
    """Compile the kernels of the named solvers in the slot's worker process."""
    slot.compile(compile_own, slot.context.resolve, names, kind)


def warm(_: object, resolve: Resolve, name: str, kind: CellKind) -> bool:
    """Solve ordinary cells by a solver, so that its modules are imported and its kernels compiled.

    Return whether any kernel was compiled. A process that has compiled a kernel should be replaced, because its results
    may differ in the last bit from those of processes that read the kernel from the cache. The reason is that helper
    functions are weak symbols of a kernel. A process that has just compiled a helper links its own copy of the helper,
    which was optimised without the code around it.
    """
    experiment, blocks = _ordinary_cells(resolve, kind)
    with event.install_recorder("numba:compile") as compiled, _lock_kernels(*kernels_of(name, kind)):
        for block in blocks:
            model = solve_by_model(experiment, block)
            if name != REFERENCE:
                solve_and_compare(experiment, name, block, model)
    return bool(compiled.buffer)


def compile_own(_: object, resolve: Resolve, names: Sequence[str], kind: CellKind) -> None:
    """Compile the kernel of each named solver by solving ordinary cells with this solver alone.

    The solvers do not check here whether outcomes lie next to a jump, because this check needs the kernels of other
    solvers. Another process can compile these other kernels at the same time. Together with the model's kernel, the
    kernel of distances between impulse curves is compiled, by a call with empty curves. Every comparison of another
    solver with the model needs this kernel.
    """
    experiment, blocks = _ordinary_cells(resolve, kind)
    alone = replace(settings_of(experiment.config), mark=False)
    own = {kernels_of(name, kind)[0] for name in names}
    with _lock_kernels(*own, *([distances] if collide_all in own else [])):
        for name in names:
            for block in blocks:
                if kind == "graph":
                    answer_graphs(resolve(name), block.graphs, alone)
                else:
                    answer(resolve(name), block.collisions, alone)
        if collide_all in own:
            distances(np.empty((0, 2)), np.empty((0, 2)), np.zeros(1, int), np.zeros(1, int))


def _ordinary_cells(resolve: Resolve, kind: CellKind) -> tuple[Experiment, list[CellBlock]]:
    """Return an experiment whose cells any solver solves quickly, with a block of one cell and a block of two.

    Numba compiles a kernel once for contiguous arrays and once for other arrays. In an array with a single row, a
    column is contiguous. In an array with two rows, a column is not contiguous. So both blocks are needed.
    """
    designs: dict[CellKind, TomlTable] = {
        "pair": {"grid": {"stiffness_ratio": [1.0, 2.0], "mass_ratio": [2.0], "e1": [0.9], "e2": [0.7]}},
        "chain": {"chain": {"arrangement": "cradle", "balls": [2], "e": [0.8, 0.9]}},
        "graph": {"graph": {"name": "corner", "angle": 60, "stiffness_ratio": 1, "e": [0.8, 0.9]}},
    }
    usual = parse_config(designs[kind])
    cells = experiment_cells(usual)
    return Experiment(usual, resolve), [cells.block(range(n)) for n in (1, 2)]


@contextlib.contextmanager
def _lock_kernels(*kernels: Kernel) -> Generator[None]:
    """Hold the file locks of all given kernels that are not compiled yet, while the `with` block runs.

    Every process takes the locks in the order of the kernels' names, so that two processes never wait for each other.
    """
    with contextlib.ExitStack() as held:
        for kernel in sorted(kernels, key=lambda kernel: (kernel.__module__, kernel.__name__)):
            if not is_compiled(kernel):
                held.enter_context(FileLock(kernel_cache_folder(kernel) / "compiling.lock"))
                held.callback(gc.enable)
                gc.disable()  # garbage collection takes up to a tenth of the compile time
        yield


def kernels_of(name: str, kind: CellKind) -> list[Kernel]:
    """Return the kernels that the rows of a solver need, with the solver's own kernel first.

    References and engines need the kernel of chains. Engines need it because references find out whether an engine's
    outcome lies next to a jump.
    """
    if kind == "graph":
        # Cells of balls in a line need none of the kernels of graphs, which take a while to import.
        from impact_xval.model.graph.in_time.kernel import follow_timed_graphs
        from impact_xval.model.graph.kernel import follow_graphs

        is_law_in_time = is_ours(name) and kind_of(name) == "reference"
        return [follow_timed_graphs, follow_graphs] if is_law_in_time else [follow_graphs]
    pair = kind == "pair"
    model = collide_all if pair else follow_chains
    if not is_ours(name):
        return [model, distances] if pair else [model]
    own = [scan] if is_engine(name) else []
    if not pair:
        return [*own, model]
    return [model] if name == REFERENCE else [*own, follow_chains, distances, model]


def are_compiled(name: str, kind: CellKind) -> bool:
    """Return whether all kernels that the rows of a solver need are in the cache."""
    return all(map(is_compiled, kernels_of(name, kind)))


@dataclass(frozen=True, slots=True)
class Report:
    """Result of solving a chunk of cells."""

    #: Number of the chunk, which is also the number of the part, the file with the rows of the chunk.
    number: int
    #: Bytes of the part, which is a Parquet file with the rows of the chunk, ordered by cell and then by solver.
    data: bytes
    #: Wall time in s by solver.
    seconds: dict[str, float]
    #: Versions of the solvers on the machine that computed the chunk.
    versions: Versions
    #: Number of worker processes that died, or were ended because they took too long, during this chunk.
    faults: int


def solve_chunks(pool: SlotPool[Experiment], chunks: Iterable[tuple[int, CellBlock]]) -> Iterator[Report]:
    """Solve numbered chunks of cells and yield their reports in the order in which they are finished.

    The number of chunks that are submitted at a time is twice the number of workers, so that no worker has to wait for
    its next chunk.
    """
    return answers_in_flight(
        lambda chunk: pool.submit(solve_chunk, *chunk), chunks, lambda: max(2, 2 * pool.workers)
    )


def solve_chunk(slot: Slot[Experiment], number: int, block: CellBlock) -> Report:
    """Solve a chunk of cells by each solver of the experiment, and return its rows in a report.

    A solver that crashes, hangs or cannot run here gets rows too. These rows say why there are no results.
    """
    experiment = slot.context
    chunk = Chunk(slot, block)
    model = chunk.solve_by_model()
    comparisons = {REFERENCE: model_as_comparison(model)}
    for name in experiment.others:
        comparisons[name] = chunk.solve_and_compare(name, model)
    rows = chunk.rows(comparisons)
    return Report(number, part_bytes(rows), dict(chunk.seconds), solver_versions(slot), chunk.faults)


class Chunk:
    """Chunk of cells that the worker processes of a slot solve, with the time and the crashes so far."""

    def __init__(self, slot: Slot[Experiment], block: CellBlock) -> None:
        self._slot, self._cells = slot, block
        self._experiment = slot.context
        #: Wall time in s by solver.
        self.seconds: dict[str, float] = defaultdict(float)
        #: Number of worker processes that died, or were ended because they took too long, while a solver ran.
        self.faults = 0

    def solve_by_model(self) -> SolverResults:
        """Solve the cells by the model and return its results.

        If the process dies in a cell, the status of the cell says so.
        """

        def solve(place: slice) -> SolverResults:
            return self._call_solver(REFERENCE, solve_by_model, self._cells[place])

        def failure(place: slice, fault: FaultError) -> SolverResults:
            cells = self._cells[place]
            return self._call_ours(results_without_outcome, REFERENCE, cells, fault.status, fault.reason)

        return SolverResults.concatenate(in_halves(solve, len(self._cells), failure))

    def solve_and_compare(self, name: str, model: SolverResults) -> Comparison:
        """Solve the cells by a solver and return the comparison of its results with the model's.

        If the process dies in a cell, the status of the cell says so. If the solver cannot run here, the reason stands
        in all cells.
        """

        def solve(place: slice) -> Comparison:
            return self._call_solver(name, solve_and_compare, name, self._cells[place], model[place])

        def failure(place: slice, fault: FaultError) -> Comparison:
            cells = self._cells[place]
            return self._call_ours(compare_failure, name, cells, model[place], fault.status, fault.reason)

        stated = solver_versions(self._slot)[name]
        if stated.startswith(UNAVAILABLE):
            reason = stated.removeprefix(UNAVAILABLE)
            return failure(slice(None), FaultError("unavailable", reason))
        return Comparison.concatenate(in_halves(solve, len(self._cells), failure))

    def rows(self, comparisons: Mapping[str, Comparison]) -> pa.Table:
        """Return the rows of the cells, ordered by cell and then by solver.

        Ladders split the divergence of engines into contributions. If the ladders of a cell cannot be computed, the
        rows of this cell have no ladders and say why.
        """

        def of(place: slice) -> dict[str, Comparison]:
            return {name: comparison[place] for name, comparison in comparisons.items()}

        def complete(place: slice) -> pa.Table:
            try:
                return self._slot.call(
                    None, complete_rows, self._cells[place], of(place), timeout=TO_COMPLETE
                )
            except WorkerError as error:
                last_line = str(error).strip().rpartition("\n")[2]
                raise FaultError("crashed", one_line(last_line)) from None

        def failure(place: slice, fault: FaultError) -> pa.Table:
            cells = self._cells[place]
            return rows_without_ladders(self._experiment, cells, of(place), fault.status, fault.reason)

        return pa.concat_tables(in_halves(complete, len(self._cells), failure))

    def _call_solver(
        self, name: str, function: Callable[[Experiment, *_Arguments], _Answer], *arguments: *_Arguments
    ) -> _Answer:
        """Return the result of a function in the worker process of a solver, within the time limit of a cell.

        The process is first made ready for the solver. The time limit does not include this.
        """
        experiment = self._experiment
        self._slot.prepare(name, warm, experiment.resolve, name, experiment.layout.kind)
        start, limit = time.perf_counter(), experiment.config.cell_timeout
        try:
            return self._slot.call(name, function, *arguments, timeout=limit)
        except FaultError:
            self.faults += 1
            raise
        finally:
            self.seconds[name] += time.perf_counter() - start

    def _call_ours(
        self, function: Callable[[Experiment, *_Arguments], _Answer], *arguments: *_Arguments
    ) -> _Answer:
        """Return the result of a function in the worker process of the project's solvers.

        The function calls no solver. If the process crashes, the function is called a second time.
        """

        def give_up(fault: FaultError) -> _Answer:
            raise fault

        return retry_once(lambda: self._slot.call(None, function, *arguments, timeout=TO_COMPLETE), give_up)


def solver_versions(slot: Slot[Experiment]) -> Versions:
    """Return the versions of the project and of every solver of the experiment, by name.

    Only the first call asks the solvers for their versions. For a solver that cannot run here, `UNAVAILABLE` and the
    reason stand in place of the version.
    """
    if not slot.versions:
        found = {"impact-xval": version("impact-xval")}
        for name in slot.context.config.solvers:
            said, reason = ask_version(slot, slot.context.resolve, name)
            found[name] = said if reason is None else UNAVAILABLE + reason
        slot.versions = found
    return slot.versions


def ask_version(slot: Slot[_Context], resolve: Resolve, name: str) -> tuple[str, str | None]:
    """Return the version of a solver and the reason why it cannot run here, or None if it can.

    Both come from the worker process of the solver.
    """
    return retry_once(
        lambda: slot.call(name, _version_and_reason, resolve, name, timeout=TO_STATE),
        lambda fault: ("", f"asked what it is, it gave no answer: {fault.reason}"),
    )


def _version_and_reason(_: object, resolve: Resolve, name: str) -> tuple[str, str | None]:
    """Return the version of a solver and the reason why it cannot run here, or None if it can."""
    solver = resolve(name)
    return stated_version(solver), why_unavailable(solver)
