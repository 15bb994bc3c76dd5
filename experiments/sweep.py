"""The main job: all cells by all solvers, on all cores, to be continued wherever it was stopped."""

from __future__ import annotations

import contextlib
import hashlib
import json
import multiprocessing
import os
import platform
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from compliant_baselines import get_solver
from experiments.config import REFERENCE, Config
from experiments.curves import write_curves
from experiments.errors import UserError
from experiments.grid import CellGrid
from experiments.ladder_table import write_ladder
from experiments.schema import COLUMNS
from experiments.solving import Report, Resolve, Task, run_task
from experiments.store import FORMAT, MANIFEST, RunFolder, open_folder, write_json

#: Told how many cells are done, of how many, and a line worth saying ("" if none).
Progress = Callable[[int, int, str], None]


class InterruptedRunError(Exception):
    """The run was stopped before its end; what is done is kept."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What a run will do: its chunks and the identity of each."""

    config: Config
    versions: dict[str, str]
    identities: list[str]

    @classmethod
    def of(cls, config: Config, resolve: Resolve) -> Plan:
        """Plan a run; the identity of a chunk is a hash of configuration, versions and cells."""
        versions = solver_versions(config, resolve)
        grid = CellGrid(config)
        common = json.dumps([config.identity(), versions, list(COLUMNS)], sort_keys=True)
        identities = [
            hashlib.sha256(f"{common} cells {cells.start} to {cells.stop}".encode()).hexdigest()[:32]
            for cells in map(grid.chunk, range(grid.chunks()))
        ]
        return cls(config, versions, identities)


def run_sweep(
    config: Config,
    root: Path,
    *,
    workers: int | None = None,
    resume: bool = False,
    progress: Progress = lambda done, total, line: None,
    resolve: Resolve = get_solver,
) -> RunFolder:
    """Run an experiment into a folder: parts, then the finished tables, the curves and the manifest.

    Parameters
    ----------
    config : Config
        The experiment.
    root : Path
        The folder; new, empty, or with `resume` the folder of the same experiment.
    workers : int, optional
        Number of processes; by default that of the configuration, else one for every core. One worker is this
        process itself. No result depends on it.
    resume : bool
        Continue from the parts that are there.
    progress : callable
        Called after every chunk.
    resolve : callable
        Finds a solver by its name.

    Returns
    -------
    RunFolder

    Raises
    ------
    UserError
        If the folder cannot be used.
    InterruptedRunError
        On Ctrl-C or the death of a worker; finished parts are kept.
    """
    started = time.perf_counter()
    workers = workers or config.workers or available_cores()
    folder, continued = open_folder(root, resume=resume)
    if continued:
        _same_experiment(folder, config)
    plan = Plan.of(config, resolve)
    parts, findings = folder.find_parts(plan.identities)
    for finding in findings:
        progress(0, 0, finding)
    history = folder.manifest().get("sessions", []) if continued else []
    manifest = _manifest(plan, history)
    write_json(folder.root / MANIFEST, manifest)

    grid = CellGrid(config)
    done = sum(len(grid.chunk(number)) for number in parts)
    reused = len(parts)
    if continued:
        progress(done, len(grid), f"resumed: {reused} of {len(plan.identities)} parts are there and whole")
    todo = [n for n in range(grid.chunks()) if n not in parts]
    tasks = (Task(number, plan.identities[number], config, folder.root, resolve) for number in todo)
    seconds: Counter[str] = Counter()
    try:
        with _executor(min(workers, max(1, len(todo)))) as executor:
            for report in _complete(executor, tasks, in_flight=2 * workers):
                parts[report.number] = report.part
                seconds.update(report.seconds)
                done += len(grid.chunk(report.number))
                progress(done, len(grid), "")
        write_curves(config, folder, resolve)
    except KeyboardInterrupt:
        raise InterruptedRunError("interrupted") from None
    except BrokenProcessPool:
        raise InterruptedRunError("a worker process died (out of memory, or an engine crashed)") from None
    except OSError as error:
        raise InterruptedRunError(f"{error.filename or folder.root}: {error.strerror}") from None
    folder.assemble(parts)
    write_ladder(folder.root)
    session = {
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "workers": workers,
        "parts_reused": reused,
        "parts_computed": len(todo),
        "wall_time_s": round(time.perf_counter() - started, 3),
        "solver_time_s": {name: round(value, 3) for name, value in seconds.items()},
    }
    manifest |= {
        "state": "complete",
        "statuses": folder.statuses(),
        "files": folder.digests(),
        "sessions": [*history, session],
    }
    write_json(folder.root / MANIFEST, manifest)
    return folder


def available_cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def solver_versions(config: Config, resolve: Resolve = get_solver) -> dict[str, str]:
    """Versions of the project and of every solver; why not, for one that is unavailable."""
    versions = {"impact-xval": version("impact-xval")}
    for name in config.solvers:
        solver = resolve(name)
        reason = solver.unavailable()
        versions[name] = solver.version() if reason is None else f"unavailable: {reason}"
    return versions


def _same_experiment(folder: RunFolder, config: Config) -> None:
    stored = folder.config()
    if stored.identity() == config.identity():
        return
    old, new = stored.canonical(), config.canonical()
    differing = [key for key in old if old[key] != new[key] and key not in ("name", "workers", "figure_cell")]
    detail = (
        f"{differing[0]} = {old[differing[0]]} there, {new[differing[0]]} now" if differing else "other axes"
    )
    raise UserError(f"--resume {folder.root}: holds a run of another configuration: {detail}")


def _manifest(plan: Plan, history: list[Any]) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "state": "running",
        "name": plan.config.name,
        "cells": len(CellGrid(plan.config)),
        "reference": REFERENCE,
        "configuration": plan.config.canonical(),
        "identity": plan.config.identity(),
        "versions": plan.versions,
        "libraries": {name: version(name) for name in ("numpy", "scipy", "numba", "pyarrow", "pandas")},
        "machine": {
            "system": platform.system(),
            "release": platform.release(),
            "processor": platform.processor() or platform.machine(),
            "cores": available_cores(),
            "python": platform.python_version(),
        },
        "seeds": "none: nothing in a run is random",
        "sessions": history,
    }


def _complete(executor: Executor, tasks: Iterator[Task], in_flight: int) -> Iterator[Report]:
    """Yield reports as they come, with a bounded number of tasks handed out."""
    pending: set[Future[Report]] = set()
    for task in tasks:
        pending.add(executor.submit(run_task, task))
        if len(pending) >= in_flight:
            finished, pending = wait(pending, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in finished)
    while pending:
        finished, pending = wait(pending, return_when=FIRST_COMPLETED)
        yield from (future.result() for future in finished)


class _InProcess(Executor):
    """One worker: this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextlib.contextmanager
def _executor(workers: int) -> Iterator[Executor]:
    if workers == 1:
        yield _InProcess()
        return
    # Spawned, not forked: engines and compiled code hold threads and handles that do not survive a fork.
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker)
    before = set(multiprocessing.active_children())
    try:
        yield executor
    except BaseException:
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        executor.shutdown(wait=True, cancel_futures=True)
        raise
    executor.shutdown()


def _start_worker() -> None:
    """Leave Ctrl-C to the main process, and end when it is gone (a killed parent tells nobody)."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)
