"""The limit for a time step of zero in the tables of a run."""

import math
from typing import Any

import pandas as pd
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.measures.summary import limit_estimates, summarise
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.schema import LIMIT, Counts, expand_columns, names_of
from tests.experiments.conftest import swept

LIMIT_COLUMNS = list(names_of(expand_columns(LIMIT, Counts(2, 2))))


# annotated as Any, because the annotations of data frames are too wide for a check
def run(tmp_path, **changes) -> Any:
    folder = swept(tmp_path / "r", get_solver, solvers=["mujoco"], **changes)
    return folder, pd.read_parquet(tmp_path / "r/cells.parquet")[1::2]


def test_tables_hold_the_outcome_and_its_limit(engine_run):
    rows: Any = pd.read_parquet(engine_run / "cells.parquet").set_index("cell")
    exact, engine = (rows[rows.solver == name] for name in ("kelvin-voigt", "mujoco"))
    assert rows[rows.solver != "mujoco"][LIMIT_COLUMNS].isna().all(axis=None)
    assert set(engine.status) == {"ok"}
    for ball in ("v1", "v2"):  # limits are per |v0|, while v1 and v2 are in m/s
        limit = engine[f"{ball}_limit"]
        assert ((limit - exact[ball] / 2).abs() <= 3 * engine.limit_error).all()
        assert (limit - engine[ball] / 2).abs().max() < 3e-3
    (row,) = summarise(RunFolder(engine_run)).estimates.itertuples()
    assert (row.solver, row.n, row.converged, row.honest) == ("mujoco", 12, 12, 1.0)
    assert row.step_max < 3e-3


def test_estimates_can_be_left_out(tmp_path):
    folder, rows = run(tmp_path, convergence={"enabled": False})
    assert rows[LIMIT_COLUMNS].isna().all(axis=None)
    assert not len(summarise(folder).estimates)


def test_an_unconverged_cell_keeps_its_numbers_and_measures_nothing(tmp_path):
    folder, rows = run(tmp_path, convergence={"tolerance": 1e-9}, step_fraction=0.02)
    assert set(rows.status) == {"unconverged"}
    assert rows[["v1", "v1_limit"]].notna().all(axis=None)
    divergence, ladder = (
        pd.read_parquet(folder.root / f"{name}.parquet") for name in ("divergence", "ladder")
    )
    assert divergence.velocity_divergence.isna().all()
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
    table = limit_estimates(tmp_path / "cells.parquet", cells.solver)
    assert table.asked.tolist() == ["kelvin-voigt", "hunt-crossley", ""]
    assert table.asked_max.tolist() == pytest.approx([5e-4, 4e-3, math.nan], nan_ok=True)
    assert table.honest.tolist() == pytest.approx([1.0, 0.0, math.nan], nan_ok=True)
    assert limit_estimates(tmp_path / "cells.parquet", ["mujoco"], "naive").asked.tolist() == [""]
