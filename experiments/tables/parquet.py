"""Tables larger than the memory: read in blocks of whole cells, written in row groups of one size, put in place whole.

Tables are written by Arrow: polars (2.1) and DuckDB (2.0) keep neither the units in the metadata of the
columns nor the type of text, and their means differ from those of pandas in the last bits.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

#: Rows of one row group of the tables, and of one block that is read.
GROUP = 65_536


@contextlib.contextmanager
def replacing(path: Path, *, sync: bool = True) -> Iterator[Path]:
    """Give a temporary path beside `path` that takes its place when the block ends without an error.

    With `sync` the content is on the disk before the name is: a power cut could leave a name without its content.
    """
    temporary = path.with_name(f".tmp-{os.getpid()}-{path.name}")
    try:
        yield temporary
        if sync:
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        error.filename = error.filename or str(path)  # a full disk does not say for which file
        raise
    finally:
        with contextlib.suppress(OSError):  # what went wrong before is what is told
            temporary.unlink()


@contextlib.contextmanager
def table_writer(path: Path, schema: pa.Schema) -> Iterator[Callable[[pa.Table], None]]:
    """Give what adds rows to a Parquet table, which is put in its place at the end.

    Its row groups do not depend on the pieces it comes in.
    """
    pending = schema.empty_table()

    def add(rows: pa.Table, group: int = GROUP) -> None:
        nonlocal pending
        pending = pa.concat_tables([pending, rows])
        end = len(pending) // group * group
        if end:
            writer.write_table(pending.slice(0, end).combine_chunks(), row_group_size=GROUP)
            # Copied: a slice would keep alive all that it was cut from.
            pending = pending.slice(end).combine_chunks()

    with replacing(path) as temporary, pq.ParquetWriter(temporary, schema, compression="zstd") as writer:
        yield add
        add(schema.empty_table(), group=1)


def blocks(path: Path, columns: Sequence[str]) -> Iterator[pa.Table]:
    """Read columns of a table whose rows are ordered by ``cell``, a block of about `GROUP` rows at a time.

    With ``cell`` among them all rows of a cell are in one block.
    """
    with pq.ParquetFile(path) as file:
        batches = file.iter_batches(GROUP, columns=list(columns))
        tables = (pa.Table.from_batches([batch]) for batch in batches)
        if "cell" not in columns:
            yield from tables
            return
        rest: list[pa.Table] = []
        for table in tables:
            block = pa.concat_tables([*rest, table])
            cells = block.column("cell").to_numpy()
            cut = int(np.searchsorted(cells, cells[-1]))
            rest = [block.slice(cut).combine_chunks()]
            if cut:
                yield block.slice(0, cut)
        yield from rest


def selected(path: Path, columns: Sequence[str], keep: pc.Expression | None = None) -> pa.Table:
    """Read columns of the rows for which a condition holds; text as dictionaries, which take a byte or two a row."""
    # not those of the condition alone: before pyarrow 26, none of a dictionary without entries is null
    text = [f.name for f in pq.read_schema(path) if pa.types.is_string(f.type) and f.name in columns]
    return pq.read_table(path, columns=list(columns), filters=keep, read_dictionary=text).unify_dictionaries()


def column(path: Path, name: str) -> np.ndarray:
    """Read one column whole: text as objects; numbers or truths as float64, nulls as NaN."""
    found = selected(path, [name])[name]
    if pa.types.is_dictionary(found.type):
        return found.to_pandas().to_numpy(dtype=object)
    return found.cast(pa.float64()).to_numpy()


def present(path: Path, name: str) -> np.ndarray:
    """Read where one column is not null."""
    return selected(path, [name])[name].is_valid().to_numpy()


def codes(path: Path, name: str, values: Sequence[str]) -> np.ndarray:
    """Read one column of text as the position of each entry among some values; -1 where it is none of them."""
    known = selected(path, [name])[name].combine_chunks().dictionary_encode()
    places = pd.Index(values).get_indexer(known.dictionary.to_pylist()).astype(np.int8)
    return np.append(places, np.int8(-1))[known.indices.fill_null(-1)]
