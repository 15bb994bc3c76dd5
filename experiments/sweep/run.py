"""Run of an experiment: all cells are solved by all solvers, and the tables are written into the folder of the run.

The work is done on this machine or on a Dask cluster. A run that was stopped continues from the parts that it has
written. The commands ``run`` and ``hypothesis`` call `run_sweep`; `present_once` then draws figures and writes pages.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import platform
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Protocol, TypeVar, TypeVarTuple

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.config.cells import ExperimentCells, experiment_cells
from impact_xval.experiments.config.errors import InterruptedRunError, UserError
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.sweep.chunk import (
    TO_COMPLETE,
    UNAVAILABLE,
    Versions,
    begin_compiling,
    solve_chunks,
    solver_versions,
)
from impact_xval.experiments.sweep.curves import write_curves
from impact_xval.experiments.sweep.pool import SlotPool, available_cores, cluster, open_pool
from impact_xval.experiments.sweep.process import ClosedError
from impact_xval.experiments.sweep.rows import Experiment, Resolve
from impact_xval.experiments.tables.folder import (
    COMPLETE,
    FINISHED,
    RUNNING,
    TABLES,
    Manifest,
    RunFolder,
    Session,
    lock_for_writing,
    presenting_lock,
    read_part,
    statuses_of,
    tables_lock,
)

#: Type of a function that reports progress. Its arguments are the number of cells that are done, the number of all
#: cells, and a line for the user, or an empty text.
Progress = Callable[[int, int, str], None]

_Answer = TypeVar("_Answer")
_Presented = TypeVar("_Presented")
_Arguments = TypeVarTuple("_Arguments")


class Apart(Protocol):
    """Type of a function that lets a worker process on this machine call another function, while the caller goes on."""

    def __call__(
        self, function: Callable[[None, *_Arguments], _Answer], *arguments: *_Arguments
    ) -> Future[_Answer]:
        """Have ``function(None, *arguments)`` called; return the future of the function's result."""
        ...


@dataclass(frozen=True, slots=True)
class SweepResult:
    """Result of one session of a run: the work of one command, from its start to its end."""

    folder: RunFolder
    #: Whether the folder has the finished tables. It is false while other shards still compute parts.
    tables_complete: bool


def run_sweep(
    config: Config,
    root: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    shard: tuple[int, int] = (1, 1),
    isolate: bool = True,
    progress: Progress = lambda done, total, line: None,
    resolve: Resolve = get_solver,
    to_be_presented: bool = False,
) -> SweepResult:
    """Solve all cells of an experiment by all solvers, and write the results into a folder.

    The results are first written as parts, one file for each chunk of cells. When all parts are there, the curves of
    the figures, the finished tables and the manifest are written.

    Parameters
    ----------
    config : Config
    root : Path
        A new or empty folder, or the folder of a run of the same experiment. Such a run is continued: its parts are
        kept.
    workers : int, optional
        Number of worker processes on this machine; no result depends on it. By default it is the number in the
        configuration; if that has no number, one process for each core is used.
    scheduler : str, optional
        Address of the scheduler of a Dask cluster on which the cells are solved.
    shard : tuple of int and int
        Number of this shard, from 1, and number of shards. Shards are independent commands that share the work on one
        run in one folder. Each shard computes only its own parts. If a shard finds all parts in the folder when it
        ends, it writes the tables.
    isolate : bool
        If false, solvers are called in this process, and a solver that crashes ends the run.
    progress : callable
        Function that reports progress. It is called after every chunk.
    resolve : callable
        Returns a solver by its name; a function at the top level of a module.
    to_be_presented : bool
        Whether the caller calls `present_once` afterwards, which makes the run complete. By default the run is complete
        as soon as its tables are written.

    Returns
    -------
    SweepResult
        The folder, and whether its tables are complete.

    Raises
    ------
    UserError
        If the folder cannot be used, or a worker of the cluster has other versions of the solvers.
    InterruptedRunError
        After Ctrl-C, or if the disk is full or the cluster is lost. Finished parts are kept.
    """
    experiment, cells = Experiment(config, resolve), experiment_cells(config)
    workers = workers or config.workers or available_cores()
    say = functools.partial(progress, 0, 0)
    with (
        _one_line(root),
        cluster(scheduler) as client,
        lock_for_writing(root, cells, shard) as (folder, continued),
    ):
        run = _Run(experiment, cells, folder, shard, progress)
        log = folder.root / "solvers.log"
        with open_pool(
            experiment, min(workers, cells.chunks()), client=client, isolate=isolate, say=say, log=log
        ) as pool:
            run.begin(pool.here(solver_versions).result(), continued)
            begin_compiling(pool, experiment)
            run.solve(pool)
            where = scheduler or "this machine"
            tables_complete = run.finish(pool, where, workers, TABLES if to_be_presented else COMPLETE)
    return SweepResult(folder, tables_complete)


def present_once(
    result: SweepResult, present: Callable[[RunFolder, Apart], _Presented], *, isolate: bool = True
) -> _Presented | None:
    """Call `present` for the tables of a run, set the run's state to complete, and return what `present` returns.

    A session is the work of one command on a run. If tables are missing, or another session has presented them already,
    `present` is not called and None is returned. If two sessions finish at the same time, the second session waits here
    for the first. It then finds that the run is complete. If the first session was killed, the second session presents
    the run.

    The tables are not locked while `present` is at work. A session that begins in this time sets the state of the run
    back to running. The state then stays running, and the new session presents the run again when it ends.

    Parameters
    ----------
    result : SweepResult
    present : callable
        Draws figures and writes pages. It is called with the folder and with a function of type `Apart`. By this
        function it can have other functions called in a worker process.
    isolate : bool
        If false, these functions are called in this process.

    Raises
    ------
    InterruptedRunError
        After Ctrl-C, or if the disk is full. The same command then presents the run.
    """
    folder = result.folder
    if not result.tables_complete:
        return None
    with _one_line(folder.root), presenting_lock(folder):
        presenting = folder.manifest()
        if presenting["state"] != TABLES:
            return None
        with open_pool(None, 1, isolate=isolate, log=folder.root / "solvers.log") as pool:

            def apart(
                function: Callable[[None, *_Arguments], _Answer], *arguments: *_Arguments
            ) -> Future[_Answer]:
                return pool.submit(lambda slot: slot.call(None, function, *arguments, timeout=TO_COMPLETE))

            presented = present(folder, apart)
        with tables_lock(folder):
            manifest = folder.manifest()
            if manifest["state"] == TABLES and manifest["identity"] == presenting["identity"]:
                manifest["state"] = COMPLETE
                folder.write_manifest(manifest)
    return presented


@contextlib.contextmanager
def _one_line(root: Path) -> Generator[None]:
    """Turn an event that ends a run from outside into an `InterruptedRunError` with a message of one line.

    Such events are Ctrl-C, a full disk and a folder that is removed.
    """
    try:
        yield
    except (KeyboardInterrupt, ClosedError):
        raise InterruptedRunError("interrupted") from None
    except OSError as error:
        if not root.is_dir():
            raise InterruptedRunError(f"{root}: the folder is gone") from None
        raise InterruptedRunError(f"{error.filename or root}: {error.strerror or error}") from None


class _Run:
    """One session of a run, with the parts to compute and the numbers of parts and cells that are done.

    A session is the work of one command on a run.
    """

    def __init__(
        self,
        experiment: Experiment,
        cells: ExperimentCells,
        folder: RunFolder,
        shard: tuple[int, int],
        progress: Progress,
    ) -> None:
        self._experiment, self._cells, self._folder, self._shard = experiment, cells, folder, shard
        self._progress = progress
        self._mine = [n for n in van_der_corput(cells.chunks()) if n % shard[1] == shard[0] - 1]
        self._total = sum(len(cells.chunk(number)) for number in self._mine)
        self._done = self._reused = self._faults = 0
        self._started = self._stamp = time.perf_counter()
        self._stages: dict[str, float] = {}
        self._seconds: Counter[str] = Counter()

    def begin(self, versions: Versions, continued: bool) -> None:
        """Find the parts that earlier sessions have written, and write the manifest of the run.

        `continued` says whether an earlier session has begun the run.
        """
        config, cells, folder = self._experiment.config, self._cells, self._folder
        # All that decides the content of a part, except the number of the part.
        content = [config.identity(), versions, self._experiment.layout.part_schema.names, cells.digest]
        self._identity = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]
        self._versions = versions
        with tables_lock(folder):
            folder.write_manifest(self._make_manifest(RUNNING))
        whole: set[int] = set()
        for number, path in folder.named_parts(self._mine, self._identity).items():
            try:
                read_part(path, self._experiment.layout)
                whole.add(number)
            except UserError:
                if path.is_dir():
                    raise UserError(f"{path}: a folder in the place of a part; legal: remove it") from None
                self._progress(0, 0, f"part {number} is damaged and will be computed again")
        self._mine = [number for number in self._mine if number not in whole]
        self._done, self._reused = sum(len(cells.chunk(number)) for number in whole), len(whole)
        if continued:
            line = f"resumed: {len(whole)} of {len(whole) + len(self._mine)} parts are already computed"
            self._progress(self._done, self._total, line)
        self._end_stage("start")

    def solve(self, pool: SlotPool[Experiment]) -> None:
        """Compute the missing parts that this session has to compute, and write each part into the folder."""
        cells, ours = self._cells, _comparable_versions(self._versions)
        for report in solve_chunks(pool, ((n, cells.block(cells.chunk(n))) for n in self._mine)):
            if differing := sorted(name for name, _ in _comparable_versions(report.versions) - ours):
                theirs, own = (
                    ", ".join(f"{name} {versions[name]}" for name in differing)
                    for versions in (report.versions, self._versions)
                )
                raise UserError(
                    f"a worker has {theirs}, this process {own}; legal: the same versions everywhere"
                )
            self._folder.write_part(report.number, self._identity, report.data)
            self._seconds.update(report.seconds)
            self._faults += report.faults
            self._done += len(cells.chunk(report.number))
            self._progress(self._done, self._total, "")
        self._end_stage("solve")

    def finish(self, pool: SlotPool[Experiment], where: str, workers: int, state_with_tables: str) -> bool:
        """Write the manifest; return whether the tables are complete.

        If all parts are there, the curves and the tables are written too.

        `where` is the machine on which this session has computed its parts. The manifest records this machine and the
        number of its workers. `state_with_tables` is the state of the run after its tables are written.
        """
        config, folder, chunks = self._experiment.config, self._folder, self._cells.chunks()
        parts = folder.named_parts(range(chunks), self._identity)  # the parts of all shards
        whole = len(parts) == chunks
        if whole:
            self._progress(0, 0, "all cells are done: writing tables")
            write_curves(config, folder, pool)
            self._end_stage("curves")
        with tables_lock(folder):
            # If another shard has written the tables, the state says that they are finished.
            state = folder.manifest()["state"]
            if whole and state == RUNNING:
                folder.remove_leftovers()
                folder.assemble(parts, self._experiment.layout, len(self._cells) * len(config.solvers))
                self._end_stage("tables")
                state = state_with_tables
            manifest = self._make_manifest(state, self._make_session(where, workers))
            if state == RUNNING:
                line = (
                    f"{len(parts)} of {chunks} parts are computed; the last shard to finish writes the tables"
                )
                self._progress(self._done, self._total, line)
            else:
                manifest["statuses"] = statuses_of(folder.tally())
            folder.write_manifest(manifest)
        return state in FINISHED

    def _make_session(self, where: str, workers: int) -> Session:
        return {
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
            "shard": "{} of {}".format(*self._shard),
            "where": where,
            "workers": workers,
            "parts_reused": self._reused,
            "parts_computed": len(self._mine),
            "processes_lost": self._faults,
            "wall_time_s": round(time.perf_counter() - self._started, 3),
            "stages_s": self._stages,
            "solver_time_s": {name: round(value, 3) for name, value in self._seconds.items()},
        }

    def _make_manifest(self, state: str, *session: Session) -> Manifest:
        """Return the manifest: the experiment, versions, the machine, and the sessions that have worked on the run.

        Earlier sessions are read from the folder. This session is passed as an argument when it is over.
        """
        config = self._experiment.config
        before = self._folder.manifest_or_none()
        earlier = before["sessions"] if before else []
        return {
            "state": state,
            "name": config.name,
            "cells": len(self._cells),
            "chunks": self._cells.chunks(),
            "reference": REFERENCE,
            "identity": self._identity,
            "configuration": config.identity(),
            "cell_values": self._cells.digest,
            "versions": self._versions,
            "libraries": {name: version(name) for name in ("numpy", "scipy", "numba", "pyarrow", "pandas")},
            "machine": {
                "system": platform.system(),
                "release": platform.release(),
                "processor": platform.processor() or platform.machine(),
                "cores": available_cores(),
                "python": platform.python_version(),
            },
            "seeds": "none" if config.sample is None else config.sample.seed,
            "sessions": [*earlier, *session],
        }

    def _end_stage(self, name: str) -> None:
        now = time.perf_counter()
        self._stages[name] = round(now - self._stamp, 3)
        self._stamp = now


def van_der_corput(count: int) -> Iterator[int]:
    """Return the whole numbers below a count in an order whose first few numbers are spread over the whole range.

    Parts are computed in this order, so that the remaining time can be estimated early. The order is van der Corput's
    sequence (1935): the binary digits of 0, 1, 2, ... are reversed.
    """
    digits = (count - 1).bit_length()
    mirrored = (int(f"{place:0{digits}b}"[::-1], 2) for place in range(1 << digits))
    return (number for number in mirrored if number < count)


def _comparable_versions(versions: Versions) -> set[tuple[str, str]]:
    """Return the versions of solvers as pairs that can be compared between machines.

    A solver that cannot run has "-" as its version, because the reason may have another text on another machine.
    """
    return {(name, "-" if v.startswith(UNAVAILABLE) else v) for name, v in versions.items()}
