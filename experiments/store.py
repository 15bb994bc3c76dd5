"""The folder of a run: what may be written where, and that nothing is ever half-written.

Every file is written under a temporary name beside its place and renamed. Parts (the rows of one chunk of
cells) carry in their names the identity of what was asked and the SHA-256 of what was written, so a part
that is stale, truncated or altered is recognised without trusting it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from experiments.config import REFERENCE, Config, from_canonical
from experiments.errors import UserError
from experiments.schema import CELLS_SCHEMA, DIVERGENCE_SCHEMA, ROW_SCHEMA

FORMAT = "impact-xval run, format 1"
MANIFEST = "manifest.json"
TABLES = (
    "cells.parquet",
    "divergence.parquet",
    "divergence.csv",
    "curves.parquet",
    "ladder.parquet",
    "ladder.csv",
)

_TEMPORARY = ".tmp-"
_PART = re.compile(r"(\d{6,})-([0-9a-f]{32})-([0-9a-f]{64})\.parquet")
#: Rows of one row group of the finished tables.
_GROUP = 65_536


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path` that takes its place when the block ends without an error."""
    temporary = path.with_name(f"{_TEMPORARY}{os.getpid()}-{path.name}")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8, line feeds) in one step."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: Path, value: Any) -> None:
    """Write strict JSON in one step."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


@dataclass(frozen=True, slots=True)
class RunFolder:
    """The folder of a run."""

    root: Path

    @property
    def parts(self) -> Path:
        """Folder of the parts."""
        return self.root / "parts"

    def write_part(self, number: int, identity: str, rows: list[dict[str, Any]]) -> Path:
        """Write the rows of a chunk, under a name that tells what they are and that they are whole."""
        sink = pa.BufferOutputStream()
        pq.write_table(pa.Table.from_pylist(rows, schema=ROW_SCHEMA), sink, compression="zstd")
        data = sink.getvalue().to_pybytes()
        path = self.parts / f"{number:06d}-{identity}-{hashlib.sha256(data).hexdigest()}.parquet"
        with replacing(path) as temporary:
            temporary.write_bytes(data)
        return path

    def find_parts(self, identities: Iterable[str]) -> tuple[dict[int, Path], list[str]]:
        """Find the parts that are whole and belong to this run; remove the others.

        Parameters
        ----------
        identities : iterable of str
            The identity of every chunk, in order.

        Returns
        -------
        parts : dict
            Path by number of the chunk.
        findings : list of str
            One line for every part that was found and not kept.
        """
        expected = dict(enumerate(identities))
        parts: dict[int, Path] = {}
        findings: list[str] = []
        for path in sorted(self.parts.iterdir()) if self.parts.is_dir() else []:
            if path.name.startswith(_TEMPORARY):
                path.unlink()
            match = _PART.fullmatch(path.name)
            if match is None:
                continue
            number, identity, digest = int(match[1]), match[2], match[3]
            if expected.get(number) != identity:
                problem = "belongs to another configuration or version"
            elif _digest(path) != digest:
                problem = "is damaged"
            else:
                parts[number] = path
                continue
            findings.append(f"part {number} {problem}: computed again")
            path.unlink()
        return parts, findings

    def assemble(self, parts: dict[int, Path]) -> None:
        """Write the finished tables from the parts, in the order of the cells, one part at a time."""
        with (
            _table(self.root / "cells.parquet", CELLS_SCHEMA) as cells,
            _table(self.root / "divergence.parquet", DIVERGENCE_SCHEMA) as divergence,
            replacing(self.root / "divergence.csv") as text,
            pacsv.CSVWriter(str(text), DIVERGENCE_SCHEMA) as csv,
        ):
            for number in sorted(parts):
                rows = pq.read_table(parts[number], schema=ROW_SCHEMA)
                cells.add(rows)
                compared = rows.filter(pc.field("solver") != REFERENCE)
                divergence.add(compared)
                csv.write_table(compared.select(DIVERGENCE_SCHEMA.names).cast(DIVERGENCE_SCHEMA))

    def statuses(self) -> dict[str, dict[str, int]]:
        """Count of every status by solver."""
        table = pq.read_table(self.root / "cells.parquet", columns=["solver", "status"])
        counts: dict[str, dict[str, int]] = {}
        for row in (
            table.group_by(["solver", "status"], use_threads=False).aggregate([([], "count_all")]).to_pylist()
        ):
            counts.setdefault(row["solver"], {})[row["status"]] = row["count_all"]
        return counts

    def digests(self) -> dict[str, str]:
        """SHA-256 of every finished table."""
        return {name: _digest(self.root / name) for name in TABLES}

    def manifest(self) -> dict[str, Any]:
        """Read the manifest.

        Raises
        ------
        UserError
            If there is none, or it is not ours.
        """
        path = self.root / MANIFEST
        try:
            value = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise UserError(f"{self.root}: no {MANIFEST}; legal: the folder of a run") from None
        except OSError as error:
            raise UserError(f"{path}: cannot be read: {error.strerror}") from None
        except (ValueError, RecursionError):
            raise UserError(f"{path}: damaged, not JSON; legal: the manifest of a run") from None
        if not isinstance(value, dict) or value.get("format") != FORMAT:
            raise UserError(f"{path}: not the manifest of a run ({FORMAT})")
        return value

    def config(self) -> Config:
        """Read the configuration of the run from its manifest."""
        configuration = self.manifest().get("configuration")
        if not isinstance(configuration, dict):
            raise UserError(f"{self.root / MANIFEST}: configuration is missing; legal: the manifest of a run")
        return from_canonical(configuration, str(self.root / MANIFEST))

    def read_table(self, name: str, schema: pa.Schema) -> pa.Table:
        """Read a finished table.

        Raises
        ------
        UserError
            If it is missing, damaged or has other columns.
        """
        path = self.root / name
        recorded = self.manifest().get("files")
        try:
            if isinstance(recorded, dict) and recorded.get(name) != _digest(path):
                raise UserError(
                    f"{path}: altered since it was written; impact-xval run --resume writes it again"
                )
            table = pq.read_table(path)
        except FileNotFoundError:
            raise UserError(
                f"{path}: no such file; finish the run first (impact-xval run --resume)"
            ) from None
        except (OSError, pa.ArrowException):
            raise UserError(
                f"{path}: damaged, not Parquet; impact-xval run --resume writes it again"
            ) from None
        if table.schema.names != schema.names:
            raise UserError(
                f"{path}: has other columns than a run writes; impact-xval run --resume writes it again"
            )
        return table


def open_folder(root: Path, *, resume: bool) -> tuple[RunFolder, bool]:
    """Check that a run may write to a folder, and create it.

    Parameters
    ----------
    root : Path
        The folder.
    resume : bool
        Whether a run that is there may be continued.

    Returns
    -------
    folder : RunFolder
    continued : bool
        Whether a run is there.

    Raises
    ------
    UserError
        If the folder holds something else, holds a run and `resume` is false, or cannot be written to.
    """
    folder = RunFolder(root)
    existed = root.exists()
    try:
        entries = sorted(entry.name for entry in root.iterdir()) if existed else []
        continued = MANIFEST in entries
        # What a run leaves that was killed before its first line of work.
        started = folder.parts.is_dir() and not any(folder.parts.iterdir())
    except NotADirectoryError:
        raise UserError(f"--out {root}: is a file; legal: a new or empty folder") from None
    except OSError as error:
        raise UserError(f"--out {root}: cannot be read: {error.strerror}") from None
    foreign = [name for name in entries if not (name.startswith(_TEMPORARY) or (started and name == "parts"))]
    if continued:
        folder.manifest()
        if not resume:
            raise UserError(
                f"--out {root}: already holds a run; add --resume to continue it, or name another folder"
            )
    elif foreign:
        raise UserError(f"--out {root}: not empty ({foreign[0]}) and not a run; legal: a new or empty folder")
    try:
        folder.parts.mkdir(parents=True, exist_ok=True)
        for directory in (root, folder.parts):
            tempfile.TemporaryFile(dir=directory).close()
    except OSError as error:
        if not existed:
            with contextlib.suppress(OSError):
                folder.parts.rmdir()
                root.rmdir()
        raise UserError(f"--out {root}: cannot be written to: {error.strerror}") from None
    return folder, continued


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class _Groups:
    """Pieces of any size, written as row groups of one size."""

    def __init__(self, writer: pq.ParquetWriter, schema: pa.Schema) -> None:
        self._writer, self._schema = writer, schema
        self._pending = schema.empty_table()

    def add(self, rows: pa.Table) -> None:
        rows = rows.select(self._schema.names).cast(self._schema)
        self._pending = pa.concat_tables([self._pending, rows])
        if len(self._pending) >= _GROUP:
            self.flush(len(self._pending) // _GROUP * _GROUP)

    def flush(self, end: int) -> None:
        if end:
            self._writer.write_table(self._pending.slice(0, end).combine_chunks(), row_group_size=_GROUP)
        self._pending = self._pending.slice(end)

    def __len__(self) -> int:
        return len(self._pending)


@contextlib.contextmanager
def _table(path: Path, schema: pa.Schema) -> Iterator[_Groups]:
    """Write a Parquet table piece by piece; its row groups do not depend on the pieces."""
    with replacing(path) as temporary, pq.ParquetWriter(temporary, schema, compression="zstd") as writer:
        groups = _Groups(writer, schema)
        yield groups
        groups.flush(len(groups))
