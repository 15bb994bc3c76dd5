"""The folder of a run: what was asked for, the parts that are there, the finished tables, and who writes.

A part holds the rows of one chunk of cells; its name bears the identity of the run (configuration, versions, cells).
Parts of another identity are left alone.
"""

from __future__ import annotations

import contextlib
import json
import os
import shlex
from collections import Counter
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NotRequired, TypedDict

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from filelock import FileLock, Timeout

from impact_xval.experiments.config.axes import AXES, KEPT
from impact_xval.experiments.config.cells import ExperimentCells, cells_from_ratios, experiment_cells
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import COSMETIC, Config, load_config
from impact_xval.experiments.tables.earlier import EARLIER_FORMAT, renamed_tables
from impact_xval.experiments.tables.parquet import (
    GROUP,
    read_column,
    read_row_groups,
    replacing,
    table_writer,
)
from impact_xval.experiments.tables.schema import Layout

FORMAT = "impact-xval run, format 4"
#: States of a run, in its manifest: parts are missing; the tables are finished; they are presented too.
RUNNING, TABLES, COMPLETE = "running", "tables", "complete"
#: States of a run whose tables are finished.
FINISHED = (TABLES, COMPLETE)
MANIFEST, CONFIGURATION = "manifest.json", "experiment.toml"
#: Every name in a folder that a lock, or a file half-written, begins with.
_LOCK, _TEMPORARY = ".lock", ".tmp-"

#: A run of more rows than this writes no CSV: no spreadsheet opens it.
_CSV = 100_000
#: Number of rows by solver, status and reason ("" if none).
Tally = Counter[tuple[str, str, str]]


class Session(TypedDict):
    """Session of a run, in its manifest: where and how long it worked, on how many parts."""

    #: Instant at which it ended, by ISO 8601.
    finished: str
    #: Which shard, such as ``1 of 4``.
    shard: str
    #: The address of a scheduler, or ``this machine``; and the number of processes.
    where: str
    workers: int
    parts_reused: int
    parts_computed: int
    processes_lost: int
    #: Wall time in s: of all, by stage, and by solver.
    wall_time_s: float
    stages_s: dict[str, float]
    solver_time_s: dict[str, float]


class Manifest(TypedDict):
    """Content of ``manifest.json``: what a run is of, and who has worked on it."""

    #: `FORMAT`, which `RunFolder.write_manifest` adds.
    format: NotRequired[str]
    #: `RUNNING`, `TABLES` or `COMPLETE`.
    state: str
    name: str
    #: Numbers of cells, and of their chunks.
    cells: int
    chunks: int
    #: The solver that all others are compared with.
    reference: str
    #: Hash of all that the content of a part depends on, but for its number.
    identity: str
    #: Versions of the project and of the solvers, and of libraries.
    versions: dict[str, str]
    libraries: dict[str, str]
    #: Texts on the machine, and its number of cores.
    machine: dict[str, str | int]
    #: Seed of a sample, or ``none``.
    seeds: int | str
    #: In the order in which they ended.
    sessions: list[Session]
    #: Of a finished run the number of rows by solver and status.
    statuses: NotRequired[dict[str, dict[str, int]]]


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8, line feeds) in one step."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: Path, value: object) -> None:
    """Write strict JSON in one step."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


@dataclass(frozen=True, slots=True)
class RunFolder:
    """The folder of a run; what is missing or damaged in it is a `UserError`."""

    root: Path
    #: Where the finished tables are, if not in `root`: those of a run of 0.4, under today's names.
    tables: Path | None = None

    @property
    def parts(self) -> Path:
        """Folder of the parts."""
        return self.root / "parts"

    def write_config(self, config: Config) -> None:
        """Write the experiment as it is run."""
        write_text(self.root / CONFIGURATION, config.toml())

    def config(self) -> Config:
        """Read the experiment of the run."""
        path = self.root / CONFIGURATION
        if not path.exists():
            raise UserError(f"{self.root}: no {CONFIGURATION}; legal: the folder of a run ({FORMAT})")
        return load_config(path, KEPT)

    def manifest(self) -> Manifest:
        """Read the manifest, of this format or of that of version 0.4."""
        path = self.root / MANIFEST
        again = "the command that began the run writes it again"
        if not path.exists():
            if (self.root / CONFIGURATION).exists():
                goes_on = f"to continue: {continue_command(self.root)}"
                raise UserError(
                    f"{self.root}: no {MANIFEST}: the run has only begun, or was stopped then; {goes_on}"
                )
            raise UserError(f"{self.root}: no {MANIFEST}; legal: the folder of a run, or {again}")
        try:
            value = json.loads(path.read_text(encoding="utf-8"))
            its_format = value["format"]
        except OSError as error:
            raise UserError(f"{path}: cannot be read: {error.strerror}") from None
        except (ValueError, TypeError, KeyError):
            raise UserError(f"{path}: damaged; {again}") from None
        if its_format not in (FORMAT, EARLIER_FORMAT):
            raise UserError(
                f"{path}: format = {its_format!r:.60}; legal: {FORMAT!r}, which this version writes"
            )
        return value

    @property
    def is_earlier(self) -> bool:
        """Whether version 0.4 wrote the run; False where there is no manifest that can be read."""
        try:
            return self.manifest().get("format") == EARLIER_FORMAT
        except UserError:
            return False

    def write_manifest(self, value: Manifest) -> None:
        """Write the manifest, of this format."""
        write_json(self.root / MANIFEST, {"format": FORMAT, **value})

    def write_part(self, number: int, identity: str, data: bytes) -> None:
        """Write a part; its checksums tell where a power cut has emptied it."""
        with replacing(self._part(number, identity), sync=False) as temporary:
            temporary.write_bytes(data)

    def named_parts(self, numbers: Iterable[int], identity: str) -> dict[int, Path]:
        """Find parts of a run by their names; path by number."""
        names = {path.name for path in self.parts.iterdir()} if self.parts.is_dir() else set()
        paths = {number: self._part(number, identity) for number in numbers}
        return {number: path for number, path in paths.items() if path.name in names}

    def _part(self, number: int, identity: str) -> Path:
        return self.parts / f"{number:06d}-{identity}.parquet"

    def remove_leftovers(self) -> None:
        """Remove the temporary files of runs that were killed."""
        for folder in (self.root, self.parts, self.root / "figures"):
            for path in folder.glob(f"{_TEMPORARY}[0-9]*-*"):
                path.unlink(missing_ok=True)

    def assemble(self, parts: dict[int, Path], layout: Layout, rows: int) -> None:
        """Write the finished tables from the parts, in the order of the cells, in one pass; `rows` are in them all."""
        with contextlib.ExitStack() as stack:
            writers = [
                (table, stack.enter_context(table_writer(self.root / f"{name}.parquet", table.schema)))
                for name, table in layout.tables.items()
            ]
            for group in _row_groups((parts[number] for number in sorted(parts)), layout):
                for table, write in writers:
                    selected = table.select(group)
                    if len(selected):
                        write(selected)
        for name, table in layout.tables.items():
            if table.csv and rows <= _CSV:
                with replacing(self.root / f"{name}.csv") as path:
                    pacsv.write_csv(self.read_table(f"{name}.parquet"), path)

    def tally(self) -> Tally:
        """Count the rows of the finished table of cells by what became of them."""
        return tally(read_row_groups(self.table_path("cells.parquet"), ["solver", "status", "reason"]))

    def table_path(self, name: str) -> Path:
        """Return the path of a finished table."""
        path = (self.tables or self.root) / name
        try:
            pq.read_schema(path)
        except (OSError, pa.ArrowException):
            raise UserError(
                f"{path}: missing or damaged; the command that began the run writes it again"
            ) from None
        return path

    def read_table(self, name: str) -> pa.Table:
        """Read a finished table whole; for small ones."""
        return pq.read_table(self.table_path(name))


def part_bytes(rows: pa.Table) -> bytes:
    """Return the rows of a chunk as the content of a part, without what is the same in every part."""
    bare = pa.schema([pa.field(field.name, field.type) for field in rows.schema])
    sink = pa.BufferOutputStream()
    pq.write_table(
        rows.combine_chunks().cast(bare),
        sink,
        compression="zstd",
        write_statistics=False,
        store_schema=False,
        write_page_checksum=True,
    )
    return sink.getvalue().to_pybytes()


def read_part(path: Path, layout: Layout) -> pa.Table:
    """Read the rows of a part; a `UserError` where it is damaged."""
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            return file.read(use_threads=False).cast(layout.part_schema)
    except (pa.ArrowException, OSError, ValueError):
        raise UserError(f"{path}: damaged; the same command computes it again") from None


def tally(tables: Iterable[pa.Table]) -> Tally:
    """Count the rows of tables by solver, status and reason."""
    counts: Tally = Counter()
    for table in tables:
        grouped = table.group_by(["solver", "status", "reason"], use_threads=False)
        for row in grouped.aggregate([([], "count_all")]).to_pylist():
            counts[row["solver"], row["status"], row["reason"] or ""] += row["count_all"]
    return counts


def statuses_of(outcomes: Tally) -> dict[str, dict[str, int]]:
    """Count every status by solver."""
    counts: dict[str, Counter[str]] = {}
    for (solver, status, _), n in outcomes.items():
        counts.setdefault(solver, Counter())[status] += n
    return {solver: dict(by_status) for solver, by_status in counts.items()}


def _row_groups(parts: Iterable[Path], layout: Layout) -> Iterator[pa.Table]:
    """Read parts, as many at a time as make a row group of the tables."""
    tables: list[pa.Table] = []
    for part in parts:
        tables.append(read_part(part, layout))
        if sum(map(len, tables)) >= GROUP:
            yield pa.concat_tables(tables).combine_chunks()
            tables = []
    if tables:
        yield pa.concat_tables(tables).combine_chunks()


@contextlib.contextmanager
def lock_for_writing(
    root: Path, config: Config, shard: tuple[int, int] = (1, 1)
) -> Generator[tuple[RunFolder, bool]]:
    """Lock the folder of a run, or of a shard; yield it and whether it already holds a run of the experiment.

    The lock is the operating system's, which frees it as soon as its process is gone. The experiment is written before
    anything else that a run leaves behind: whatever ends the run, its folder is recognised.
    """
    folder = RunFolder(root)
    lock = root / (_LOCK if shard == (1, 1) else f"{_LOCK}-{shard[0]}-of-{shard[1]}")
    with contextlib.ExitStack() as held:
        with _refuse_unusable(root, "--out "):
            continued = _holds_same_run(folder, config)
            folder.parts.mkdir(parents=True, exist_ok=True)
            check_writable(root, "--out ")
            try:
                held.enter_context(FileLock(lock, timeout=0))
            except Timeout:
                raise UserError(
                    f"--out {root}: another run writes there; legal: wait for it, or another folder"
                ) from None
            if not continued:
                folder.write_config(config)
        yield folder, continued


@contextlib.contextmanager
def _refuse_unusable(root: Path, option: str) -> Generator[None]:
    """Turn what keeps the folder of an option from being read or written to into one line."""
    try:
        yield
    except OSError as error:
        raise UserError(
            f"{option}{root}: cannot be written to: {error.strerror}; legal: a new or empty folder"
        ) from None


def _names_in_folder(root: Path) -> list[str]:
    """List the names in a folder, if it is there, but for files half-written: a command that is killed leaves them."""
    names = (entry.name for entry in root.iterdir()) if root.exists() else ()
    return sorted(name for name in names if not name.startswith(_TEMPORARY))


def _holds_same_run(folder: RunFolder, config: Config) -> bool:
    """Return whether a folder holds a run of this experiment; a `UserError` where it holds anything else."""
    root, entries = folder.root, _names_in_folder(folder.root)
    if CONFIGURATION in entries:
        check_continues(root)
        _check_same_experiment(folder, config)
        return True
    if MANIFEST in entries:
        folder.manifest()  # one of another format is told as such
    foreign = [name for name in entries if not name.startswith(_LOCK) and name != "parts"]
    if foreign:
        raise UserError(f"--out {root}: not empty ({foreign[0]}) and not a run; legal: a new or empty folder")
    return False


def check_continues(root: Path) -> None:
    """Refuse to continue the run in a folder if version 0.4 wrote it: its parts have other columns and words."""
    if RunFolder(root).is_earlier:
        raise UserError(
            f"--out {root}: a run of version 0.4, which is not continued; legal: a new folder; "
            "show, report and compare read this one once it is finished"
        )


def _check_same_experiment(folder: RunFolder, config: Config) -> None:
    """Refuse a folder that holds a run of another experiment; the error names the first key that differs."""
    stored = folder.config()
    if stored.identity() == config.identity():
        return
    old, new = stored.canonical(), config.canonical()
    keys = [key for key in {**old, **new} if key not in COSMETIC and old.get(key) != new.get(key)]
    detail = f"{keys[0]} = {old.get(keys[0])} there, {new.get(keys[0])} now" if keys else "other axes"
    raise UserError(f"--out {folder.root}: holds a run of another configuration: {detail}")


def tables_lock(folder: RunFolder) -> FileLock:
    """Return the lock for writing the manifest or the tables; it is waited for."""
    return FileLock(folder.root / f"{_LOCK}-tables")


def presenting_lock(folder: RunFolder) -> FileLock:
    """Return the lock for presenting the tables of a run; it is waited for."""
    return FileLock(folder.root / f"{_LOCK}-presenting")


def is_written_to(root: Path) -> bool:
    """Return whether a process writes to a folder now; locks that may not be opened are skipped."""
    for path in root.glob(f"{_LOCK}*"):
        try:
            with FileLock(path, timeout=0):
                continue
        except Timeout:
            return True
        except OSError:
            continue
    return False


def continue_command(root: Path) -> str:
    """Return the command that continues the run in a folder."""
    return shlex.join(["impact-xval", "run", "--out", str(root)])


def run_folder(root: Path) -> RunFolder:
    """Return the folder of a run, or a `UserError` where there is none."""
    if not root.is_dir():
        what = "a file" if root.exists() else "no such folder"
        raise UserError(f"{root}: {what}; legal: the folder of a run")
    folder = RunFolder(root)
    return RunFolder(root, tables=renamed_tables(root)) if folder.is_earlier else folder


def finished_run(root: Path) -> RunFolder:
    """Return the folder of a run whose tables are complete, or a `UserError`; its report may be missing."""
    folder = run_folder(root)
    if folder.manifest()["state"] not in FINISHED:
        raise UserError(f"{root}: the run is not finished; to continue: {continue_command(root)}")
    return folder


def finished_run_of_pairs(root: Path) -> RunFolder:
    """Return the folder of a finished run of two balls, or a `UserError`."""
    folder = finished_run(root)
    if (kind := folder.config().kind) != "pair":
        what = "chains of N balls" if kind == "chain" else "contact graphs"
        raise UserError(f"{root}: a run of {what}; legal: a run of collisions of two balls")
    return folder


def check_writable(root: Path, option: str = "") -> None:
    """Refuse a folder into which nothing can be written, before anything is computed for it."""
    if not os.access(root, os.W_OK):
        raise UserError(
            f"{option}{root}: the folder cannot be written to; legal: one that can, such as a copy"
        )


def new_folder(root: Path, option: str = "--out ") -> None:
    """Make the folder of an option, of a command that does not continue what it finds: it must be new or empty."""
    with _refuse_unusable(root, option):
        if _names_in_folder(root):
            raise UserError(f"{option}{root}: not empty; legal: a new or empty folder")
        root.mkdir(parents=True, exist_ok=True)
    check_writable(root, option)


def cells_of_run(folder: RunFolder, config: Config) -> ExperimentCells:
    """Return the cells of a finished run; those of a list as its table has them, wherever their file is now."""
    if config.cells is None:
        return experiment_cells(config)
    path = folder.table_path("cells.parquet")
    return cells_from_ratios(
        config, np.column_stack([read_column(path, name)[:: len(config.solvers)] for name in AXES])
    )
