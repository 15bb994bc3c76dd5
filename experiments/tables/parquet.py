"""Tables larger than the memory: written and read in row groups of whole cells, put in place whole.

Tables are written by Arrow: polars (2.1) and DuckDB (2.0) keep neither the units in the metadata of the
columns nor the type of text, and their means differ from those of pandas in the last bits.
"""

from __future__ import annotations

import bisect
import contextlib
import itertools
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

#: Rows from which on parts are one row group of the tables.
GROUP = 65_536


@contextlib.contextmanager
def replacing(path: Path, *, sync: bool = True) -> Generator[Path]:
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
        # A full disk does not say for which file, others name the temporary one, Arrow in its words.
        if error.filename is None or str(error.filename) == str(temporary):
            error.filename, error.filename2 = str(path), None
        if error.errno is not None and temporary.name in str(error.strerror):
            error.strerror = os.strerror(error.errno)
        raise
    finally:
        with contextlib.suppress(OSError):  # what went wrong before is what is told
            temporary.unlink()


@contextlib.contextmanager
def table_writer(path: Path, schema: pa.Schema) -> Generator[Callable[[pa.Table], None]]:
    """Give what adds a row group to a Parquet table, which is put in its place at the end."""
    with replacing(path) as temporary, pq.ParquetWriter(temporary, schema, compression="zstd") as writer:
        yield lambda rows: writer.write_table(rows, row_group_size=len(rows))


def read_row_groups(path: Path, columns: Sequence[str]) -> Iterator[pa.Table]:
    """Read columns of a finished table, a row group at a time, which holds all rows of its cells."""
    with pq.ParquetFile(path) as file:
        for group in range(file.num_row_groups):
            yield file.read_row_group(group, columns=list(columns))


def rows_at(path: Path, places: Sequence[int]) -> pa.Table:
    """Read rows by their numbers, a row group at a time: a data set would hold the whole table."""
    with pq.ParquetFile(path) as file:
        lengths = (file.metadata.row_group(group).num_rows for group in range(file.num_row_groups))
        starts, rows = [0, *itertools.accumulate(lengths)], [file.schema_arrow.empty_table()]
        for place in places:
            group = bisect.bisect_right(starts, place) - 1
            rows.append(file.read_row_group(group).take([place - starts[group]]))
        return pa.concat_tables(rows)


def read_selected(path: Path, columns: Sequence[str], keep: pc.Expression | None = None) -> pa.Table:
    """Read columns of the rows for which a condition holds; text as dictionaries, which take a byte or two a row."""
    # not those of the condition alone: before pyarrow 26, none of a dictionary without entries is null
    text = [f.name for f in pq.read_schema(path) if pa.types.is_string(f.type) and f.name in columns]
    return pq.read_table(path, columns=list(columns), filters=keep, read_dictionary=text).unify_dictionaries()


def read_column(path: Path, name: str) -> np.ndarray:
    """Read one column whole: text as objects; numbers or truths as float64, nulls as NaN."""
    found = read_selected(path, [name])[name]
    if pa.types.is_dictionary(found.type):
        return found.to_pandas().to_numpy(dtype=object)
    return found.cast(pa.float64()).to_numpy()


def read_where_present(path: Path, name: str) -> np.ndarray:
    """Read where one column is not null."""
    return read_selected(path, [name])[name].is_valid().to_numpy()


def read_codes(path: Path, name: str, values: Sequence[str]) -> np.ndarray:
    """Read one column of text as the position of each entry among some values; -1 where it is none of them."""
    known = read_selected(path, [name])[name].combine_chunks().dictionary_encode()
    place = {value: i for i, value in enumerate(values)}
    places = [place.get(text, -1) for text in known.dictionary.to_pylist()]
    return np.array([*places, -1], np.int8)[known.indices.fill_null(-1)]
