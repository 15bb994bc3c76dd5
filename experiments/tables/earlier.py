"""Tables of a run that version 0.4 wrote, with the columns and values renamed to the names of today.

`folder.run_folder` calls this module for a folder that version 0.4 wrote. The tables in this folder are never changed.
The renamed tables lie in a temporary folder, which is removed when the process ends.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.renamed import ARRANGEMENTS, COLUMNS, STATUSES
from impact_xval.experiments.tables.parquet import read_row_groups, refuse_damaged, table_writer

#: Name of the format of run folders that version 0.4 wrote. It stands in the manifest of such a folder.
EARLIER_FORMAT = "impact-xval run, format 3"

#: Values that were renamed after version 0.4. For each column with such values, the new value by the old value.
_VALUES = {"status": STATUSES, "model_status": STATUSES, "arrangement": ARRANGEMENTS}


def renamed_tables(root: Path) -> Path:
    """Copy the tables of a run of version 0.4, with today's names, into a new temporary folder; return this folder.

    Damaged tables are not copied. If a damaged table is read later, an error says that it is missing.
    """
    folder = Path(tempfile.mkdtemp(prefix="impact-xval-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for path in sorted(root.glob("*.parquet")):
        try:
            _copy_renamed(path, folder / path.name)
        except UserError:
            continue
    return folder


def _copy_renamed(old: Path, new: Path) -> None:
    """Copy a table with its columns and values renamed. Only one group of rows is in memory at a time."""
    with refuse_damaged(old):
        schema = rename(pq.read_schema(old).empty_table()).schema
    with table_writer(new, schema) as add:
        for group in read_row_groups(old):
            add(rename(group).cast(schema))


def rename(table: pa.Table) -> pa.Table:
    """Return a table of version 0.4 with its columns, and the values in its text columns, renamed to today's names."""
    for name, values in _VALUES.items():
        if name in table.column_names:
            place = table.schema.get_field_index(name)
            texts = [values.get(text, text) for text in table[name].to_pylist()]
            table = table.set_column(place, table.schema.field(place), pa.array(texts, pa.string()))
    return table.rename_columns([COLUMNS.get(name, name) for name in table.column_names])
