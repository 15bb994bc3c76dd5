"""The folder of a run: what may be written where, and that nothing is ever half-written.

Every file is written under a temporary name beside its place and renamed. Parts (the rows of one chunk of
cells) carry in their names the identity of what was asked and the SHA-256 of what was written, so a part
that is stale, truncated or altered is recognised without trusting it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from pydantic import BaseModel, Field

from impact_xval.experiments.config.axes import MAX_CELLS
from impact_xval.experiments.config.errors import UserError, validated
from impact_xval.experiments.config.experiment import Config, from_canonical
from impact_xval.experiments.tables.schema import TABLES, Layout
from impact_xval.experiments.tables.streams import (
    blocks,
    replaced_by,
    replacing,
    table_writer,
)

FORMAT = "impact-xval run, format 1"
#: States of a run whose tables are written; "complete" is one with its report.
FINISHED = ("tables", "complete")
MANIFEST = "manifest.json"
#: Beside the parts: what they are of, for when the manifest is lost.
CONFIGURATION = "configuration.json"

#: Rows that are joined together, at least.
_PIECE = 8192
#: Number of rows by solver, status and reason ("" if none).
Tally = Counter[tuple[str, str, str]]

PART = re.compile(r"(\d{6,})-([0-9a-f]{32})-([0-9a-f]{64})\.parquet")

#: Files a run writes, by folder.
_WRITTEN = {
    ".": re.compile("|".join(map(re.escape, (MANIFEST, *TABLES))) + r"|summary\.(md|csv|tex)|report\.html"),
    "parts": re.compile(rf"{PART.pattern}|{re.escape(CONFIGURATION)}"),
    "figures": re.compile(r"[a-z0-9-]+\.(png|pdf)|captions\.json"),
}


class DamagedManifestError(UserError):
    """There is no manifest, or none that can be used; its parts may be whole."""


class _Session(BaseModel, strict=True):
    """What is read of a session of a run."""

    finished: str = Field(description="a date and time")
    parts_computed: int = Field(0, ge=0, le=MAX_CELLS, description=f"a whole number from 0 to {MAX_CELLS}")
    wall_time_s: float = Field(0.0, ge=0, allow_inf_nan=False, description="a number")


class _Manifest(BaseModel, strict=True):
    """What is read of the manifest of a run."""

    state: Literal["running", "tables", "complete"] = Field(description="'running', 'tables' or 'complete'")
    configuration: dict[str, Any] = Field(description="a table")
    versions: dict[str, str] = Field(description="a table of texts")
    cells: int = Field(ge=1, le=MAX_CELLS, description=f"a whole number from 1 to {MAX_CELLS}")
    chunks: int = Field(ge=1, le=MAX_CELLS, description=f"a whole number from 1 to {MAX_CELLS}")
    started: str = Field(description="a date and time")
    identity: str = Field(description="a text")
    seeds: str = Field(description="a text")
    libraries: dict[str, str] = Field(description="a table of texts")
    machine: dict[str, Any] = Field(description="a table")
    sessions: list[_Session] = Field(description="a list of tables")
    files: dict[str, str] = Field({}, description="a table of digests")


def write_text(path: Path, text: str) -> None:
    """Write a text file (UTF-8, line feeds) in one step."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: Path, value: Any) -> None:
    """Write strict JSON in one step."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


@dataclass(frozen=True, slots=True)
class RunFolder:
    """The folder of a run.

    Attributes
    ----------
    root : Path
    """

    root: Path

    @property
    def parts(self) -> Path:
        """Folder of the parts."""
        return self.root / "parts"

    def write_part(self, number: int, identity: str, data: bytes) -> Path:
        """Write a part, under a name that tells what it is and what it holds.

        It need not be on the disk when this returns: a part that a power cut emptied is recognised by its name.
        """
        path = self.parts / f"{number:06d}-{identity}-{hashlib.sha256(data).hexdigest()}.parquet"
        with replacing(path, sync=False) as temporary:
            temporary.write_bytes(data)
        return path

    def find_parts(
        self, identities: Sequence[str], rows: Callable[[int], pa.Table], layout: Layout
    ) -> tuple[dict[int, Path], list[str]]:
        """Find the parts that are whole and belong to this run; remove the others.

        Parameters
        ----------
        identities : sequence of str
            The identity of every chunk, in order.
        rows : callable
            The columns ``cell`` and ``solver`` of a chunk, by its number.
        layout : Layout
            Of the run.

        Returns
        -------
        parts : dict
            Path by number of the chunk.
        findings : list of str
            One line for every part that was found and not kept.

        Raises
        ------
        UserError
            If something that is not a file has the name of a part.
        """
        parts: dict[int, Path] = {}
        findings: list[str] = []
        for path, number, identity, digest in self._named_parts():
            if not path.is_file():
                raise UserError(f"{path}: not a regular file; legal: a part that a run wrote, or nothing")
            if number in parts:
                problem = "is there twice"
            elif identity not in identities[number : number + 1]:
                problem = "belongs to another configuration or version"
            elif (problem := _problem(path, digest, layout, rows(number))) == "":
                parts[number] = path
                continue
            findings.append(f"part {number} {problem}: computed again")
            path.unlink()
        return parts, findings

    def _named_parts(self) -> Iterator[tuple[Path, int, str, str]]:
        """Go through what has the name of a part, in order: path, number, identity, digest."""
        for path in sorted(self.parts.glob("*")):
            match = PART.fullmatch(path.name)
            if match is not None:
                yield path, int(match[1]), match[2], match[3]

    def has_parts(self, identities: Sequence[str] | None = None) -> bool:
        """Whether there are parts, by their names; those of some identities only, where they are given."""
        return any(
            identities is None or identity in identities[number : number + 1]
            for _, number, identity, _ in self._named_parts()
        )

    def remove_leftovers(self) -> None:
        """Remove the temporary files of runs that were killed, where a run writes, and nothing else."""
        for folder, written in _WRITTEN.items():
            for path in sorted((self.root / folder).glob(".tmp-*")):
                if written.fullmatch(replaced_by(path.name)) and path.is_file():
                    path.unlink()

    def assemble(self, parts: dict[int, Path], layout: Layout) -> None:
        """Write the finished tables from the parts, in the order of the cells, one part at a time."""
        with contextlib.ExitStack() as stack:
            writers = []
            for name, cut in layout.tables.items():
                table = stack.enter_context(table_writer(self.root / f"{name}.parquet", cut.schema))
                csv = None
                if cut.text:
                    text = stack.enter_context(replacing(self.root / f"{name}.csv"))
                    csv = stack.enter_context(pacsv.CSVWriter(str(text), cut.schema))
                writers.append((cut, table, csv))
            for rows in _pieces((parts[number] for number in sorted(parts)), layout):
                for cut, table, csv in writers:
                    some = cut.of(rows)
                    table.add(some)
                    if csv is not None:
                        csv.write_table(some)

    def tally(self) -> Tally:
        """Count the rows of the finished table of cells by what became of them."""
        return tally(blocks(self.root / "cells.parquet", ["solver", "status", "reason"], whole_cells=False))

    def digests(self) -> dict[str, str]:
        """SHA-256 of every finished table."""
        return {name: _digest(self.root / name) for name in TABLES if (self.root / name).exists()}

    def manifest(self) -> dict[str, Any]:
        """Read the manifest.

        Raises
        ------
        DamagedManifestError
            If there is none, or none that can be used.
        UserError
            If it is not that of a run.
        """
        path = self.root / MANIFEST
        kept = "; --resume writes it again" if self.has_parts() else ""
        try:
            with path.open("rb") as file:
                value = json.loads(file.read().decode("utf-8"))
        except FileNotFoundError:
            raise DamagedManifestError(
                f"{self.root}: no {MANIFEST}; legal: the folder of a run{kept}"
            ) from None
        except OSError as error:
            raise UserError(f"{path}: cannot be read: {error.strerror}") from None
        except (ValueError, RecursionError):
            raise DamagedManifestError(
                f"{path}: damaged, not JSON; legal: the manifest of a run{kept}"
            ) from None
        if not isinstance(value, dict) or "format" not in value:
            raise DamagedManifestError(f"{path}: not the manifest of a run ({FORMAT}){kept}")
        if value["format"] != FORMAT:
            raise UserError(f"{path}: not the manifest of a run ({FORMAT})")
        try:
            validated(_Manifest, value, str(path))
        except UserError as error:
            raise DamagedManifestError(f"{error}{_written_by(value)}{kept}") from None
        return value

    def config(self) -> Config:
        """Read the configuration of the run from its manifest.

        Raises
        ------
        UserError
            As for `manifest`.
        """
        manifest = self.manifest()
        path = self.root / MANIFEST
        try:
            config = from_canonical(manifest["configuration"], str(path))
        except UserError as error:
            raise DamagedManifestError(f"{error}{_written_by(manifest)}") from None
        except RecursionError:
            raise DamagedManifestError(f"{path}: nested too deeply") from None
        if manifest.get("identity", config.identity()) != config.identity():
            legal = f"legal: both as the run wrote them{_written_by(manifest)}"
            raise DamagedManifestError(f"{path}: configuration and identity do not go together; {legal}")
        return config

    def kept_config(self) -> Config:
        """Read the configuration of the run, from beside its parts where the manifest is missing or damaged.

        Raises
        ------
        UserError
            As for `manifest`, where it is in neither place.
        """
        try:
            return self.config()
        except DamagedManifestError as damage:
            path = self.parts / CONFIGURATION
            try:
                with path.open("rb") as file:
                    return from_canonical(json.loads(file.read().decode("utf-8")), str(path))
            except (OSError, ValueError, RecursionError, UserError, AttributeError, TypeError):
                raise damage from None

    def table_path(self, name: str) -> Path:
        """Return the path of a finished table, after a look at whether it is what was written.

        Raises
        ------
        UserError
            If it is missing, damaged, or nothing says what was written.
        """
        path, manifest = self.root / name, self.manifest()
        again = "impact-xval run --resume writes it again"
        recorded = manifest.get("files", {}).get(name)
        if recorded is None:
            raise UserError(f"{self.root / MANIFEST}: files: no digest of {name}; {again}")
        try:
            if recorded != _digest(path):
                raise UserError(f"{path}: altered since it was written; {again}")
            pq.read_schema(path)
        except FileNotFoundError:
            raise UserError(
                f"{path}: no such file; finish the run first (impact-xval run --resume)"
            ) from None
        except (OSError, pa.ArrowException):
            raise UserError(f"{path}: damaged, not Parquet; {again}") from None
        return path

    def read_table(self, name: str) -> pa.Table:
        """Read a finished table whole; for small ones."""
        return pq.read_table(self.table_path(name))


def part_bytes(rows: pa.Table) -> bytes:
    """Return the rows of a chunk as the content of a part, without what is the same in every part."""
    bare = pa.schema([pa.field(field.name, field.type) for field in rows.schema])
    sink = pa.BufferOutputStream()
    pq.write_table(
        rows.combine_chunks().cast(bare), sink, compression="zstd", write_statistics=False, store_schema=False
    )
    return sink.getvalue().to_pybytes()


def read_part(source: Path | bytes, layout: Layout) -> pa.Table:
    """Read the rows of a part, from its file or its content.

    Raises
    ------
    UserError
        If it does not hold the rows of a chunk, whatever its name says.
    """
    try:
        with pq.ParquetFile(pa.BufferReader(source) if isinstance(source, bytes) else source) as file:
            return file.read(use_threads=False).cast(layout.rows)
    except (pa.ArrowException, ValueError):
        raise UserError(f"{source!s:.200}: not a part of a run; legal: remove it, and --resume") from None


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
    counts: dict[str, dict[str, int]] = {}
    for (solver, status, _), n in outcomes.items():
        of_solver = counts.setdefault(solver, {})
        of_solver[status] = of_solver.get(status, 0) + n
    return counts


def _pieces(parts: Iterable[Path], layout: Layout) -> Iterator[pa.Table]:
    """Read parts, several at a time: what is done with a table costs more for its columns than for its rows."""
    tables: list[pa.Table] = []
    for part in parts:
        tables.append(read_part(part, layout))
        if sum(map(len, tables)) >= _PIECE:
            yield pa.concat_tables(tables)
            tables = []
    if tables:
        yield pa.concat_tables(tables)


def _written_by(manifest: dict[str, Any]) -> str:
    """Name both versions where a run is another version's."""
    versions, here = manifest.get("versions"), version("impact-xval")
    there = versions.get("impact-xval", here) if isinstance(versions, dict) else here
    return "" if there == here else f" (written by impact-xval {there}, read by {here})"


def _problem(path: Path, digest: str, layout: Layout, rows: pa.Table | None = None) -> str:
    """Say why a part cannot be used, "" if it can; `rows` are the cells and solvers it must be of."""
    try:
        if _digest(path) != digest:
            return "is damaged"
        if rows is not None and not read_part(path, layout).select(rows.column_names).equals(rows):
            return "holds the rows of another"
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    except UserError:
        return "is no part"
    return ""


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
