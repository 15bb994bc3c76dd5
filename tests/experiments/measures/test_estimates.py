"""The limit dt -> 0 in the tables of a run."""

import math

import pandas as pd
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.summary import convergence_estimates, summarise
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.schema import CERTIFICATE as OF_LIMITS
from impact_xval.experiments.tables.schema import expanded
from tests.experiments.conftest import SMALL

CERTIFICATE = expanded(OF_LIMITS, 2, 2)


def run(tmp_path, **changes):
    folder = run_sweep(parse_config(SMALL | {"solvers": ["mujoco"]} | changes), tmp_path / "r", isolate=False)
    return folder, pq.read_table(tmp_path / "r/cells.parquet").to_pylist()[1::2]


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
    ladder = folder.read_table("ladder.parquet").to_pandas()
    assert ladder.reason.str.startswith("mujoco: ").all()
    assert ladder.engine_norm.notna().all()
    assert ladder.mapping_norm.isna().all()
    assert summarise(folder).ladder.solvers == []


def test_an_engine_is_held_against_the_exact_solver_of_its_own_law(tmp_path):
    rows = [
        ("kelvin-voigt", 0.3, None, None),
        ("hunt-crossley", 0.5, None, None),
        ("mujoco", 0.31, 0.3005, 5e-4),
        ("drake-hunt-crossley", 0.51, 0.5005, 4e-3),
        ("mujoco-naive", 0.6, 0.6, None),
    ]
    cells = pd.DataFrame(rows, columns=["solver", "v1", "v1_limit", "limit_distance"])
    cells[["status", "marked"]] = "ok", None
    cells[["v0", "v2", "v2_limit", "limit_error", "order", "regularisation"]] = -1.0, 0.0, 0.0, 1e-3, 1.0, 0.0
    cells.to_parquet(tmp_path / "cells.parquet")
    table = convergence_estimates(tmp_path / "cells.parquet", cells.solver)
    assert table.asked.tolist() == ["kelvin-voigt", "hunt-crossley", ""]
    assert table.asked_max.tolist() == pytest.approx([5e-4, 4e-3, math.nan], nan_ok=True)
    assert table.honest.tolist() == pytest.approx([1.0, 0.0, math.nan], nan_ok=True)
    assert convergence_estimates(tmp_path / "cells.parquet", ["mujoco"], "naive").asked.tolist() == [""]
