"""The folder of a run: the experiment, the parts, the finished tables, and the locks of processes that write.

A part is a file with the rows of one chunk of cells. The name of a part contains the identity of the run, which is a
hash of the configuration, the versions and the cells. Parts with another identity are neither read nor removed. The
commands that make, continue, show or compare runs call this module.
"""

from __future__ import annotations

import contextlib
import json
import os
import shlex
from collections import Counter
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import NotRequired, TypedDict, TypeGuard

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from filelock import FileLock, Timeout

from impact_xval.experiments.config.axes import AXES, KEPT, MAX_CELLS
from impact_xval.experiments.config.cells import ExperimentCells, cells_from_ratios, experiment_cells
from impact_xval.experiments.config.errors import UserError, is_list, is_table, read_toml
from impact_xval.experiments.config.experiment import COSMETIC, Config, load_config
from impact_xval.experiments.tables.earlier import EARLIER_FORMAT, renamed_tables
from impact_xval.experiments.tables.parquet import (
    GROUP,
    read_column,
    read_row_groups,
    read_table,
    refuse_damaged,
    replacing,
    table_writer,
)
from impact_xval.experiments.tables.schema import Layout

#: Name of the format of run folders that this version writes; it stands in every manifest.
FORMAT = "impact-xval run, format 4"
#: States of a run, as they stand in the manifest of the run. `RUNNING`: parts are still missing. `TABLES`: the tables
#: are finished. `COMPLETE`: the report on the tables is written too.
RUNNING, TABLES, COMPLETE = "running", "tables", "complete"
#: States of a run whose tables are finished.
FINISHED = (TABLES, COMPLETE)
MANIFEST, CONFIGURATION = "manifest.json", "experiment.toml"
#: Legal content of the file `CONFIGURATION`, in messages.
_OF_THE_RUN = "the experiment with which the run was begun"
#: Beginnings of the names of locks, and of files that are not yet completely written.
_LOCK, _TEMPORARY = ".lock", ".tmp-"

#: Largest number of rows with which a table is written as a CSV file too. Spreadsheets cannot open longer tables.
_CSV = 100_000
#: Number of rows of a run by solver, status and reason; the reason is "" if a row has none.
Tally = Counter[tuple[str, str, str]]


class Session(TypedDict):
    """Entry of a manifest about one session, the work of one command on a run. A run may take several commands."""

    #: Date and time at which the session ended, by ISO 8601.
    finished: str
    #: Which shard of the run the session worked on, such as ``1 of 4``.
    shard: str
    #: The place of the work, which is the address of a scheduler or ``this machine``; and the number of worker
    #: processes.
    where: str
    workers: int
    parts_reused: int
    parts_computed: int
    processes_lost: int
    #: Wall time in s of the whole session, of each stage, and of each solver.
    wall_time_s: float
    stages_s: dict[str, float]
    solver_time_s: dict[str, float]


class Manifest(TypedDict):
    """Content of ``manifest.json``: size, state and versions of a run, and the sessions that worked on it."""

    #: Name of the format of the folder. `RunFolder.write_manifest` adds it.
    format: NotRequired[str]
    #: State of the run: `RUNNING`, `TABLES` or `COMPLETE`.
    state: str
    name: str
    #: Number of cells, and number of the chunks into which the cells are divided.
    cells: int
    chunks: int
    #: Name of the solver with which all other solvers are compared.
    reference: str
    #: Hash of everything that determines the content of the parts, which is configuration, versions, and cells.
    identity: str
    #: Hash of the configuration alone, and hash of the values of the cells if they come from a sample or a file
    #: (otherwise an empty text). The manifests of version 0.4 have neither.
    configuration: NotRequired[str]
    cell_values: NotRequired[str]
    #: Versions by name: of this project and the solvers, and of the libraries that they use.
    versions: dict[str, str]
    libraries: dict[str, str]
    #: Description of the machine: texts, and the number of cores.
    machine: dict[str, str | int]
    #: Seed of the random sample of cells, or ``none`` if the cells are not a sample.
    seeds: int | str
    #: Sessions of the run, in the order in which they ended.
    sessions: list[Session]
    #: Number of rows by solver and status; only finished runs have it.
    statuses: NotRequired[dict[str, dict[str, int]]]


#: Keys of a manifest whose values are texts, and keys whose values are tables.
_TEXTS = ("state", "name", "reference", "identity")
_TABLES = ("versions", "libraries", "machine")


def _is_manifest(value: object) -> TypeGuard[Manifest]:
    """Return whether a value that was read from JSON has the keys of a manifest, with values of their types."""
    return (
        is_table(value)
        and all(isinstance(value.get(name), str) for name in _TEXTS)
        and all(is_table(value.get(name)) for name in _TABLES)
        and is_list(value.get("sessions"))
        and value["state"] in (RUNNING, *FINISHED)
        and all(type(value.get(name)) is int for name in ("cells", "chunks"))
        and value["chunks"] in range(1, MAX_CELLS + 1)
    )


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8 with line feeds; a reader sees either the old or the complete new file."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: Path, value: object) -> None:
    """Write a value as strict JSON; a reader sees either the old or the complete new file."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


@dataclass(frozen=True, slots=True)
class RunFolder:
    """The folder of a run. Its methods raise a `UserError` where a file is missing or damaged."""

    root: Path
    #: Folder of the finished tables, if the tables are not in `root`. For a run of version 0.4 it is a temporary folder
    #: with copies of the tables, in which columns and values have today's names.
    tables: Path | None = None

    @property
    def parts(self) -> Path:
        """Folder of the parts, the files with the rows of one chunk of cells each."""
        return self.root / "parts"

    def write_config(self, config: Config) -> None:
        """Write the experiment of the run, with all defaults filled in, as a TOML file."""
        write_text(self.root / CONFIGURATION, config.toml())

    def config(self) -> Config:
        """Return the experiment of the run, from its TOML file.

        The file of a run has all keys. If it has lost some of them, defaults stand in their places, and it describes
        another experiment. The manifest shows this.
        """
        path = self.root / CONFIGURATION
        if not path.exists():
            raise UserError(f"{self.root}: no {CONFIGURATION}; legal: the folder of a run ({FORMAT})")
        config = load_config(path, KEPT)
        if not read_toml(path):
            raise UserError(f"{path}: empty; legal: {_OF_THE_RUN}")
        manifest = self.manifest_or_none()
        # Another version may have other keys, which change the hash of the same experiment.
        is_of_this_version = manifest and manifest["versions"].get("impact-xval") == version("impact-xval")
        identity = config.identity()
        if manifest and is_of_this_version and manifest.get("configuration", identity) != identity:
            raise UserError(f"{path}: not the experiment of {MANIFEST}; legal: {_OF_THE_RUN}")
        return config

    def manifest_or_none(self) -> Manifest | None:
        """Return the manifest, or None if it is missing or damaged."""
        try:
            return self.manifest()
        except UserError:
            return None

    def manifest(self) -> Manifest:
        """Return the content of the manifest, whose format may be today's format or that of version 0.4."""
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
            value: object = json.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise UserError(f"{path}: cannot be read: {error.strerror}") from None
        except (ValueError, RecursionError):
            value = None
        its_format = value.get("format") if is_table(value) else None
        if isinstance(its_format, str) and its_format not in (FORMAT, EARLIER_FORMAT):
            raise UserError(
                f"{path}: format = {its_format!r:.60}; legal: {FORMAT!r}, which this version writes"
            )
        if not isinstance(its_format, str) or not _is_manifest(value):
            raise UserError(f"{path}: damaged; {again}")
        return value

    @property
    def is_earlier(self) -> bool:
        """Whether version 0.4 wrote the run; false if the manifest cannot be read."""
        manifest = self.manifest_or_none()
        return manifest is not None and manifest.get("format") == EARLIER_FORMAT

    def write_manifest(self, value: Manifest) -> None:
        """Write the manifest, with the name of today's format added."""
        write_json(self.root / MANIFEST, {"format": FORMAT, **value})

    def write_part(self, number: int, identity: str, data: bytes) -> None:
        """Write the file of a part.

        The content is not forced to the disk. If a power cut damages the file, the checksums in the file reveal the
        damage when the file is read.
        """
        with replacing(self._part(number, identity), sync=False) as temporary:
            temporary.write_bytes(data)

    def named_parts(self, numbers: Iterable[int], identity: str) -> dict[int, Path]:
        """Return the paths of those parts with the given numbers that exist in the folder, by number."""
        names = {path.name for path in self.parts.iterdir()} if self.parts.is_dir() else set()
        paths = {number: self._part(number, identity) for number in numbers}
        return {number: path for number, path in paths.items() if path.name in names}

    def _part(self, number: int, identity: str) -> Path:
        return self.parts / f"{number:06d}-{identity}.parquet"

    def remove_leftovers(self) -> None:
        """Remove the temporary files that killed processes have left in the folder."""
        for folder in (self.root, self.parts, self.root / "figures"):
            for path in folder.glob(f"{_TEMPORARY}[0-9]*-*"):
                path.unlink(missing_ok=True)

    def assemble(self, parts: dict[int, Path], layout: Layout, rows: int) -> None:
        """Write the finished tables from the parts, in the order of the cells, reading each part once.

        `rows` is the number of rows of all parts together. If it is not too large, tables are written as CSV files too.
        """
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
        """Return the number of rows of the table of cells by solver, status and reason."""
        return tally(read_row_groups(self.table_path("cells.parquet"), ["solver", "status", "reason"]))

    def table_path(self, name: str) -> Path:
        """Return the path of a finished table; raise a `UserError` if the table is missing or damaged."""
        path = (self.tables or self.root) / name
        with refuse_damaged(path):
            pq.read_schema(path)
        return path

    def read_table(self, name: str) -> pa.Table:
        """Return a whole finished table, which must fit into the memory."""
        return read_table(self.table_path(name))


def part_bytes(rows: pa.Table) -> bytes:
    """Return the rows of a chunk of cells as the bytes of a part, a Parquet file with checksums.

    Units and meanings of columns are left out, because they are the same in every part.
    """
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
    """Return the rows of a part; raise a `UserError` if the file of the part is damaged."""
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            return file.read(use_threads=False).cast(layout.part_schema)
    except (pa.ArrowException, OSError, ValueError):
        raise UserError(f"{path}: damaged; the same command computes it again") from None


def tally(tables: Iterable[pa.Table]) -> Tally:
    """Return the number of rows of several tables together, by solver, status and reason."""
    counts: Tally = Counter()
    for table in tables:
        grouped = table.group_by(["solver", "status", "reason"], use_threads=False)
        for row in grouped.aggregate([([], "count_all")]).to_pylist():
            counts[row["solver"], row["status"], row["reason"] or ""] += row["count_all"]
    return counts


def statuses_of(outcomes: Tally) -> dict[str, dict[str, int]]:
    """Return the number of rows by solver and status, from the numbers by solver, status and reason."""
    counts: dict[str, Counter[str]] = {}
    for (solver, status, _), n in outcomes.items():
        counts.setdefault(solver, Counter())[status] += n
    return {solver: dict(by_status) for solver, by_status in counts.items()}


def _row_groups(parts: Iterable[Path], layout: Layout) -> Iterator[pa.Table]:
    """Yield the rows of successive parts, joined until there are enough rows for a row group of a finished table."""
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
    root: Path, cells: ExperimentCells, shard: tuple[int, int] = (1, 1)
) -> Generator[tuple[RunFolder, bool]]:
    """Lock the folder of a run, or one shard of the run, while the `with` block runs.

    Yield the folder, and whether it already holds a run of this experiment with the same cells. The operating system
    releases the lock as soon as the process ends. In a new folder the experiment is written before any part, so that
    the folder can be recognised even if the run is killed.
    """
    folder = RunFolder(root)
    lock = root / (_LOCK if shard == (1, 1) else f"{_LOCK}-{shard[0]}-of-{shard[1]}")
    with contextlib.ExitStack() as held:
        with _refuse_unusable(root, "--out "):
            continued = _holds_same_run(folder, cells)
            folder.parts.mkdir(parents=True, exist_ok=True)
            check_writable(root, "--out ")
            if lock.is_dir():
                raise UserError(f"{lock}: a folder in the place of the lock; legal: remove it")
            try:
                held.enter_context(FileLock(lock, timeout=0))
            except Timeout:
                raise UserError(
                    f"--out {root}: another run writes there; legal: wait for it, or another folder"
                ) from None
            if not continued:
                folder.write_config(cells.config)
        yield folder, continued


@contextlib.contextmanager
def _refuse_unusable(root: Path, option: str) -> Generator[None]:
    """Turn an `OSError` of the `with` block into a `UserError`.

    The message is one line that names the option for the folder, and the cause.
    """
    try:
        yield
    except OSError as error:
        path = error.filename or root
        raise UserError(
            f"{option}{path}: cannot be written to: {error.strerror}; legal: a new or empty folder"
        ) from None


def _names_in_folder(root: Path) -> list[str]:
    """Return the sorted names in a folder; empty if there is no such folder.

    Temporary files are not among them, because a killed command leaves them behind.
    """
    names = (entry.name for entry in root.iterdir()) if root.exists() else ()
    return sorted(name for name in names if not name.startswith(_TEMPORARY))


def _holds_same_run(folder: RunFolder, cells: ExperimentCells) -> bool:
    """Return whether a folder holds a run of the experiment that has these cells.

    A folder that is empty or does not exist holds no run. A `UserError` is raised if the folder holds something other
    than a run of this experiment.
    """
    root, entries = folder.root, _names_in_folder(folder.root)
    if CONFIGURATION in entries:
        check_continues(root)
        _check_same_experiment(folder, cells.config)
        _check_same_cells(folder, cells)
        return True
    if MANIFEST in entries:
        folder.manifest()  # raises a UserError if the manifest has another format
    foreign = [name for name in entries if not name.startswith(_LOCK) and name != "parts"]
    if foreign:
        raise UserError(f"--out {root}: not empty ({foreign[0]}) and not a run; legal: a new or empty folder")
    return False


def check_continues(root: Path) -> None:
    """Raise a `UserError` if version 0.4 wrote the run in a folder.

    Such a run cannot be continued, because its parts have other columns and words.
    """
    if RunFolder(root).is_earlier:
        raise UserError(
            f"--out {root}: a run of version 0.4, which is not continued; legal: a new folder; "
            "show, report and compare read this one once it is finished"
        )


def _check_same_experiment(folder: RunFolder, config: Config) -> None:
    """Raise a `UserError` if a folder holds a run of another experiment. It names the first key that differs."""
    stored = folder.config()
    if stored.identity() == config.identity():
        return
    old, new = stored.canonical(), config.canonical()
    keys = [key for key in {**old, **new} if key not in COSMETIC and old.get(key) != new.get(key)]
    detail = f"{keys[0]} = {old.get(keys[0])} there, {new.get(keys[0])} now" if keys else "other axes"
    raise UserError(f"--out {folder.root}: holds a run of another configuration: {detail}")


def _check_same_cells(folder: RunFolder, cells: ExperimentCells) -> None:
    """Raise a `UserError` if a folder holds a run whose cells had other values, such as another file of cells."""
    manifest = folder.manifest_or_none()
    if manifest and manifest.get("cell_values", cells.digest) != cells.digest:
        source = "the sample" if cells.config.cells is None else cells.config.cells
        raise UserError(
            f"--out {folder.root}: holds a run of other cells than those of {source}; legal: the same cells, "
            "or a new folder"
        )


def tables_lock(folder: RunFolder) -> FileLock:
    """Return the lock that a process must hold to write the manifest or the tables. Processes wait until it is free."""
    return FileLock(folder.root / f"{_LOCK}-tables")


def presenting_lock(folder: RunFolder) -> FileLock:
    """Return the lock that a process must hold to write the report of a run. Processes wait until it is free."""
    return FileLock(folder.root / f"{_LOCK}-presenting")


def is_written_to(root: Path) -> bool:
    """Return whether a process holds a lock of a folder now; locks that this process may not open do not count."""
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
    """Return the folder of a run; raise a `UserError` if there is no such folder."""
    if not root.is_dir():
        what = "a file" if root.exists() else "no such folder"
        raise UserError(f"{root}: {what}; legal: the folder of a run")
    folder = RunFolder(root)
    return RunFolder(root, tables=renamed_tables(root)) if folder.is_earlier else folder


def finished_run(root: Path) -> RunFolder:
    """Return the folder of a run whose tables are complete; raise a `UserError` if tables are missing.

    The report of the run may still be missing.
    """
    folder = run_folder(root)
    if folder.manifest()["state"] not in FINISHED:
        raise UserError(f"{root}: the run is not finished; to continue: {continue_command(root)}")
    return folder


def finished_run_of_pairs(root: Path) -> RunFolder:
    """Return the folder of a finished run of two balls; raise a `UserError` for an unfinished or any other run."""
    folder = finished_run(root)
    if (kind := folder.config().kind) != "pair":
        what = "chains of N balls" if kind == "chain" else "contact graphs"
        raise UserError(f"{root}: a run of {what}; legal: a run of collisions of two balls")
    return folder


def check_writable(root: Path, option: str = "") -> None:
    """Raise a `UserError` if nothing can be written into a folder.

    This is checked before anything is computed whose results go into the folder.
    """
    if not os.access(root, os.W_OK):
        raise UserError(
            f"{option}{root}: the folder cannot be written to; legal: one that can, such as a copy"
        )


def new_folder(root: Path, option: str = "--out ") -> None:
    """Make the folder in which a command writes its results; raise a `UserError` if it exists and is not empty.

    Commands that cannot continue earlier results call this function. `option` is the option of the command that names
    the folder.
    """
    with _refuse_unusable(root, option):
        if _names_in_folder(root):
            raise UserError(f"{option}{root}: not empty; legal: a new or empty folder")
        root.mkdir(parents=True, exist_ok=True)
    check_writable(root, option)


def cells_of_run(folder: RunFolder, config: Config) -> ExperimentCells:
    """Return the cells of a finished run.

    If the cells of the run came from a file, they are read from the table of the run, because the file may be gone.
    """
    if config.cells is None:
        return experiment_cells(config)
    path = folder.table_path("cells.parquet")
    return cells_from_ratios(
        config, np.column_stack([read_column(path, name)[:: len(config.solvers)] for name in AXES])
    )
