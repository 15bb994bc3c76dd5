"""Tables are written whole or not at all, and a cell is never split between row groups."""

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.tables import folder
from impact_xval.experiments.tables.parquet import read_row_groups, read_selected, rows_at, table_writer
from tests.experiments.conftest import resumed

pytestmark = pytest.mark.smoke

SCHEMA = pa.schema([("cell", pa.int64()), ("solver", pa.string()), ("v", pa.float64())])


def _table(n_cells):
    cells = np.repeat(np.arange(n_cells), 3)
    return pa.table(
        {"cell": cells, "solver": ["a", "b", "c"] * n_cells, "v": np.sqrt(cells) + np.arange(len(cells))},
        SCHEMA,
    )


def _write(path, table):
    with table_writer(path, SCHEMA) as add:
        add(table)
    return path.read_bytes()


def test_an_error_leaves_what_was_there(tmp_path):
    before = _write(tmp_path / "a", _table(3))
    writer = table_writer(tmp_path / "a", SCHEMA)
    writer.__enter__()(_table(2))
    assert not writer.__exit__(ValueError, ValueError("no"), None)
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a", before)]


def test_tables_are_the_same_in_row_groups_of_whole_cells(tmp_path, monkeypatch, fake_run):
    monkeypatch.setattr(folder, "GROUP", 20)
    resumed(tmp_path / "a")
    for name, rows in (
        ("cells.parquet", [24, 12]),
        ("divergence.parquet", [16, 8]),
        ("ladder.parquet", [16, 8]),
    ):
        read = list(read_row_groups(tmp_path / "a" / name, ["cell", "solver"]))
        assert list(map(len, read)) == rows
        assert set(read[0]["cell"].to_pylist()) == set(range(8))
        whole = pq.read_table(fake_run.root / name)
        assert pq.read_table(tmp_path / "a" / name).equals(whole)
        assert rows_at(tmp_path / "a" / name, [1, 17, 16, 23]).equals(whole.take([1, 17, 16, 23]))
    assert (tmp_path / "a/ladder.csv").read_bytes() == (fake_run.root / "ladder.csv").read_bytes()


def test_rows_without_an_entry_are_found_in_a_column_of_none(tmp_path):
    marks = pa.array([None, None, "kink"], pa.string()), pa.array([None] * 3, pa.string())
    for mark, n in zip(marks, (2, 3), strict=True):
        pq.write_table(pa.table({"solver": ["a"] * 3, "marked": mark}), tmp_path / "a")
        assert len(read_selected(tmp_path / "a", ["solver"], pc.field("marked").is_null())) == n
