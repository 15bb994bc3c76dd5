"""Writing and reading of Parquet tables that may be larger than the memory.

Tables are written and read in row groups. If a row group holds one row of a cell, it holds all rows of this cell. A
file appears under its final name only when it is complete. Pages of tables have checksums, which are verified when the
pages are read. Without them, a flipped bit could be read as another number.

Arrow is used instead of polars (2.1) and DuckDB (2.0) for two reasons. First, polars and DuckDB lose the units in the
metadata of columns, and the type of text columns. Second, their means differ from the means of pandas in the last bits.
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

from impact_xval.experiments.config.errors import UserError

#: Least number of rows in a row group of a finished table. The last group of a table may be smaller.
GROUP = 65_536


@contextlib.contextmanager
def replacing(path: Path, *, sync: bool = True) -> Generator[Path]:
    """Yield a temporary path in the folder of `path`; rename its file to `path` if the block ends without an error.

    With `sync` the content is forced to the disk before the file is renamed. Otherwise a power cut could leave a file
    under the final name without its content.
    """
    temporary = path.with_name(f".tmp-{os.getpid()}-{path.name}")
    try:
        yield temporary
        if sync:
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        # The error that the user sees should name `path`. The error for a full disk names no file. Other errors name
        # the temporary file, and Arrow puts the name of the temporary file into the message.
        if error.filename is None or str(error.filename) == str(temporary):
            error.filename, error.filename2 = str(path), None
        if error.errno is not None and temporary.name in str(error.strerror):
            error.strerror = os.strerror(error.errno)
        raise
    finally:
        with contextlib.suppress(OSError):  # an earlier error is more useful to the user than this error
            temporary.unlink()


@contextlib.contextmanager
def table_writer(path: Path, schema: pa.Schema) -> Generator[Callable[[pa.Table], None]]:
    """Yield a function that appends a table of rows, as one row group, to a new Parquet file.

    The file appears as `path` when the block ends without an error.
    """
    with (
        replacing(path) as temporary,
        pq.ParquetWriter(temporary, schema, compression="zstd", write_page_checksum=True) as writer,
    ):
        yield lambda rows: writer.write_table(rows, row_group_size=len(rows))


@contextlib.contextmanager
def refuse_damaged(path: Path) -> Generator[None]:
    """Turn an error of Arrow about a finished table of a run, in the `with` block, into a `UserError`."""
    try:
        yield
    except (OSError, pa.ArrowException):
        raise UserError(
            f"{path}: missing or damaged; the command that began the run writes it again"
        ) from None


def read_table(
    path: Path,
    columns: Sequence[str] | None = None,
    filters: object = None,
    read_dictionary: Sequence[str] | None = None,
) -> pa.Table:
    """Return a finished table; the arguments are those of `pyarrow.parquet.read_table`.

    A `UserError` names a file that is missing or damaged.
    """
    with refuse_damaged(path):
        return pq.read_table(
            path,
            columns=columns and list(columns),
            filters=filters,
            read_dictionary=read_dictionary and list(read_dictionary),
            page_checksum_verification=True,
        )


def read_row_groups(path: Path, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
    """Yield some columns of a finished table, or all of them, one row group at a time.

    If a row group holds one row of a cell, it holds all rows of this cell. A `UserError` names a damaged file.
    """
    with refuse_damaged(path), pq.ParquetFile(path, page_checksum_verification=True) as file:
        for group in range(file.num_row_groups):
            yield file.read_row_group(group, columns=columns and list(columns))


def rows_at(path: Path, places: Sequence[int]) -> pa.Table:
    """Return the rows at some positions of a table, in the order of `places`.

    Only one row group is in memory at a time, whereas a pyarrow data set would load the whole table.
    """
    with refuse_damaged(path), pq.ParquetFile(path, page_checksum_verification=True) as file:
        lengths = (file.metadata.row_group(group).num_rows for group in range(file.num_row_groups))
        starts, rows = [0, *itertools.accumulate(lengths)], [file.schema_arrow.empty_table()]
        for place in places:
            group = bisect.bisect_right(starts, place) - 1
            rows.append(file.read_row_group(group).take([place - starts[group]]))
        return pa.concat_tables(rows)


def read_selected(path: Path, columns: Sequence[str], keep: pc.Expression | None = None) -> pa.Table:
    """Read some columns of the rows that fulfil the condition `keep`.

    Text columns are read as Arrow dictionaries, which need only one or two bytes per row.
    """
    # Text columns that only the condition uses are not read as dictionaries. The reason is an error of pyarrow before
    # version 26: if a dictionary has no entries, none of its elements counts as null.
    text = [f.name for f in pq.read_schema(path) if pa.types.is_string(f.type) and f.name in columns]
    return read_table(path, columns, keep, text).unify_dictionaries()


def read_column(path: Path, name: str) -> np.ndarray:
    """Return one column of a table as an array: objects for text, float64 for numbers and bools, with NaN for nulls."""
    found = read_selected(path, [name])[name]
    if pa.types.is_dictionary(found.type):
        return found.to_pandas().to_numpy(dtype=object)
    return found.cast(pa.float64()).to_numpy()


def read_where_present(path: Path, name: str) -> np.ndarray:
    """Return for each row of a table whether the column `name` is not null."""
    return read_selected(path, [name])[name].is_valid().to_numpy()


def read_codes(path: Path, name: str, values: Sequence[str]) -> np.ndarray:
    """Return, for each row, the index in `values` of the text in the column `name`; -1 if the text is not there."""
    known = read_selected(path, [name])[name].combine_chunks().dictionary_encode()
    place = {value: i for i, value in enumerate(values)}
    places = [place.get(text, -1) for text in known.dictionary.to_pylist()]
    return np.array([*places, -1], np.int8)[known.indices.fill_null(-1)]
