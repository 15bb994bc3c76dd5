"""Runs: tables do not depend on the workers, runs can be resumed, and damaged parts are computed again."""

import itertools

import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.layout import layout_of
from impact_xval.experiments.sweep.run import run_sweep, van_der_corput
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.schema import MEASURES, Counts, expand_columns, names_of
from tests.experiments import fakes
from tests.experiments.conftest import SMALL, resumed, tables_of


def test_the_tables_are_long_and_tidy(fake_run, chain_run):
    for run in (fake_run, RunFolder(chain_run)):
        for name, table in layout_of(run.config()).tables.items():
            assert pq.read_schema(run.root / f"{name}.parquet").equals(table.schema)
    cells, divergence = (pq.read_table(fake_run.root / f"{name}.parquet") for name in ("cells", "divergence"))
    assert cells.schema.field("v1").metadata[b"unit"] == b"m/s"
    assert cells["cell"].to_pylist() == [i for i in range(12) for _ in range(3)]
    assert cells["solver"].to_pylist() == ["state-transition", "mujoco", "pybullet"] * 12
    assert divergence.num_rows == len((fake_run.root / "divergence.csv").read_text().splitlines()) - 1 == 24
    row, absent = divergence.to_pylist()[:2]
    assert (row["solver"], row["states_equal"], row["impulse_curve_distance"]) == ("mujoco", True, 0)
    assert row["velocity_divergence"] == pytest.approx(0.01)
    missing = "no wheel for this Python; use Python 3.11"
    assert (absent["status"], absent["reason"]) == ("unavailable", missing)
    assert all(absent[measure] is None for measure in names_of(expand_columns(MEASURES, Counts(2, 2))))


def test_chunks_done_so_far_lie_all_over_the_grid():
    """At any time the finished chunks of cells are spread over the grid, and no chunk is done twice.

    No gap between finished chunks is more than twice as wide as if they were spread evenly.
    """
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
    assert ("part 1 is damaged and will be computed again" in said) == (harm != "delete")
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
