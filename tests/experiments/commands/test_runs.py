"""What runs and searches say before they begin, and which cells they take."""

import json
import shlex

import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.axes import Search
from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.config.errors import InterruptedRunError, UserError
from impact_xval.experiments.sweep import run as sweep
from impact_xval.experiments.sweep import search as searching
from impact_xval.experiments.sweep.designs import cells_of

GRID = "[grid]\nstiffness_ratio = [0.1, 2, 10]\nmass_ratio = [1.25]\ne2 = {linear = [0.5, 0.9, 3]}\n"
QUICK = "[search]\nsolver = 'bistiffness'\npopulation = 8\ngenerations = 4\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "[grid]\ne1 = [0.9]\n",
            "156 cells: stiffness_ratio 13 (default), mass_ratio 3 (default), e1 1, e2 4 (default)",
        ),
        (GRID, "36 cells: stiffness_ratio 3, mass_ratio 1, e1 4 (default), e2 3"),
        (
            "[column]\narrangement = ['drop']\nballs = [2, 3]\ne = 0.9\n",
            "6 columns: arrangement 1, balls 2, exponent 1 (default), mass_taper 1 (default), "
            "stiffness_taper 3 (default), gap 1 (default), e 1",
        ),
    ],
)
def test_a_run_says_how_many_cells_there_are_and_which_axes_took_defaults(
    text, says, tmp_path, capsys, monkeypatch
):
    def begun(config, root, *, progress, **_):
        progress(0, 0, "")
        raise UserError("far enough")

    monkeypatch.setattr(sweep, "run_sweep", begun)
    (tmp_path / "my.toml").write_text(text)
    assert main(["run", str(tmp_path / "my.toml"), "--out", str(tmp_path / "a")]) == 2
    assert says in capsys.readouterr().out.splitlines()


def test_a_quick_run_is_of_a_few_cells_of_the_built_in_grid_and_is_continued_as_one(
    tmp_path, capsys, monkeypatch
):
    configs = []

    def begun(config, root, **_):
        configs.append(config)
        raise InterruptedRunError("interrupted")

    monkeypatch.setattr(sweep, "run_sweep", begun)
    root = tmp_path / "my run"
    assert main(["run", "--quick", "--out", str(root)]) == 1
    command = capsys.readouterr().err.strip().split("to continue: ")[1]
    words = shlex.split(command)
    assert words == ["impact-xval", "run", "--quick", "--out", str(root), "--resume"]
    assert main(words[1:]) == 1
    assert configs[0] == configs[1]
    quick, whole = configs[0], parse_config({})
    assert len(cells_of(quick)) == 40
    for name, values in whole.grid.axes().items():
        taken = quick.grid.axes()[name]
        assert set(taken) < set(values)
        assert (taken[0], taken[-1]) == (values[0], values[-1])
    assert quick.canonical() | {"name": "", "grid": {}} == whole.canonical() | {"name": "", "grid": {}}


def test_a_quick_run_takes_neither_a_file_nor_the_folder_of_another(tmp_path, capsys):
    (tmp_path / "my.toml").write_text(GRID)
    assert main(["run", str(tmp_path / "my.toml"), "--quick"]) == 2
    assert f"--quick with {tmp_path / 'my.toml'}: " in capsys.readouterr().err
    (tmp_path / "a/parts").mkdir(parents=True)
    (tmp_path / "a/parts/configuration.json").write_text(json.dumps(parse_config({}).canonical()))
    assert main(["run", "--quick", "--resume", "--out", str(tmp_path / "a")]) == 2
    assert f"--quick with --resume --out {tmp_path / 'a'}: holds another run" in capsys.readouterr().err


def test_a_search_without_a_box_takes_that_of_the_grid(tmp_path, capsys, monkeypatch):
    asked = []

    def begun(config, root, *, progress, **_):
        progress(0, 0, "")
        asked.append(config.search)
        raise UserError("far enough")

    monkeypatch.setattr(searching, "search_worst", begun)
    (tmp_path / "my.toml").write_text(GRID)
    arguments = ["search", str(tmp_path / "my.toml"), "--out", str(tmp_path / "a")]
    for solver in ([], ["--solver", "bistiffness"]):
        assert main([*arguments, *solver]) == 2
        assert "searched: k2/k1 0.1 to 10, m2/m1 1.25, e1 0.5 to 1, e2 0.5 to 0.9" in capsys.readouterr().out
    assert [search.solver for search in asked] == ["mujoco", "bistiffness"]
    for search in asked:
        assert search.ranges() == {
            "stiffness_ratio": {"log": [0.1, 10.0]},
            "mass_ratio": 1.25,
            "e1": {"linear": [0.5, 1.0]},
            "e2": {"linear": [0.5, 0.9]},
        }


def test_a_search_says_what_is_left_from_its_first_generation_on(tmp_path, capsys):
    (tmp_path / "my.toml").write_text(QUICK)
    arguments = ["search", str(tmp_path / "my.toml"), "--out", str(tmp_path / "a"), "--workers", "1"]
    assert main(arguments) == 0
    counts = [line for line in capsys.readouterr().out.splitlines() if " of 40 cells after" in line]
    assert [line.split()[0] for line in counts] == ["0", "8", "16", "24", "32", "40"]
    assert "left" not in counts[0]
    assert all(" left at this rate" in line for line in counts[1:])


@pytest.mark.parametrize(
    ("given", "box"),
    [
        ({}, Search.model_validate({}).ranges()),
        ({"sample": {"e1": 0.8}}, Search.model_validate({"e1": 0.8}).ranges()),
        ({"search": {"e2": 0.6}}, Search.model_validate({"e2": 0.6}).ranges()),
    ],
    ids=["built in", "sample", "search"],
)
def test_the_box_is_that_of_the_design(given, box):
    table = parse_config(given).search_table()
    assert {name: table[name] for name in box} == box


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[grid]\nstiffness_ratio = [1, inf]\n", "search.stiffness_ratio = {log = [1.0, inf]}: "),
        ("cells = 'list.csv'\n", "cells is given without search; legal: a table search, or a grid or sample"),
    ],
)
def test_what_spans_no_box_is_refused(text, says, tmp_path, capsys):
    (tmp_path / "my.toml").write_text(text)
    assert main(["search", str(tmp_path / "my.toml"), "--out", str(tmp_path / "a")]) == 2
    assert capsys.readouterr().err.startswith(f"impact-xval: {tmp_path / 'my.toml'}: {says}")
    assert not (tmp_path / "a").exists()
