"""What the page shows of an opened cell, compared with the tables, MuJoCo and the commands it names."""

import json
import shlex
import shutil
from concurrent.futures import Future
from pathlib import Path

import pandas as pd
import pytest

from impact_xval.experiments.presentation.page.opened import collect_cells
from impact_xval.experiments.presentation.page.page import pack_opening_cells
from impact_xval.experiments.presentation.report import present_run
from impact_xval.experiments.sweep.process import FaultError
from impact_xval.experiments.tables.folder import RunFolder

CELLS = [0, 7, 11]


@pytest.fixture(scope="module")
def cells(engine_run):
    return collect_cells(RunFolder(engine_run), CELLS)


def test_an_opened_cell_shows_the_tables(engine_run, cells):
    table = pd.read_parquet(engine_run / "cells.parquet").set_index(["cell", "solver"])
    d = pd.read_parquet(engine_run / "divergence.parquet").set_index(["cell", "solver"]).velocity_divergence
    ladder = pd.read_parquet(engine_run / "ladder.parquet").set_index("cell")
    assert list(cells) == CELLS
    for number, cell in cells.items():
        assert [row["solver"] for row in cell["results"]] == list(table.loc[number].index)
        for row in cell["results"]:
            stored = table.loc[(number, row["solver"])]
            assert row["velocities"] == [stored.v1 / 2, stored.v2 / 2]
            assert row["d"] == d.get((number, row["solver"]))
            assert row["states"] == stored.states_compared
        assert cell["causes"] == ["MuJoCo" + ladder.loc[number].sentence.removeprefix("mujoco")]


def test_a_chain_without_a_result_says_why(chain_run):
    cell = collect_cells(RunFolder(chain_run), [2])[2]
    assert cell["causes"][0].startswith("MuJoCo: exponent = 1.5: ")
    assert [row["velocities"] for row in cell["results"] if row["solver"] == "mujoco"] == [[None, None]]


def test_curves_end_where_the_tables_do_and_the_scene_is_one(cells):
    mujoco = pytest.importorskip("mujoco")
    for cell in cells.values():
        assert mujoco.MjModel.from_xml_string(cell["scene"]).npair == 2
        ends = {row["solver"]: row["end"] for row in cell["results"]}
        assert list(cell["curves"]) == ["state-transition", "kelvin-voigt", "bistiffness"]
        for name, (impulse1, impulse2) in cell["curves"].items():
            assert [impulse1[-1], impulse2[-1]] == pytest.approx(ends[name], abs=1e-4)
            assert (impulse1[0], impulse2[0]) == (0, 0)


@pytest.mark.parametrize(
    ("run", "cell", "count"),
    [("engine_run", 7, 4), pytest.param("chain_run", 0, 3, marks=pytest.mark.nightly)],
)
def test_commands_of_an_opened_cell_can_be_pasted(run, cell, count, request, monkeypatch, command):
    root = request.getfixturevalue(run)
    opened = collect_cells(RunFolder(root), [cell])[cell]
    *others, solve, film = commands = [shlex.split(line)[1:] for _, line in opened["commands"]]
    assert len(commands) == count
    monkeypatch.chdir(root.parent)
    for words in (*others, [*film, "--solver", "kelvin-voigt"]):
        command(words)
    assert (root.parent / f"cell-{cell}.html").read_text().startswith("<!doctype html>")
    expected = {row["solver"]: row["velocities"] for row in opened["results"]}
    said = command([*solve, "--json", *(word for name in expected for word in ("--solver", name))])
    found = {row["solver"]: row["velocities"] for row in json.loads(said)}
    assert found == expected


def test_a_process_that_is_killed_while_it_collects_them_costs_nothing(engine_run, tmp_path):
    root, killed = Path(shutil.copytree(engine_run, tmp_path / engine_run.name)), Future()
    killed.set_exception(FaultError("crashed", "its process died: SIGKILL"))
    present_run(RunFolder(root), lambda *_: killed)
    assert pack_opening_cells(None, RunFolder(root)) in (root / "report.html").read_text(encoding="utf-8")
