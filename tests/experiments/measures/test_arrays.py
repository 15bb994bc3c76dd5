"""Runs as xarray data sets."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.arrays import to_xarray
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import fakes


def test_a_grid_has_its_axes(crashing_run):
    data = to_xarray(crashing_run.root, ["status", "v1", "velocity_divergence", "states_equal"])
    assert dict(data.sizes) == {"solver": 3, "stiffness_ratio": 3, "mass_ratio": 2, "e1": 2, "e2": 1}
    assert data.v1.attrs["units"] == "m/s"
    for table, names in (("cells", ["status", "v1"]), ("divergence", ["velocity_divergence"])):
        for row in pq.read_table(crashing_run.root / f"{table}.parquet").to_pylist():
            there = data.sel(
                {axis: row[axis] for axis in ("solver", "stiffness_ratio", "mass_ratio", "e1", "e2")}
            )
            for name in names:
                expected = np.nan if row[name] is None else row[name]
                assert there[name].item() == pytest.approx(expected, nan_ok=True)
    assert np.isnan(data.velocity_divergence.sel(solver="state-transition")).all()
    with pytest.raises(ValueError, match=r"columns: 'v3' is unknown; known: cell, "):
        to_xarray(crashing_run, ["v3"])


def test_another_design_has_cells(tmp_path):
    config = parse_config(
        {"scenario": "impact", "solvers": ["mujoco"], "sample": {"n": 8, "e1": 0.9}, "chunk_size": 3}
    )
    run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    data = to_xarray(tmp_path / "a")
    assert dict(data.sizes) == {"solver": 2, "cell": 8}
    assert data.e1.values.tolist() == [0.9] * 8
    assert data.cell.values.tolist() == list(range(8))
    with pytest.raises(UserError, match="no such folder"):
        to_xarray(tmp_path / "none")
