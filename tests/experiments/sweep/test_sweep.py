"""Runs: independence of workers, resumption, and solvers that fail."""

import itertools
import math
import multiprocessing

import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.layout import layout_of
from impact_xval.experiments.sweep.run import run_sweep, van_der_corput
from impact_xval.experiments.tables.schema import MEASURES, expanded
from tests.experiments import fakes
from tests.experiments.conftest import SMALL, resumed, tables_of


def _solved(root, name="mujoco", table="cells"):
    return [row for row in pq.read_table(root / f"{table}.parquet").to_pylist() if row["solver"] == name]


def test_the_tables_are_long_and_tidy(fake_run):
    cells = pq.read_table(fake_run.root / "cells.parquet")
    tables = layout_of(fake_run.config()).tables
    assert cells.schema.equals(tables["cells"].schema)
    assert cells.schema.field("v1").metadata[b"unit"] == b"m/s"
    rows = cells.to_pylist()
    assert [row["cell"] for row in rows] == [i for i in range(12) for _ in range(3)]
    assert [row["solver"] for row in rows[:3]] == ["state-transition", "mujoco", "pybullet"]
    assert rows[1]["v1"] == pytest.approx(rows[0]["v1"] + 0.01)
    divergence = pq.read_table(fake_run.root / "divergence.parquet")
    assert divergence.schema.equals(tables["divergence"].schema)
    assert divergence.num_rows == len((fake_run.root / "divergence.csv").read_text().splitlines()) - 1 == 24
    row = divergence.to_pylist()[0]
    assert (row["solver"], row["states_equal"], row["curve_distance"]) == ("mujoco", True, 0)
    assert row["velocity_divergence"] == pytest.approx(0.01)


def test_an_unavailable_solver_is_rows_with_its_reason(fake_run):
    rows = _solved(fake_run.root, "pybullet", "divergence")
    assert {(row["status"], row["reason"]) for row in rows} == {
        ("unavailable", "no wheel for this Python; use Python 3.11")
    }
    assert all(row[measure] is None for row in rows for measure in expanded(MEASURES, 2, 2))


def test_chunks_done_so_far_lie_all_over_the_grid():
    """None is done twice, and no gap between those done is twice as wide as if they lay evenly."""
    for count in (0, 1, 2, 3, 39, 97, 1025):
        order = list(van_der_corput(count))
        assert sorted(order) == list(range(count))
        for done in range(1, count + 1):
            edges = [0, *sorted(order[:done]), count]
            assert max(b - a for a, b in itertools.pairwise(edges)) * done <= 2 * count, (count, done)


def test_a_crash_costs_only_its_cells(crashing_run):
    rows = _solved(crashing_run.root)
    assert {(row["e1"], row["status"]) for row in rows} == {(0.5, "crashed"), (0.9, "ok")}
    crashed = next(row for row in rows if row["status"] == "crashed")
    assert crashed["reason"] == "ZeroDivisionError: a bug of the engine | here"
    assert crashed["v1"] is None


@pytest.mark.parametrize("stiffness_ratio", [0, math.inf])
def test_limits_are_rows_not_errors(tmp_path, stiffness_ratio):
    grid = {"stiffness_ratio": [stiffness_ratio], "e1": [0, 1]}
    run_sweep(parse_config(SMALL | {"solvers": ["mujoco"], "grid": grid}), tmp_path / "a", isolate=False)
    assert {row["status"] for row in _solved(tmp_path / "a", "state-transition")} == {"limit"}
    refused = _solved(tmp_path / "a")
    assert {row["status"] for row in refused} == {"unrepresentable"}
    assert all(row["reason"] for row in refused)


def test_a_run_that_was_interrupted_goes_on_to_the_same_bytes(small, tmp_path, fake_run):
    with pytest.raises(InterruptedRunError):
        run_sweep(small, tmp_path / "cut", isolate=False, resolve=fakes.interrupting)
    assert len(list((tmp_path / "cut/parts").glob("0*"))) == 2
    assert not (tmp_path / "cut/cells.parquet").exists()
    assert any("resumed: 2 of 3 parts" in line for line in resumed(small, tmp_path / "cut"))
    assert tables_of(tmp_path / "cut") == tables_of(fake_run.root)


@pytest.mark.parametrize("harm", ["truncate", "alter", "delete"])
def test_a_damaged_part_is_computed_again_and_said_so(small, run, fake_run, harm):
    part = sorted((run / "parts").glob("0*"))[1]
    data = part.read_bytes()
    if harm == "delete":
        part.unlink()
    else:
        part.write_bytes(data[:-7] if harm == "truncate" else data[:50] + bytes([data[50] ^ 1]) + data[51:])
    (run / "cells.parquet").write_bytes(b"x")
    said = resumed(small, run)
    assert any("resumed: 2 of 3 parts" in line for line in said)
    assert ("part 1 is damaged: computed again" in said) == (harm != "delete")
    assert tables_of(run) == tables_of(fake_run.root)


def test_parts_of_another_version_are_left_alone(small, run, monkeypatch):
    monkeypatch.setattr(fakes.Shifted, "version", lambda self: "shifted 2")
    before = sorted((run / "parts").iterdir())
    assert any("resumed: 0 of 3 parts" in line for line in resumed(small, run))
    assert set(before) < set((run / "parts").iterdir())


@pytest.mark.slow
def test_the_number_of_workers_changes_no_byte(tmp_path):
    config = parse_config(SMALL | {"chunk_size": 2, "scenario": "drop", "step_fraction": 0.01})
    for workers in (1, 2):
        run_sweep(config, tmp_path / str(workers), workers=workers)
    assert tables_of(tmp_path / "1") == tables_of(tmp_path / "2")
    assert not multiprocessing.active_children()
