"""The limit dt -> 0 in the tables of a run."""

import math

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.layout import layout_of
from impact_xval.experiments.measures.summary import convergence_estimates, summarise
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.schema import CERTIFICATE as OF_LIMITS
from impact_xval.experiments.tables.schema import expanded
from tests.experiments.conftest import SMALL

CERTIFICATE = expanded(OF_LIMITS, 2, 2)


def run(tmp_path, **changes):
    data = {**SMALL, "solvers": ["kelvin-voigt", "mujoco"], **changes}
    folder = run_sweep(parse_config(data), tmp_path / "r", isolate=False)
    rows = pq.read_table(tmp_path / "r/cells.parquet").to_pylist()
    return folder, [row for row in rows if row["solver"] == "mujoco"]


def test_both_results_are_kept(engine_run):
    rows = pq.read_table(engine_run / "cells.parquet").to_pylist()
    asked = {row["cell"]: row for row in rows if row["solver"] == "kelvin-voigt"}
    for row in rows:
        if row["solver"] != "mujoco":
            assert all(row[name] is None for name in CERTIFICATE)
            continue
        assert row["status"] == "ok"
        for ball in ("v1", "v2"):  # per |v0|, while v1 and v2 are in m/s
            true = asked[row["cell"]][ball] / 2
            assert abs(row[f"{ball}_limit"] - true) <= 3 * row["limit_error"]
            assert row[ball] / 2 == pytest.approx(row[f"{ball}_limit"], abs=3e-3)
        assert 0 < row["regularisation"] <= row["limit_error"] < 1e-3
        assert row["finest_step"] <= row["step"]
    table = summarise(RunFolder(engine_run)).estimates
    assert table.solver.tolist() == ["mujoco"]
    assert table.n.tolist() == table.converged.tolist() == [12]
    assert table.honest.tolist() == [1.0]
    assert table.step_max[0] < 3e-3


def test_estimates_can_be_left_out(tmp_path):
    folder, rows = run(tmp_path, convergence={"enabled": False})
    assert all(row[name] is None for row in rows for name in CERTIFICATE)
    assert not len(summarise(folder).estimates)


def test_an_unconverged_cell_keeps_its_numbers_and_measures_nothing(tmp_path):
    folder, rows = run(tmp_path, convergence={"tolerance": 1e-9}, step_fraction=0.02)
    assert {row["status"] for row in rows} == {"unconverged"}
    assert all(row["v1"] is not None and row["v1_limit"] is not None for row in rows)
    divergence = pq.read_table(folder.root / "divergence.parquet").to_pylist()
    assert all(row["velocity_divergence"] is None for row in divergence if row["solver"] == "mujoco")


def row(solver, v1, limit=None, away=None):
    """A row of the table of cells, as far as limits are concerned."""
    numbers = {
        "v1_limit": limit,
        "v2_limit": limit and 0.0,
        "limit_error": limit and 1e-3,
        "limit_distance": away,
    }
    rest = {"order": limit and 1.0, "regularisation": limit and 0.0, "marked": None}
    return {"cell": 0, "solver": solver, "status": "ok", "v0": -1.0, "v1": v1, "v2": 0.0} | numbers | rest


def held(path, rows, names, **options):
    schema = layout_of(parse_config({})).tables["cells"].schema
    fields = [field for field in schema if field.name in rows[0]]
    pq.write_table(pa.Table.from_pylist(rows, pa.schema(fields)), path / "cells.parquet")
    return convergence_estimates(path / "cells.parquet", names, **options)


def test_an_engine_is_held_against_the_exact_solver_of_its_own_law(tmp_path):
    rows = [
        row("kelvin-voigt", 0.3),
        row("hunt-crossley", 0.5),
        row("mujoco", 0.31, 0.3005, 5e-4),
        row("drake-hunt-crossley", 0.51, 0.5005, 4e-3),
        row("mujoco-naive", 0.6, 0.6),
    ]
    table = held(tmp_path, rows, [row["solver"] for row in rows])
    assert table.asked.tolist() == ["kelvin-voigt", "hunt-crossley", ""]
    assert table.asked_max.tolist() == pytest.approx([5e-4, 4e-3, math.nan], nan_ok=True)
    assert table.honest.tolist()[:2] == [1.0, 0.0]
    assert table.honest.isna().tolist() == [False, False, True]
    assert held(tmp_path, rows, ["mujoco"], mapping="naive").asked.tolist() == [""]
