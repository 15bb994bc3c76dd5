"""Statistics of a run are those of its tables; figures and page show any text as text."""

import json
import math

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.measures.aggregates import between
from impact_xval.experiments.measures.summary import SUMMARISED, summarise
from impact_xval.experiments.presentation.figures import write_figures
from impact_xval.experiments.presentation.report import write_report, write_tables
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import fakes
from tests.experiments.conftest import SMALL

HOSTILE = "<script>alert(1)</script> 100% of $x_1^2$ & {a} \\input{b} | #1 ~ `c` *d* [e](f)"


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    config = parse_config(SMALL | {"name": HOSTILE, "grazing_threshold": 0.05})
    return run_sweep(
        config, tmp_path_factory.mktemp("hostile") / "run", isolate=False, resolve=fakes.crashing
    )


def test_statistics_are_those_of_the_table(hostile):
    summary = summarise(hostile)
    table = pq.read_table(hostile.root / "divergence.parquet").to_pandas()
    table = table[(table.solver == "mujoco") & table.velocity_divergence.notna()]
    regular = table[~(table.model_grazing_margin < 0.05)]
    assert len(regular) > 0
    for measure in SUMMARISED:
        row = summary.get("mujoco", measure)
        sizes = np.abs(regular[measure].to_numpy(dtype=float))
        assert row.n == len(sizes)
        assert row["median"] == pytest.approx(np.median(sizes))
        assert row.p95 == pytest.approx(np.percentile(sizes, 95))
        assert row["max"] == sizes.max()
        for value, part in regular.groupby("stiffness_ratio"):
            row = summary.get("mujoco", measure, "stiffness_ratio", float(str(value)))
            assert row["max"] == np.abs(part[measure].to_numpy(dtype=float)).max()
    assert summary.get("mujoco", "states_equal")["mean"] == 1
    grazing = summary.get("mujoco", "velocity_divergence", cells="grazing")
    assert grazing.n + len(regular) == len(table)
    assert summary.statuses.loc["mujoco"].to_dict() == {"ok": 6, "crashed": 6, "unavailable": 0}
    assert summary.worst.velocity_divergence.is_monotonic_decreasing
    nothing = summary.get("pybullet", "velocity_divergence")
    assert nothing.n == 0
    assert math.isnan(nothing["median"])


def test_tables_show_text_of_a_user_as_text(hostile):
    write_tables(hostile)
    table = pd.read_csv(hostile.root / "summary.csv")
    assert {"solver", "axis", "value", "measure", "n", "median", "p95", "max"} <= set(table.columns)
    assert set(table.axis) == {"all", "stiffness_ratio", "mass_ratio", "e1", "e2", "stiffness_band"}
    text = (hostile.root / "summary.md").read_text()
    assert "<script>" not in text
    assert "ZeroDivisionError: a bug of the engine \\| here" in text
    text = (hostile.root / "summary.tex").read_text()
    assert r"\textless{}script\textgreater{}" in text
    assert r"\input{b}" not in text


@pytest.fixture
def drawn(hostile):
    write_figures(hostile)
    return hostile


@pytest.mark.slow
def test_the_page_has_every_figure_with_its_caption(drawn):
    page = write_report(drawn).read_text()
    assert "<script>alert(1)</script>" not in page
    captions = json.loads((drawn.root / "figures/captions.json").read_text())
    assert page.count('<img src="data:image/png;base64,') == len(captions) >= 5
    for name in captions:
        assert (drawn.root / "figures" / f"{name}.png").stat().st_size > 5000
        assert (drawn.root / "figures" / f"{name}.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.slow
def test_a_grid_of_limits_has_all_its_figures(tmp_path):
    grid = {"stiffness_ratio": [0, 1, math.inf], "mass_ratio": [1.0], "e1": [0.0], "e2": [0.0, 1.0]}
    config = parse_config(SMALL | {"grid": grid, "grazing_threshold": 0.0})
    folder = run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    assert len(write_figures(folder)) >= 5
    write_tables(folder)
    write_report(folder)


def test_marked_rows_are_in_no_comparison_of_two_solvers(tmp_path):
    columns = {
        "cell": [0, 0, 0, 1, 1, 1],
        "solver": ["state-transition", "kelvin-voigt", "mujoco"] * 2,
        "status": ["ok"] * 6,
        "marked": [None, None, None, None, "beside a jump", None],
        "v0": [-1.0] * 6,
        "v1": [0.5, 0.5, 0.51, 0.5, 0.5, 0.9],
        "v2": [0.1] * 6,
        "mass_ratio": [1.0] * 6,
    }
    pq.write_table(pa.table(columns), tmp_path / "cells.parquet")
    config = parse_config({"solvers": ["kelvin-voigt", "mujoco"]})
    (row,) = between(tmp_path / "cells.parquet", config).itertuples()
    assert (row.n, row.max) == (1, pytest.approx(0.01))
