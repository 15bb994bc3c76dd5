"""What a run of columns shows, and what other commands make of its folder."""

import json
import re
import shlex

import numpy as np
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.summary import load_divergence, summarise
from impact_xval.experiments.presentation.findings import asked
from impact_xval.experiments.presentation.page.charts import tiles_of
from impact_xval.experiments.presentation.page.opened import opened_cells
from impact_xval.experiments.presentation.report import present
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.folder import finished

CONFIG = {
    "name": "few columns",
    "solvers": ["bistiffness", "kelvin-voigt", "mujoco"],
    "column": {"arrangement": ["cradle", "drop"], "balls": [2, 3, 4], "e": [0.6, 0.9], "exponent": [1.0, 1.5]}
    | {"stiffness_taper": 1.0},
    "figure_column": {"balls": 4, "e": 0.8},
}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = tmp_path_factory.mktemp("columns") / "run"
    run_sweep(parse_config(CONFIG), root, isolate=False, present=present)
    return root


def test_every_median_is_that_of_the_table(root):
    summary = summarise(finished(root))
    rows = pq.read_table(root / "divergence.parquet").to_pandas()
    assert (summary.n_cells, list(summary.axes)) == (24, ["balls", "arrangement", "e", "exponent"])
    for name in ("bistiffness", "kelvin-voigt", "mujoco"):
        of_solver = rows[(rows.solver == name) & rows.marked.isna()]
        for where, some in (((), of_solver), (("balls", 3), of_solver[of_solver.balls == 3])):
            found = summary.get(name, "velocity_divergence", *where)
            assert found["median"] == some.velocity_divergence.median()
            assert found["n"] == some.velocity_divergence.notna().sum()
    assert summary.statuses.loc["mujoco", "unrepresentable"] == 12
    (reason,) = {row.reason for row in summary.reasons.itertuples() if row.solver == "mujoco"}
    assert "exponent = 1.5" in reason


def test_the_page_shows_it(root):
    page = (root / "report.html").read_text(encoding="utf-8")
    page = re.sub(r"<script.*?</script>|<style.*?</style>", "", page, flags=re.DOTALL)
    captions = json.loads((root / "figures/captions.json").read_text(encoding="utf-8"))
    assert page.count("data:image/svg+xml;base64,") == len(captions) == 5
    for words in ("N = 2", "N = 3", "N = 4", "unrepresentable", "state-transition", "few columns"):
        assert words in page
    median = summarise(finished(root)).get("kelvin-voigt", "velocity_divergence")["median"]
    assert f'<td class="right">{median:.3g}</td>' in page
    assert not re.search(r"\bnan\b", re.sub(r"base64,[^\"]*", "", page))


def test_its_columns_open_with_what_the_tables_hold(root, monkeypatch, capsys):
    tiles = tiles_of(load_divergence(finished(root), finished(root).config()))
    assert (tiles.along, tiles.up) == ("balls", ("arrangement", "e", "exponent"))
    assert sorted(tiles.places.cell) == list(range(24))
    opened = opened_cells(finished(root), [0, 2])
    assert opened[2]["causes"][0].startswith("MuJoCo: exponent = 1.5: ")
    assert [row["velocities"] for row in opened[2]["results"] if row["solver"] == "mujoco"] == [[None, None]]
    monkeypatch.chdir(root.parent)
    show, solve, film = (shlex.split(command)[1:] for _, command in opened[0]["commands"])
    assert main(show) == 0, capsys.readouterr().err
    assert main([*film, "--solver", "kelvin-voigt"]) == 0, capsys.readouterr().err
    assert (root.parent / film[-1]).read_text().startswith("<!doctype html>")
    capsys.readouterr()
    assert main([*solve, "--solver", "kelvin-voigt", "--json"]) == 0
    found = {row["solver"]: row["velocities"] for row in json.loads(capsys.readouterr().out)}
    (law,) = (each["velocities"] for each in opened[0]["results"] if each["solver"] == "kelvin-voigt")
    assert found["kelvin-voigt"] == pytest.approx(law, abs=1e-12)


def test_the_curves_are_of_the_column_of_the_figures(root):
    curves = {row["solver"]: row for row in pq.read_table(root / "curves.parquet").to_pylist()}
    model, law = curves["state-transition"], curves["kelvin-voigt"]
    assert len(model["velocities"]) == 4
    # The impulse of the first contact is what ball 1 loses, per m1 |v0|.
    for row in (model, law, curves["mujoco"]):
        time, force = row["time"], row["forces"][0]
        assert np.trapezoid(force, time) == pytest.approx(1 + row["velocities"][0], rel=2e-2)


def test_what_the_model_refuses_is_unsolved_and_engines_are_still_beside_their_law(tmp_path):
    column = {
        "balls": 3,
        "gap": [0.0, 1e-5],
        "e": [0.8, 0.9],
        "stiffness_taper": 1.0,
        "arrangement": "cradle",
    }
    config = parse_config({"solvers": ["kelvin-voigt", "mujoco", "hunt-crossley"], "column": column})
    folder = run_sweep(config, tmp_path / "run", isolate=False, present=present)
    ((engine, law, _, most),) = asked(summarise(folder))
    assert (engine, law) == ("mujoco", "kelvin-voigt")
    assert most.value < 1e-3


def test_a_command_for_two_balls_refuses_it(root, capsys):
    assert main(["scene", str(root), "0"]) == 2
    assert "columns of N balls; legal: " in capsys.readouterr().err


def test_a_cell_is_shown_with_its_ladder_or_why_it_has_none(root, capsys):
    ladder = pq.read_table(root / "ladder.parquet").to_pandas()
    assert (len(ladder), (ladder.status == "ok").sum()) == (24, 12)
    assert main(["show", str(root), "--cell", "0"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "cell 0: balls = 2, arrangement = cradle" in shown
    assert ladder.sentence[0].replace("mujoco", "MuJoCo") in shown
    assert main(["show", str(root), "--cell", "2"]) == 0
    assert "mujoco: unrepresentable: exponent = 1.5" in capsys.readouterr().out
