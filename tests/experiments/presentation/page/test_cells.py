"""What a cell shows when it is opened, held against the tables, the engine and the commands it names."""

import json
import shlex

import pandas as pd
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.presentation.page.opened import opened_cells
from impact_xval.experiments.tables.folder import RunFolder

CELLS = [0, 7, 11]


@pytest.fixture(scope="module")
def cells(engine_run):
    return opened_cells(RunFolder(engine_run), CELLS)


def test_it_shows_the_tables(engine_run, cells):
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


def test_curves_end_where_the_tables_do_and_the_scene_is_one(cells):
    mujoco = pytest.importorskip("mujoco")
    for cell in cells.values():
        assert mujoco.MjModel.from_xml_string(cell["scene"]).npair == 2
        ends = {row["solver"]: row["end"] for row in cell["results"]}
        assert list(cell["curves"]) == ["state-transition", "kelvin-voigt", "bistiffness"]
        for name, (impulse1, impulse2) in cell["curves"].items():
            assert [impulse1[-1], impulse2[-1]] == pytest.approx(ends[name], abs=1e-4)
            assert (impulse1[0], impulse2[0]) == (0, 0)


def test_its_commands_can_be_pasted(engine_run, cells, monkeypatch, capsys):
    monkeypatch.chdir(engine_run.parent)
    expected = {row["solver"]: row["velocities"][0] for row in cells[7]["results"]}
    ladder, scene, solve, animate = (shlex.split(command)[1:] for _, command in cells[7]["commands"])
    for command in (ladder, scene):
        assert main(command) == 0, capsys.readouterr().err
    capsys.readouterr()
    assert main([*solve, "--json", *(word for name in expected for word in ("--solver", name))]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {row["solver"]: row["v1"] for row in found} == expected
    assert main([*animate, "--solver", "kelvin-voigt"]) == 0, capsys.readouterr().err
    assert (engine_run.parent / "cell-7.html").is_file()
