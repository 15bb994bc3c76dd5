"""What runs say before they begin, and which cells they take."""

import shlex

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.errors import InterruptedRunError, UserError
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.sweep import run as sweep
from impact_xval.experiments.tables.folder import RunFolder

GRID = "[grid]\nstiffness_ratio = [0.1, 2, 10]\nmass_ratio = [1.25]\ne2 = {linear = [0.5, 0.9, 3]}\n"


def test_a_run_says_how_many_cells_there_are_and_which_axes_took_defaults(tmp_path, capsys, monkeypatch):
    def begun(config, root, *, progress, **_):
        progress(0, 0, "")
        raise UserError("far enough")

    monkeypatch.setattr(sweep, "run_sweep", begun)
    for text, says in (
        (GRID, "36 cells: stiffness_ratio 3, mass_ratio 1, e1 4 (default), e2 3"),
        (
            "[column]\narrangement = ['drop']\nballs = [2, 3]\ne = 0.9\n",
            "6 columns: arrangement 1, balls 2, exponent 1 (default), mass_taper 1 (default), "
            "stiffness_taper 3 (default), gap 1 (default), e 1",
        ),
    ):
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
    assert words == ["impact-xval", "run", "--quick", "--out", str(root)]
    assert main(words[1:]) == 1
    assert configs[0] == configs[1]
    quick, whole = configs[0], parse_config({})
    assert len(experiment_cells(quick)) == 40
    for name, values in whole.grid.axes().items():
        taken = quick.grid.axes()[name]
        assert set(taken) < set(values)
        assert (taken[0], taken[-1]) == (values[0], values[-1])
    assert quick.canonical() | {"name": "", "grid": {}} == whole.canonical() | {"name": "", "grid": {}}
    RunFolder(tmp_path).write_config(whole)
    assert main(["run", "--quick", "--out", str(tmp_path)]) == 2
    assert f"--quick with --out {tmp_path}: holds another run" in capsys.readouterr().err
