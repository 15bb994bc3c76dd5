"""The main job: all cells by all solvers, wherever there are workers, to be continued wherever it was stopped."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import platform
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.config.configuration import REFERENCE, Config
from impact_xval.experiments.config.errors import InterruptedRunError, UserError
from impact_xval.experiments.config.grid import Cells
from impact_xval.experiments.measures.ladder_table import write_ladder
from impact_xval.experiments.sweep.curves import write_curves
from impact_xval.experiments.sweep.designs import cells_of
from impact_xval.experiments.sweep.executors import available_cores, in_flight, open_executor
from impact_xval.experiments.sweep.isolation import Report, Task, run_task
from impact_xval.experiments.sweep.sandbox import ClosedError
from impact_xval.experiments.sweep.solving import Job, Resolve, solver_versions
from impact_xval.experiments.tables.folders import open_folder
from impact_xval.experiments.tables.lock import holding, running
from impact_xval.experiments.tables.schema import COLUMNS
from impact_xval.experiments.tables.store import (
    FORMAT,
    MANIFEST,
    RunFolder,
    write_json,
)

#: Told how many cells are done, of how many, and a line worth saying ("" if none).
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True)
class Plan:
    """What a run will do: its chunks and the identity of each."""

    config: Config
    cells: Cells
    versions: dict[str, str]
    identities: list[str]

    @classmethod
    def of(cls, config: Config, cells: Cells, resolve: Resolve) -> Plan:
        """Plan a run; the identity of a chunk is a hash of configuration, versions and cells."""
        versions = solver_versions(config, resolve)
        common = json.dumps([config.identity(), versions, list(COLUMNS)], sort_keys=True)
        identities = [
            hashlib.sha256(f"{common} cells {cells.digest(cells.chunk(n))}".encode()).hexdigest()[:32]
            for n in range(cells.chunks())
        ]
        return cls(config, cells, versions, identities)

    def task(self, number: int) -> Task:
        """Make the task of a chunk."""
        chunk = self.cells.cells(self.cells.chunk(number))
        return Task(number, chunk, self.config.cell_timeout)


def run_sweep(
    config: Config,
    root: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    isolate: bool = True,
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
        Number of processes on this machine; by default that of the configuration, else one for every core. No
        result depends on it.
    scheduler : str, optional
        Address of a Dask scheduler, or ``local`` for a Dask cluster on this machine; by default no Dask.
    resume : bool
        Continue from the parts that are there.
    isolate : bool
        False runs the solvers in this process, one chunk after the other: a solver that crashes ends the run.
    progress : callable
        Called after every chunk.
    resolve : callable
        Finds a solver by its name; at the top level of a module.

    Returns
    -------
    RunFolder

    Raises
    ------
    UserError
        If the folder cannot be used, or a worker has other versions of the solvers.
    InterruptedRunError
        On Ctrl-C, a full disk or a lost cluster; finished parts are kept.
    """
    owner = running(root)
    if owner is not None:
        raise UserError(
            f"--out {root}: another run writes there ({owner}); legal: wait for it, or another folder"
        )
    cells = cells_of(config)
    folder, continued = open_folder(root, resume=resume)
    with clearly(folder), holding(root) as line:
        progress(0, 0, line)
        workers = workers or config.workers or available_cores()
        run = _Run(config, cells, folder, continued, workers, scheduler or "this machine")
        say = functools.partial(progress, 0, 0)
        with open_executor(
            Job(config, resolve), min(workers, cells.chunks()), scheduler, say, isolate=isolate
        ) as executor:
            run.solve(executor, Plan.of(config, cells, resolve), progress)
        run.finish()
    return folder


class _Run:
    """A session of a run: what it was asked, and what it has done."""

    def __init__(
        self, config: Config, cells: Cells, folder: RunFolder, continued: bool, workers: int, where: str
    ) -> None:
        self.config, self.cells, self.folder, self.workers = config, cells, folder, workers
        self.started = self.stamp = time.perf_counter()
        self.continued = continued
        if continued:
            _same_experiment(folder, config)
        self.history: list[Any] = folder.manifest().get("sessions", []) if continued else []
        self.parts: dict[int, Path] = {}
        self.reused = 0
        self.where = where
        self.stages: dict[str, float] = {}
        self.seconds: Counter[str] = Counter()
        self.faults = 0

    def solve(self, executor: Any, plan: Plan, progress: Progress) -> None:
        """Compute the parts that are not there, and the curves."""
        self.plan = plan
        self.parts, findings = self.folder.find_parts(plan.identities)
        for finding in findings:
            progress(0, 0, finding)
        self.manifest = _manifest(plan, self.history)
        write_json(self.folder.root / MANIFEST, self.manifest)
        done = sum(len(self.cells.chunk(number)) for number in self.parts)
        self.reused = len(self.parts)
        if self.continued:
            progress(
                done,
                len(self.cells),
                f"resumed: {self.reused} of {len(plan.identities)} parts are there and whole",
            )
        if len(self.parts) < self.cells.chunks():
            executor.submit(_ready).result()
        self._stage("start")
        todo = (plan.task(n) for n in range(self.cells.chunks()) if n not in self.parts)
        reports = in_flight(
            lambda task: executor.submit(run_task, task), todo, lambda: max(2, 2 * executor.workers)
        )
        for report in reports:
            self._keep(report)
            done += len(self.cells.chunk(report.number))
            progress(done, len(self.cells), "")
        self._stage("solve")
        write_curves(self.config, self.folder, executor)
        self._stage("curves")

    def _keep(self, report: Report) -> None:
        if report.versions is not None and report.versions != self.plan.versions:
            differing = sorted(
                name for name, here in self.plan.versions.items() if report.versions.get(name) != here
            )
            there = ", ".join(f"{name} {report.versions.get(name)}" for name in differing)
            here = ", ".join(f"{name} {self.plan.versions[name]}" for name in differing)
            raise UserError(f"a worker has {there}, this process {here}; legal: the same versions everywhere")
        self.parts[report.number] = self.folder.write_part(
            report.number, self.plan.identities[report.number], report.data
        )
        self.seconds.update(report.seconds)
        self.faults += report.faults

    def finish(self) -> None:
        """Write the finished tables and the manifest."""
        self.folder.assemble(self.parts)
        write_ladder(self.folder.root)
        statuses, digests = self.folder.statuses(), self.folder.digests()
        self._stage("tables")
        session = {
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
            "where": self.where,
            "workers": self.workers,
            "parts_reused": self.reused,
            "parts_computed": len(self.parts) - self.reused,
            "processes_lost": self.faults,
            "wall_time_s": round(time.perf_counter() - self.started, 3),
            "stages_s": self.stages,
            "solver_time_s": {name: round(value, 3) for name, value in self.seconds.items()},
        }
        self.manifest |= {
            "state": "complete",
            "statuses": statuses,
            "files": digests,
            "sessions": [*self.history, session],
        }
        write_json(self.folder.root / MANIFEST, self.manifest)

    def _stage(self, name: str) -> None:
        now = time.perf_counter()
        self.stages[name] = round(now - self.stamp, 3)
        self.stamp = now


@contextlib.contextmanager
def clearly(folder: RunFolder) -> Iterator[None]:
    """Turn what can end a run from outside into one line."""
    try:
        yield
    except UserError:
        with contextlib.suppress(OSError):
            folder.discard()
        raise
    except (KeyboardInterrupt, ClosedError):
        raise InterruptedRunError("interrupted") from None
    except OSError as error:
        if not folder.root.is_dir():
            raise InterruptedRunError(f"{folder.root}: the folder is gone") from None
        where = error.filename or folder.root
        what = os.strerror(error.errno) if error.errno else str(error)
        raise InterruptedRunError(f"{where}: {what}") from None


def _ready(sandbox: Any) -> None:
    """Wait for the first sandbox there is: what comes before is the start of a run, what follows its work."""
    sandbox.start()


def _same_experiment(folder: RunFolder, config: Config) -> None:
    stored = folder.config()
    if stored.identity() == config.identity():
        return
    old, new = stored.canonical(), config.canonical()
    keys = [key for key in {**old, **new} if key not in ("name", "workers", "figure_cell", "cells", "search")]
    differing = [key for key in keys if old.get(key) != new.get(key)]
    detail = (
        f"{differing[0]} = {old.get(differing[0])} there, {new.get(differing[0])} now"
        if differing
        else "other axes"
    )
    raise UserError(f"--resume {folder.root}: holds a run of another configuration: {detail}")


def _manifest(plan: Plan, history: list[Any]) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "state": "running",
        "started": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "name": plan.config.name,
        "cells": len(plan.cells),
        "chunks": len(plan.identities),
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
        "seeds": _seeds(plan.config),
        "sessions": history,
    }


def _seeds(config: Config) -> str:
    if config.sample is not None:
        return f"{config.sample.seed}, of the cells; nothing else in a run is random"
    return "none: nothing in a run is random"
