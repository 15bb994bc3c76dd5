"""Statistics of a run, compared with the tables of the run."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from impact_xval.compliant_baselines.registry import sort_by_law
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.summary import pairwise_divergence, summarise
from impact_xval.experiments.presentation import report
from impact_xval.experiments.presentation.document import Table
from impact_xval.experiments.presentation.findings import describe_counted_cells
from impact_xval.experiments.tables.folder import RunFolder
from tests.experiments import fakes
from tests.experiments.conftest import swept


def test_the_worst_cells_are_those_of_the_table(engine_run):
    """The worst cells in the summary are those with the largest D in the table of divergences."""
    table, worst = pd.read_parquet(engine_run / "divergence.parquet"), summarise(RunFolder(engine_run)).worst
    regular = table[(table.solver == "mujoco") & table.marked.isna()].velocity_divergence
    found = worst[worst.solver == "mujoco"].velocity_divergence
    assert found.tolist() == sorted(regular, reverse=True)[:5]


def test_solvers_of_one_law_stand_together_the_exact_one_first():
    ordered = ["kelvin-voigt", "mujoco", "pybullet", "bistiffness"]
    assert sort_by_law(["mujoco", "bistiffness", "pybullet", "kelvin-voigt"]) == ordered


def test_marked_beyond_the_model_are_results_whose_model_is_not_marked(tmp_path):
    run = swept(tmp_path / "run", fakes.crashing)
    path = run.root / "cells.parquet"
    table = pq.read_table(path)
    cells = table.to_pandas()
    engine = cells.solver == "mujoco"
    ok, crashed = (cells.cell[engine & (cells.status == status)].tolist() for status in ("ok", "crashed"))
    # Cells in which the model's outcome has a mark (a warning). The rows of all solvers in these cells get it, too.
    both = cells.cell.isin([ok[0], crashed[0]])
    cells["marked"] = np.where(both | (engine & cells.cell.isin([*ok[1:4], crashed[1]])), "a jump", None)
    pq.write_table(pa.Table.from_pandas(cells, table.schema), path)
    summary = summarise(run)
    assert (summary.n_marked, summary.marked_beyond) == (2, {"mujoco": 3})
    said = describe_counted_cells(summary)
    assert "The outcome of the model is marked in 2 of 12 cells. " in said
    assert "Only the outcome of the solver is marked in 3 more cells for MuJoCo." in said


def test_tables_for_a_paper(run, command):
    command(["report", run, "--only", "tables", "--latex"])
    table = pd.read_csv(run / "summary.csv")
    assert set(table.axis) == {"all", "stiffness_ratio", "mass_ratio", "e1", "e2", "stiffness_band"}
    text = (run / "summary.tex").read_text()
    assert "kelvin-voigt & mujoco & 12 &" in text
    assert r"95 \% & max" in text
    assert r" \% & " in text.partition(r"\midrule")[2]
    assert "times" not in text


def test_small_numbers_of_a_table_for_latex_are_powers_of_ten(run, monkeypatch):
    small = Table(["law", "solver", "cells", "median D"], [("a_b", "x:1e-3", 12, "7.77e-15")], text=2)
    monkeypatch.setattr(report, "overall_table", lambda summary: small)
    text = report.write_latex(RunFolder(run), summarise(RunFolder(run))).read_text()
    assert r"a\_b & x:1e-3 & 12 & $7.77 \times 10^{-15}$ \\" in text


def test_marked_rows_are_in_no_comparison_of_two_solvers(tmp_path):
    cells = pd.DataFrame({"solver": ["state-transition", "kelvin-voigt", "mujoco"] * 2, "status": "ok"})
    cells["marked"] = [None, None, None, None, "beside a jump", None]
    cells[["v0", "v2", "mass_ratio"]] = -1.0, 0.1, 1.0
    cells["v1"] = [0.5, 0.5, 0.51, 0.5, 0.5, 0.9]
    cells["cell"] = cells.index // 3
    cells.to_parquet(tmp_path / "cells.parquet")
    config = parse_config({"solvers": ["kelvin-voigt", "mujoco"]})
    (row,) = pairwise_divergence(tmp_path / "cells.parquet", config).itertuples()
    assert (row.n, row.max) == (1, pytest.approx(0.01))
