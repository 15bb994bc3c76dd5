"""Tables are written whole or not at all, and do not depend on the pieces they come in."""

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.tables import parquet
from impact_xval.experiments.tables.parquet import blocks, selected, table_writer

pytestmark = pytest.mark.smoke

SCHEMA = pa.schema([("cell", pa.int64()), ("solver", pa.string()), ("v", pa.float64())])


def _table(n_cells):
    cells = np.repeat(np.arange(n_cells), 3)
    return pa.table(
        {"cell": cells, "solver": ["a", "b", "c"] * n_cells, "v": np.sqrt(cells) + np.arange(len(cells))},
        SCHEMA,
    )


def _write(path, table, pieces):
    with table_writer(path, SCHEMA) as add:
        start = 0
        for size in pieces:
            add(table.slice(start, size))
            start += size
        add(table.slice(start))
    return path.read_bytes()


def test_a_file_does_not_depend_on_the_pieces(tmp_path, monkeypatch):
    monkeypatch.setattr(parquet, "GROUP", 100)
    table = _table(333)
    whole = _write(tmp_path / "a", table, [])
    rng = np.random.default_rng(0)
    for _ in range(5):
        assert _write(tmp_path / "b", table, rng.integers(0, 260, 12).tolist()) == whole
    assert pq.read_table(tmp_path / "a").equals(table)
    assert pq.ParquetFile(tmp_path / "a").metadata.row_group(0).num_rows == 100


def test_an_error_leaves_what_was_there(tmp_path):
    before = _write(tmp_path / "a", _table(3), [])
    writer = table_writer(tmp_path / "a", SCHEMA)
    writer.__enter__()(_table(2))
    assert not writer.__exit__(ValueError, ValueError("no"), None)
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a", before)]


def test_blocks_hold_whole_cells(tmp_path, monkeypatch):
    _write(tmp_path / "a", _table(333), [])
    monkeypatch.setattr(parquet, "GROUP", 100)
    read = list(blocks(tmp_path / "a", ["cell", "v"]))
    assert pa.concat_tables(read).equals(_table(333).select(["cell", "v"]))
    assert len(read) > 3
    assert all(len(block) % 3 == 0 for block in read)


def test_rows_without_an_entry_are_found_in_a_column_of_none(tmp_path):
    marks = pa.array([None, None, "kink"], pa.string()), pa.array([None] * 3, pa.string())
    for mark, n in zip(marks, (2, 3), strict=True):
        pq.write_table(pa.table({"solver": ["a"] * 3, "marked": mark}), tmp_path / "a")
        assert len(selected(tmp_path / "a", ["solver"], pc.field("marked").is_null())) == n
