"""Tables in blocks: whole cells, nothing lost, and files that do not depend on the blocks."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables import streams
from impact_xval.experiments.tables.streams import (
    blocks,
    derive,
    table_writer,
)
from tests.experiments import fakes
from tests.experiments.conftest import SMALL

pytestmark = pytest.mark.smoke

SCHEMA = pa.schema([("cell", pa.int64()), ("solver", pa.string()), ("v", pa.float64())])


def _table(n_cells, n_solvers=3):
    cells = np.repeat(np.arange(n_cells), n_solvers)
    names = ["a", "b", "c"][:n_solvers] * n_cells
    return pa.table({"cell": cells, "solver": names, "v": np.sqrt(cells) + np.arange(len(cells))}, SCHEMA)


@pytest.fixture
def tiny_groups(monkeypatch):
    monkeypatch.setattr(streams, "GROUP", 100)


def _write(path, table, pieces):
    with table_writer(path, SCHEMA) as writer:
        start = 0
        for size in pieces:
            writer.add(table.slice(start, size))
            start += size
        writer.add(table.slice(start))
    return path.read_bytes()


def test_a_file_does_not_depend_on_the_pieces(tmp_path, tiny_groups):
    table = _table(333)
    whole = _write(tmp_path / "a", table, [])
    rng = np.random.default_rng(0)
    for _ in range(5):
        assert _write(tmp_path / "b", table, rng.integers(0, 260, 12).tolist()) == whole
    assert pq.read_table(tmp_path / "a").equals(table)
    assert pq.ParquetFile(tmp_path / "a").metadata.row_group(0).num_rows == 100


def test_blocks_hold_whole_cells_and_every_row_once(tmp_path, tiny_groups):
    table = _table(333)
    _write(tmp_path / "a", table, [])
    found = list(blocks(tmp_path / "a", ["cell", "v"]))
    assert len(found) > 5
    assert pa.concat_tables(found).equals(table.select(["cell", "v"]))
    seen = [set(block.column("cell").to_pylist()) for block in found]
    assert sum(map(len, seen)) == 333
    one = _table(1)
    _write(tmp_path / "one", one, [])
    assert [len(block) for block in blocks(tmp_path / "one")] == [3]
    _write(tmp_path / "none", one.slice(0, 0), [])
    assert not list(blocks(tmp_path / "none"))


def test_an_error_leaves_what_was_there(tmp_path):
    _write(tmp_path / "a", _table(3), [])
    before = (tmp_path / "a").read_bytes()

    def fail(block):
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        derive(tmp_path / "a", tmp_path / "a", SCHEMA, fail)
    assert (tmp_path / "a").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_summary_does_not_depend_on_the_blocks(tmp_path, monkeypatch):
    config = parse_config(SMALL | {"grazing_threshold": 0.05})
    folder = run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.crashing)
    whole = summarise(folder)
    monkeypatch.setattr(streams, "GROUP", 5)
    cut = summarise(folder)
    for name in ("statistics", "worst", "statuses", "reasons", "between"):
        assert getattr(cut, name).equals(getattr(whole, name)), name
    assert (cut.n_cells, cut.n_marked) == (whole.n_cells, whole.n_marked)
