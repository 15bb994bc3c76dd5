"""Runs: independence of workers, resumption, and solvers that fail."""

import itertools
import math

import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.layout import layout_of
from impact_xval.experiments.sweep.run import run_sweep, van_der_corput
from impact_xval.experiments.tables.schema import MEASURES, expanded
from tests.experiments import fakes
from tests.experiments.conftest import SMALL, resumed, tables_of


def test_the_tables_are_long_and_tidy(fake_run):
    cells, divergence = (pq.read_table(fake_run.root / f"{name}.parquet") for name in ("cells", "divergence"))
    tables = layout_of(fake_run.config()).tables
    assert cells.schema.equals(tables["cells"].schema)
    assert divergence.schema.equals(tables["divergence"].schema)
    assert cells.schema.field("v1").metadata[b"unit"] == b"m/s"
    assert cells["cell"].to_pylist() == [i for i in range(12) for _ in range(3)]
    assert cells["solver"].to_pylist() == ["state-transition", "mujoco", "pybullet"] * 12
    assert divergence.num_rows == len((fake_run.root / "divergence.csv").read_text().splitlines()) - 1 == 24
    row, absent = divergence.to_pylist()[:2]
    assert (row["solver"], row["states_equal"], row["curve_distance"]) == ("mujoco", True, 0)
    assert row["velocity_divergence"] == pytest.approx(0.01)
    missing = "no wheel for this Python; use Python 3.11"
    assert (absent["status"], absent["reason"]) == ("unavailable", missing)
    assert all(absent[measure] is None for measure in expanded(MEASURES, 2, 2))


def test_n_balls_each_faster_by_a_hundredth_are_sqrt_n_hundredths_away(tmp_path):
    column = {"arrangement": ["cradle", "drop"], "balls": [3, 4], "e": [0.7, 0.9], "stiffness_taper": 1.0}
    config = parse_config({"solvers": ["mujoco"], "chunk_size": 3, "column": column})
    run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    for name, schema in ((name, table.schema) for name, table in layout_of(config).tables.items()):
        assert pq.read_schema(tmp_path / f"a/{name}.parquet").equals(schema)
    divergence = pq.read_table(tmp_path / "a/divergence.parquet")
    expected = [0.01 * math.sqrt(n) for n in (3, 3, 4, 4)] * 2
    assert divergence["velocity_divergence"].to_pylist() == pytest.approx(expected)
    assert divergence["largest_dv"].to_pylist() == pytest.approx([0.01] * 8)


def test_chunks_done_so_far_lie_all_over_the_grid():
    """None is done twice, and no gap between those done is twice as wide as if they lay evenly."""
    for count in (0, 1, 2, 3, 39, 97, 1025):
        order = list(van_der_corput(count))
        assert sorted(order) == list(range(count))
        for done in range(1, count + 1):
            edges = [0, *sorted(order[:done]), count]
            assert max(b - a for a, b in itertools.pairwise(edges)) * done <= 2 * count, (count, done)


@pytest.mark.parametrize("harm", ["truncate", "alter", "delete"])
def test_a_damaged_part_is_computed_again_and_said_so(run, fake_run, harm):
    part = sorted((run / "parts").glob("0*"))[1]
    data = part.read_bytes()
    if harm == "delete":
        part.unlink()
    else:
        part.write_bytes(data[:-7] if harm == "truncate" else data[:50] + bytes([data[50] ^ 1]) + data[51:])
    (run / "cells.parquet").write_bytes(b"x")
    said = resumed(run)
    assert any("resumed: 2 of 3 parts" in line for line in said)
    assert ("part 1 is damaged: computed again" in said) == (harm != "delete")
    assert tables_of(run) == tables_of(fake_run.root)


def test_parts_of_another_version_are_left_alone(run, monkeypatch):
    monkeypatch.setattr(fakes.Shifted, "version", lambda self: "shifted 2")
    before = sorted((run / "parts").iterdir())
    assert any("resumed: 0 of 3 parts" in line for line in resumed(run))
    assert set(before) < set((run / "parts").iterdir())


@pytest.mark.slow
def test_the_number_of_workers_changes_no_byte(tmp_path):
    config = parse_config(SMALL | {"chunk_size": 2, "scenario": "drop", "step_fraction": 0.01})
    for workers in (1, 2):
        run_sweep(config, tmp_path / str(workers), workers=workers)
    assert tables_of(tmp_path / "1") == tables_of(tmp_path / "2")
