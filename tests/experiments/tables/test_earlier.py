"""Folders, files and options of version 0.4 can still be read. `runs_of_0.4` was written by that version."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import load_config, parse_config
from impact_xval.experiments.config.renamed import CASES, STATUSES
from impact_xval.experiments.hypothesis.config import HypothesisConfig
from impact_xval.experiments.measures.layout import layout_of
from impact_xval.experiments.scoreboard.cases import CASE_SETUPS
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.comparison import compare_runs
from impact_xval.experiments.tables.folder import run_folder
from impact_xval.model.status import STATUSES as STATUSES_NOW
from tests.conftest import ended
from tests.experiments.conftest import tables_of

RUNS = Path(__file__).with_name("runs_of_0.4")

OLD_EXPERIMENT = """
solvers = ["kelvin-voigt"]
[column]
arrangement = ["cradle", "drop", "chain"]
balls = [2, 3]
e = [0.0, 0.9]
stiffness_taper = 1.0
[figure_column]
arrangement = "drop"
balls = 3
"""


@pytest.fixture(params=["cells", "chains"])
def old_run(request, tmp_path):
    return Path(shutil.copytree(RUNS / request.param, tmp_path / request.param))


def test_tables_have_the_columns_and_the_words_of_today(old_run):
    run = run_folder(old_run)
    for name, table in layout_of(run.config()).tables.items():
        rows = run.read_table(f"{name}.parquet")
        assert rows.column_names == table.schema.names
        assert set(rows["status"].to_pylist()) <= {*STATUSES_NOW}
    cells = run.read_table("cells.parquet").to_pandas()
    assert (cells.status == STATUSES["limit"]).sum() == (4 if old_run.name == "cells" else 6)
    if old_run.name == "chains":
        assert set(cells.arrangement) == {"cradle", "pile", "row"}


def test_show_and_compare_read_a_run_of_0_4_and_change_nothing(old_run, command):
    before = tables_of(old_run)
    assert STATUSES["limit"] in command(["show", old_run])
    cell = command(["show", old_run, "--cell", "1"])
    assert ("arrangement = cradle" if old_run.name == "chains" else "k2/k1 = 0.1") in cell
    command(["compare", old_run, old_run, "--tolerance", "0"])
    assert tables_of(old_run) == before


def test_the_report_of_a_run_of_0_4_is_written_anew(old_run, command):
    command(["report", old_run])
    page = (old_run / "report.html").read_text(encoding="utf-8")
    assert ("arrangement" if old_run.name == "chains" else "k2/k1") in page
    assert (old_run / "summary.csv").exists()


def test_a_run_of_0_4_is_not_continued(old_run, refused):
    refused(["run", "--out", old_run], "a run of version 0.4, which is not continued; legal: a new folder")


def test_a_damaged_table_is_told(old_run):
    (old_run / "cells.parquet").write_bytes(b"PAR1")
    with pytest.raises(UserError, match=r"cells\.parquet: missing or damaged"):
        run_folder(old_run).tally()


def test_an_experiment_file_runs_and_agrees_with_the_run_of_0_4(tmp_path):
    path = tmp_path / "old.toml"
    path.write_text(OLD_EXPERIMENT)
    with pytest.warns(FutureWarning) as warned:
        config = load_config(path)
    said = {str(warning.message).partition(" now;")[0] for warning in warned}
    assert said == {
        "[column] is called [chain]",
        "[figure_column] is called [figure_chain]",
        "the arrangement 'chain' is called 'row'",
        "the arrangement 'drop' is called 'pile'",
    }
    old = run_folder(RUNS / "chains")
    found = compare_runs(old, run_sweep(config, tmp_path / "run", isolate=False).folder, 1e-9)
    assert {name: changes.compared for name, changes in found.solvers.items()} == {
        "state-transition": 12,
        "kelvin-voigt": 12,
    }
    assert found.moved == 0


def test_old_names_beside_new_ones_are_refused():
    with pytest.raises(UserError, match=r"column = .*unknown key"):
        parse_config({"column": {}, "chain": {}})


def test_an_option_is_read_with_a_warning(capsys, command):
    words = "solve --arrangement {} --balls 3 --solver state-transition"
    ours = command(words.format("row"))
    assert ended(words.format("chain")) == 0
    out, err = capsys.readouterr()
    assert out == ours
    assert err == (
        "impact-xval: warning: the arrangement 'chain' is called 'row' now; the next release refuses the old name\n"
    )


def test_a_file_of_the_hypothesis_is_read():
    with pytest.warns(FutureWarning, match=r"\[columns\] is called \[chains\] now"):
        config = HypothesisConfig(columns={"points": 3})
    assert config.chains.points == 3


def test_cases_of_a_scoreboard_are_found_again():
    assert set(CASES.values()) <= {*CASE_SETUPS}
    answers = pd.DataFrame({"case": [*CASES], "status": "limit"}).replace({"case": CASES, "status": STATUSES})
    assert answers.case.tolist() == [*CASES.values()]
