"""The tables of a run of version 0.4, under the names that their columns and values have now.

`folder.run_folder` has them made for the folder of such a run, whose own tables are never changed: the renamed tables
lie in a temporary folder, which is removed when the process ends.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from impact_xval.experiments.config.renamed import ARRANGEMENTS, COLUMNS, STATUSES
from impact_xval.experiments.tables.parquet import table_writer

#: The format of the folders that version 0.4 wrote.
EARLIER_FORMAT = "impact-xval run, format 3"

#: Values that were renamed, by the columns in which they stand.
_VALUES = {"status": STATUSES, "model_status": STATUSES, "arrangement": ARRANGEMENTS}


def renamed_tables(root: Path) -> Path:
    """Write the tables of a run of 0.4 under today's names into a new temporary folder, and return it.

    Tables that are damaged are left out: whoever reads them says that they are missing.
    """
    folder = Path(tempfile.mkdtemp(prefix="impact-xval-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for path in sorted(root.glob("*.parquet")):
        try:
            _copy_renamed(path, folder / path.name)
        except pa.ArrowException:
            continue
    return folder


def _copy_renamed(old: Path, new: Path) -> None:
    """Copy a table, a row group at a time, with its columns and values renamed."""
    with pq.ParquetFile(old) as file:
        schema = rename(file.schema_arrow.empty_table()).schema
        with table_writer(new, schema) as add:
            for group in range(file.num_row_groups):
                add(rename(file.read_row_group(group)).cast(schema))


def rename(table: pa.Table) -> pa.Table:
    """Rename the columns of a table of 0.4, and the values of its columns of text."""
    for name, values in _VALUES.items():
        if name in table.column_names:
            place = table.schema.get_field_index(name)
            texts = [values.get(text, text) for text in table[name].to_pylist()]
            table = table.set_column(place, table.schema.field(place), pa.array(texts, pa.string()))
    return table.rename_columns([COLUMNS.get(name, name) for name in table.column_names])
