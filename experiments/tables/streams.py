"""Tables larger than the memory: read in blocks of whole cells, written in row groups of one size.

A derived table is a function of blocks::

    derive(folder.root / "cells.parquet", folder.root / "mine.parquet", schema, function)

where ``function`` gets every row of some cells as a `pyarrow.Table` and returns the rows of the new
table. All rows of a cell are in one block, blocks come in the order of the cells, and the file that is
written does not depend on where the blocks were cut.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

#: Rows of one row group of the tables, and of one block that is read.
GROUP = 65_536

_TEMPORARY = ".tmp-"


@contextlib.contextmanager
def replacing(path: Path, *, sync: bool = True) -> Iterator[Path]:
    """Give a temporary path beside `path` that takes its place when the block ends without an error.

    Parameters
    ----------
    path : Path
    sync : bool
        Whether the content must be on the disk before the name is; a power cut could otherwise leave a name
        without its content.
    """
    temporary = path.with_name(f"{_TEMPORARY}{os.getpid()}-{path.name}")
    try:
        yield temporary
        if sync:
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def is_temporary(name: str) -> bool:
    """Whether a file is what `replacing` leaves when its process is killed."""
    return name.startswith(_TEMPORARY)


class TableWriter:
    """A Parquet table written piece by piece; its row groups do not depend on the pieces."""

    def __init__(self, writer: pq.ParquetWriter, schema: pa.Schema) -> None:
        self._writer, self._schema = writer, schema
        self._pending: list[pa.Table] = []
        self._rows = 0

    def add(self, rows: pa.Table) -> None:
        """Add rows; columns are picked by name."""
        rows = rows.select(self._schema.names).cast(self._schema)
        self._pending.append(rows)
        self._rows += len(rows)
        if self._rows >= GROUP:
            self._flush(self._rows // GROUP * GROUP)

    def finish(self) -> None:
        """Write what is left."""
        self._flush(self._rows)

    def _flush(self, end: int) -> None:
        if end:
            whole = pa.concat_tables(self._pending)
            self._writer.write_table(whole.slice(0, end).combine_chunks(), row_group_size=GROUP)
            # Copied: a slice would keep alive all that it was cut from.
            rest = whole.slice(end).combine_chunks()
            self._pending, self._rows = [rest], len(rest)


@contextlib.contextmanager
def table_writer(path: Path, schema: pa.Schema) -> Iterator[TableWriter]:
    """Write a Parquet table piece by piece, and put it in its place at the end."""
    with replacing(path) as temporary, pq.ParquetWriter(temporary, schema, compression="zstd") as writer:
        table = TableWriter(writer, schema)
        yield table
        table.finish()


def blocks(
    path: Path, columns: Sequence[str] | None = None, *, whole_cells: bool = True
) -> Iterator[pa.Table]:
    """Read a table whose rows are ordered by ``cell``, a block at a time.

    Parameters
    ----------
    path : Path
        A Parquet table.
    columns : sequence of str, optional
        Columns to read; by default all.
    whole_cells : bool
        Whether all rows of a cell must be in one block; then ``cell`` must be among the columns.

    Yields
    ------
    pyarrow.Table
        About `GROUP` rows.
    """
    rest: pa.Table | None = None
    with pq.ParquetFile(path) as file:
        for batch in file.iter_batches(GROUP, columns=list(columns) if columns is not None else None):
            block = pa.Table.from_batches([batch])
            if not whole_cells:
                yield block
                continue
            block = block if rest is None else pa.concat_tables([rest, block])
            cells = block.column("cell").to_numpy()
            cut = int(np.searchsorted(cells, cells[-1]))
            rest = block.slice(cut).combine_chunks()
            if cut:
                yield block.slice(0, cut)
    if rest is not None and len(rest):
        yield rest


def selected(path: Path, columns: Sequence[str], keep: pc.Expression) -> pa.Table:
    """Read the rows for which a condition holds; text as dictionaries, which take a byte or two a row.

    Parameters
    ----------
    path : Path
        A Parquet table.
    columns : sequence of str
        Columns to read, those of the condition among them.
    keep : pyarrow.compute.Expression
        The condition.
    """
    pieces = [pq.read_schema(path).empty_table().select(list(columns))]
    pieces += [block.filter(keep) for block in blocks(path, columns, whole_cells=False)]
    table = pa.concat_tables(map(_encoded, pieces))
    return table.unify_dictionaries()


def _encoded(table: pa.Table) -> pa.Table:
    for i, field in enumerate(table.schema):
        if pa.types.is_string(field.type):
            table = table.set_column(i, field.name, table.column(i).dictionary_encode())
    return table


def derive(
    source: Path,
    target: Path,
    schema: pa.Schema,
    transform: Callable[[pa.Table], pa.Table],
    columns: Sequence[str] | None = None,
) -> None:
    """Write a table that is a function of another, block by block.

    Parameters
    ----------
    source, target : Path
        Parquet tables; the rows of `source` are ordered by ``cell``.
    schema : pyarrow.Schema
        Of the table that is written.
    transform : callable
        Makes the new rows of all rows of some cells.
    columns : sequence of str, optional
        Columns of `source` that are needed, ``cell`` among them; by default all.
    """
    with table_writer(target, schema) as table:
        for block in blocks(source, columns):
            table.add(transform(block))


def column(path: Path, name: str) -> np.ndarray:
    """Read one column of numbers or truths as float64, nulls as NaN."""
    pieces = [
        block.column(0).cast(pa.float64()).to_numpy() for block in blocks(path, [name], whole_cells=False)
    ]
    return np.concatenate(pieces) if pieces else np.empty(0)


def present(path: Path, name: str) -> np.ndarray:
    """Read where one column is not null."""
    pieces = [
        block.column(0).is_valid().to_numpy().astype(bool)
        for block in blocks(path, [name], whole_cells=False)
    ]
    return np.concatenate(pieces) if pieces else np.empty(0, bool)


def codes(path: Path, name: str, values: Sequence[str]) -> np.ndarray:
    """Read one column of text as the position of each entry among some values; -1 where it is none of them."""
    known = pa.array(values, pa.string())
    pieces = [
        pc.call_function("index_in", [block.column(0)], pc.SetLookupOptions(known))
        .fill_null(-1)
        .to_numpy()
        .astype(np.int8)
        for block in blocks(path, [name], whole_cells=False)
    ]
    return np.concatenate(pieces) if pieces else np.empty(0, np.int8)
