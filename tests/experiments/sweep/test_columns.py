"""Runs of columns: rows, refusals, resumption, and what is known of them by other ways."""

import math

import numpy as np
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.layout import layout_of
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.schema import MEASURES
from tests.experiments import fakes

pytestmark = pytest.mark.usefixtures("kernels")

EXACT = ["state-transition", "bistiffness", "kelvin-voigt", "hunt-crossley"]


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


def test_two_balls_that_drop_are_those_of_the_grid(tmp_path):
    """D and final velocities by the existing path, over tapers and restitutions."""
    e, ratios, masses = [0.5, 0.9, 1.0], [0.3, 1.0, 7.0], [0.5, 2.0]
    grid = {"stiffness_ratio": ratios, "mass_ratio": masses, "e1": e, "e2": e}
    column = {"arrangement": "drop", "balls": 2, "e": e, "stiffness_taper": ratios, "mass_taper": masses}
    for name, cells in (("grid", {"grid": grid, "scenario": "impact"}), ("column", {"column": column})):
        run_sweep(parse_config({"solvers": EXACT} | cells), tmp_path / name, isolate=False)

    def by_cell(root, table, *axes):
        return {(row["solver"], *(row[axis] for axis in axes)): row for row in _rows(tmp_path / root, table)}

    for table, rows in (("cells", 18 * 4), ("divergence", 18 * 3)):
        columns = by_cell("column", table, "stiffness_taper", "mass_taper", "e", "e")
        two_balls = by_cell("grid", table, "stiffness_ratio", "mass_ratio", "e1", "e2")
        assert len(columns) == rows
        for key, row in columns.items():
            other = two_balls[key]
            assert row["status"] == other["status"]
            if table == "cells":
                assert _velocities(row) == pytest.approx([other["v1"], other["v2"]], abs=1e-12)
            else:
                for measure in ("velocity_divergence", "dretained_energy"):
                    assert row[measure] == pytest.approx(other[measure], abs=1e-12)


def test_contacts_each_much_softer_than_the_last_are_single_impacts_one_after_the_other(tmp_path):
    """Of each the closed form: v_i' = v_i (m_i - e m_(i+1))/(m_i + m_(i+1)), v_(i+1)' = v_i (1 + e) m_i/(same).

    The rest goes as taper under the model, and as the ratio of durations, sqrt(taper), of dashpots, whose force jumps.
    """
    axes = {"arrangement": "chain", "balls": 4, "e": 0.8, "mass_taper": 0.5}
    errors = []
    for taper in (1e-4, 1e-6):
        config = parse_config({"solvers": ["kelvin-voigt"], "column": axes | {"stiffness_taper": taper}})
        root = tmp_path / str(taper)
        run_sweep(config, root, isolate=False)
        expected, speed = [], -1.0
        for _ in range(3):
            expected.append(speed * (1 - 0.8 * 0.5) / 1.5)
            speed *= 1.8 / 1.5
        for row in _rows(root):
            errors.append(np.abs(np.subtract(_velocities(row), [*expected, speed])).max())
            assert row["retained_momentum"] == pytest.approx(1, abs=1e-12)
    assert max(errors[2:]) < 3e-3
    assert np.divide(errors[:2], errors[2:]) == pytest.approx([100, 10], rel=0.05)
