"""The main job: all cells by all solvers, wherever there are workers, to be continued wherever it was stopped."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import platform
import time
from collections import Counter
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.config.cells import Cells, experiment_cells
from impact_xval.experiments.config.errors import InterruptedRunError, UserError
from impact_xval.experiments.config.experiment import COSMETIC, REFERENCE, Config
from impact_xval.experiments.measures.layout import layout_of
from impact_xval.experiments.sweep.chunk import Report, solve_chunks, solver_versions
from impact_xval.experiments.sweep.curves import write_column_curves, write_curves
from impact_xval.experiments.sweep.pool import available_cores, open_pool
from impact_xval.experiments.sweep.process import ClosedError
from impact_xval.experiments.sweep.rows import Experiment, Resolve
from impact_xval.experiments.sweep.status import MEDIAN_COLUMNS
from impact_xval.experiments.tables.folders import discard, missing, open_folder
from impact_xval.experiments.tables.lock import check_free, holding
from impact_xval.experiments.tables.store import (
    CONFIGURATION,
    FORMAT,
    MANIFEST,
    DamagedManifestError,
    RunFolder,
    read_part,
    statuses_of,
    write_json,
)

#: Given how many cells are done, of how many, and a line worth saying ("" if none).
Progress = Callable[[int, int, str], None]

#: Given the rows of a chunk as soon as they are there.
OnRows = Callable[[pa.Table], None]

#: What solvers write to standard error, in a run's folder.
LOG = "solvers.log"


def run_sweep(
    config: Config,
    root: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    isolate: bool = True,
    progress: Progress = lambda done, total, line: None,
    on_rows: OnRows | None = None,
    resolve: Resolve = get_solver,
    present: Callable[[RunFolder], None] = lambda folder: None,
) -> RunFolder:
    """Run an experiment into a folder: parts, then the finished tables, the curves and the manifest.

    Parameters
    ----------
    config : Config
        The experiment.
    root : Path
        The folder; new, empty, or that of the same experiment, which is continued
        from the parts that are there.
    workers : int, optional
        Processes on this machine, on which no result depends; by default the configuration's, else one a core.
    scheduler : str, optional
        Address of a Dask scheduler; by default no Dask.
    isolate : bool
        False runs the solvers in this process: one that crashes ends the run.
    progress : callable
        Called after every chunk.
    on_rows : callable, optional
        Given rows of a chunk as soon as they are there, with the `MEDIAN_COLUMNS` at least.
    resolve : callable
        Finds a solver by its name; at the top level of a module.
    present : callable
        Given the folder once its tables are complete; the run is complete when it returns.

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
    experiment, cells = Experiment(config, resolve), experiment_cells(config)
    with kept(root) as (folder, continued):
        workers, say = workers or config.workers or available_cores(), functools.partial(progress, 0, 0)
        run, most = (
            _Run(experiment, cells, folder, continued, progress, on_rows),
            min(workers, cells.chunks()),
        )
        log = folder.root / LOG
        with open_pool(experiment, most, scheduler=scheduler, isolate=isolate, say=say, log=log) as pool:
            run.solve(pool)
            run.tabulate()
        run.finish({"where": scheduler or "this machine", "workers": workers}, present)
    return folder


@contextlib.contextmanager
def kept(root: Path) -> Iterator[tuple[RunFolder, bool]]:
    """Keep a folder to this process, and turn what can end a run from outside into one line.

    Parameters
    ----------
    root : Path
        As for `run_sweep`.

    Yields
    ------
    folder : RunFolder
    continued : bool
        Whether a run is there.

    Raises
    ------
    UserError
        If the folder cannot be used; then, and after one in the block, what was made for nothing is removed.
    InterruptedRunError
    """
    check_free(root)
    new = missing(root)
    folder, continued = open_folder(root)
    try:
        with holding(root):
            folder.remove_leftovers()
            yield folder, continued
    except UserError:
        discard(folder, new)
        raise
    except (KeyboardInterrupt, ClosedError):
        raise InterruptedRunError("interrupted") from None
    except OSError as error:
        if not root.is_dir():
            raise InterruptedRunError(f"{root}: the folder is gone") from None
        what = error.strerror or str(error)
        raise InterruptedRunError(f"{error.filename or root}: {what}") from None


class _Run:
    """A session of a run: what it is to do, and what it has done."""

    def __init__(
        self,
        experiment: Experiment,
        cells: Cells,
        folder: RunFolder,
        continued: bool,
        progress: Progress,
        on_rows: OnRows | None,
    ) -> None:
        self._experiment, self._cells, self._folder = experiment, cells, folder
        self._continued, self._progress, self._on_rows = continued, progress, on_rows
        self._done = 0
        self._started = self._stamp = time.perf_counter()
        self._history: list[Any] = []
        self._damage = ""
        if continued:
            try:
                _same_experiment(folder, experiment.config)
                self._history = folder.manifest()["sessions"]
            except DamagedManifestError as damage:
                self._damage = str(damage)
        self._stages: dict[str, float] = {}
        self._seconds: Counter[str] = Counter()
        self._faults = 0

    def solve(self, pool: Any) -> None:
        """Compute the parts that are not there, and the curves."""
        config, cells = self._experiment.config, self._cells
        self._versions = pool.here(solver_versions)
        self._identities = _identities(config, cells, self._versions)
        self._check_damage()
        self._parts, findings = self._folder.find_parts(
            self._identities, self._rows_of, self._experiment.layout
        )
        for finding in findings:
            self._progress(0, 0, finding)
        self._manifest = _manifest(config, cells, self._versions, self._history)
        write_json(self._folder.root / MANIFEST, self._manifest)
        self._done, self._reused = sum(len(cells.chunk(number)) for number in self._parts), len(self._parts)
        if self._continued:
            line = f"resumed: {self._reused} of {cells.chunks()} parts are there and whole"
            self._progress(self._done, len(cells), line)
        if self._on_rows is not None:
            for part in self._parts.values():
                self._on_rows(pq.read_table(part, columns=MEDIAN_COLUMNS))
        write_json(self._folder.parts / CONFIGURATION, config.canonical())
        self._stage("start")
        todo = (number for number in van_der_corput(cells.chunks()) if number not in self._parts)
        chunks = ((n, cells.block(cells.chunk(n))) for n in todo)
        for report in solve_chunks(pool, chunks):
            self._keep(report)
            if self._on_rows is not None:
                self._on_rows(read_part(report.data, self._experiment.layout))
            self._done += len(cells.chunk(report.number))
            self._progress(self._done, len(cells), "")
        self._stage("solve")
        (write_curves if config.column is None else write_column_curves)(config, self._folder, pool)
        self._stage("curves")

    def _check_damage(self) -> None:
        """Where the manifest does not tell what parts a folder holds are of, one must be of this experiment."""
        if self._damage and self._folder.has_parts() and not self._folder.has_parts(self._identities):
            raise UserError(
                f"{self._damage}: no part there is of this configuration by these versions, and all are left as "
                "they are; legal: the configuration and the versions the run was begun with"
            )
        if self._damage:
            self._progress(0, 0, f"{self._damage}: it is written now, and begins without earlier sessions")

    def _rows_of(self, number: int) -> pa.Table:
        """Give the cells and solvers that the rows of a part are of."""
        chunk, solvers = self._cells.chunk(number), self._experiment.config.solvers
        fields = [self._experiment.layout.rows.field(name) for name in ("cell", "solver")]
        columns = [[cell for cell in chunk for _ in solvers], list(solvers) * len(chunk)]
        return pa.table(columns, schema=pa.schema(fields))

    def _keep(self, report: Report) -> None:
        ours, theirs = self._versions, report.versions
        differing = sorted(name for name in ours if not _same_version(ours[name], theirs.get(name, "")))
        if differing:
            there = ", ".join(f"{name} {theirs.get(name)}" for name in differing)
            here = ", ".join(f"{name} {ours[name]}" for name in differing)
            raise UserError(f"a worker has {there}, this process {here}; legal: the same versions everywhere")
        self._parts[report.number] = self._folder.write_part(
            report.number, self._identities[report.number], report.data
        )
        self._seconds.update(report.seconds)
        self._faults += report.faults

    def tabulate(self) -> None:
        """Write the finished tables."""
        self._folder.assemble(self._parts, self._experiment.layout)
        self._stage("tables")

    def finish(self, by: dict[str, Any], present: Callable[[RunFolder], None]) -> None:
        """Write the manifest, and have the tables presented; `by` is who computed them."""
        statuses, digests = statuses_of(self._folder.tally()), self._folder.digests()
        session = {
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
            **by,
            "parts_reused": self._reused,
            "parts_computed": len(self._parts) - self._reused,
            "processes_lost": self._faults,
            "wall_time_s": round(time.perf_counter() - self._started, 3),
            "stages_s": self._stages,
            "solver_time_s": {name: round(value, 3) for name, value in self._seconds.items()},
        }
        self._manifest |= {
            "statuses": statuses,
            "files": digests,
            "sessions": [*self._history, session],
        }
        write_json(self._folder.root / MANIFEST, self._manifest | {"state": "tables"})
        present(self._folder)
        write_json(self._folder.root / MANIFEST, self._manifest | {"state": "complete"})

    def _stage(self, name: str) -> None:
        now = time.perf_counter()
        self._stages[name] = round(now - self._stamp, 3)
        self._stamp = now


def van_der_corput(count: int) -> Iterator[int]:
    """Give the numbers below a count, each once, such that the first few of them lie all over the range.

    Cells are in the order of their stiffness ratios; medians so far and the time left then stand for all of them. It is
    van der Corput's sequence (1935), the binary digits of 0, 1, 2 ... in the opposite order.
    """
    digits = (count - 1).bit_length()
    mirrored = (int(f"{place:0{digits}b}"[::-1], 2) for place in range(1 << digits))
    return (number for number in mirrored if number < count)


def _same_version(ours: str, theirs: str) -> bool:
    """Whether rows of a solver are the same by both; the reason of one that is unavailable may have other words."""
    return ours == theirs or (ours.startswith("unavailable") and theirs.startswith("unavailable"))


def _same_experiment(folder: RunFolder, config: Config) -> None:
    stored = folder.config()
    if stored.identity() == config.identity():
        return
    old, new = stored.canonical(), config.canonical()
    keys = [key for key in {**old, **new} if key not in COSMETIC]
    differing = [key for key in keys if old.get(key) != new.get(key)]
    detail = (
        f"{differing[0]} = {old.get(differing[0])} there, {new.get(differing[0])} now"
        if differing
        else "other axes"
    )
    raise UserError(f"--out {folder.root}: holds a run of another configuration: {detail}")


def _identities(config: Config, cells: Cells, versions: dict[str, str]) -> list[str]:
    """Identity of every chunk: a hash of configuration, versions and cells."""
    columns = layout_of(config).rows.names
    common = json.dumps([config.identity(), versions, columns], sort_keys=True)
    return [
        hashlib.sha256(f"{common} cells {cells.digest(cells.chunk(n))}".encode()).hexdigest()[:32]
        for n in range(cells.chunks())
    ]


def _manifest(config: Config, cells: Cells, versions: dict[str, str], history: list[Any]) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "state": "running",
        "started": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "name": config.name,
        "cells": len(cells),
        "chunks": cells.chunks(),
        "reference": REFERENCE,
        "configuration": config.canonical(),
        "identity": config.identity(),
        "versions": versions,
        "libraries": {name: version(name) for name in ("numpy", "scipy", "numba", "pyarrow", "pandas")},
        "machine": {
            "system": platform.system(),
            "release": platform.release(),
            "processor": platform.processor() or platform.machine(),
            "cores": available_cores(),
            "python": platform.python_version(),
        },
        "seeds": _seeds(config),
        "sessions": history,
    }


def _seeds(config: Config) -> str:
    if config.sample is not None:
        return f"{config.sample.seed}, of the cells; nothing else in a run is random"
    return "none: nothing in a run is random"
