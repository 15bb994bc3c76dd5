"""Runs of columns: rows, refusals, resumption, and what is known of them by other ways."""

import math

import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.layout import layout_of
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.schema import MEASURES
from tests.experiments import fakes


def _config(solvers=("mujoco", "pybullet"), **axes):
    small = {"arrangement": ["cradle", "drop"], "balls": [2, 3], "e": [0.7, 0.9], "stiffness_taper": 1.0}
    return parse_config(
        {"name": "columns", "solvers": list(solvers), "chunk_size": 3, "column": small | axes}
    )


def _rows(root, name="cells"):
    return pq.read_table(root / f"{name}.parquet").to_pylist()


def _velocities(row):
    return [row[f"v{i}"] for i in range(1, row["balls"] + 1) if row[f"v{i}"] is not None]


def test_n_balls_each_faster_by_a_hundredth_are_sqrt_n_hundredths_away(tmp_path):
    config = _config(["mujoco"])
    run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.columns)
    cells, divergence = (pq.read_table(tmp_path / f"a/{name}.parquet") for name in ("cells", "divergence"))
    tables = layout_of(config).tables
    assert cells.schema.equals(tables["cells"].schema)
    assert divergence.schema.equals(tables["divergence"].schema)
    rows = cells.to_pylist()
    assert _velocities(rows[1]) == pytest.approx([v + 0.01 for v in _velocities(rows[0])])
    expected = [0.01 * math.sqrt(n) for n in (2, 2, 3, 3)] * 2
    assert divergence["velocity_divergence"].to_pylist() == pytest.approx(expected)
    assert divergence["largest_dv"].to_pylist() == pytest.approx([0.01] * 8)


def test_what_a_solver_cannot_represent_is_rows_with_the_reason(tmp_path):
    config = _config(["kelvin-voigt", "mujoco"], balls=3, exponent=[1.0, 1.5], gap=[0.0, 1e-4], e=[0.0, 0.9])
    run_sweep(config, tmp_path / "a", isolate=False)
    rows = _rows(tmp_path / "a")
    assert len(rows) == 2 * 2 * 2 * 2 * 3
    for row in rows:
        refused, reason = {
            "state-transition": (row["gap"] > 0, "gaps"),
            "kelvin-voigt": (row["e"] == 0, "a restitution is 0"),
            "mujoco": (row["e"] == 0 or row["exponent"] != 1, ("e1 = 0", "exponent")),
        }[row["solver"]]
        assert (row["status"] == "unrepresentable") == refused, row
        if refused:
            assert _velocities(row) == []
            assert row["reason"].startswith(reason)
    for row in _rows(tmp_path / "a", "divergence"):
        if row["status"] != "ok" or row["gap"]:
            assert not [name for name in MEASURES if row.get(name) is not None]
