"""The commands that solve one collision and run an experiment: what they print and write."""

import json
import math
import platform
import shlex
import subprocess
import sys
from importlib.metadata import version

import pytest

from impact_xval.compliant_baselines import registry, solver_names
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.experiments.commands.cli import ENGINE_PACKAGES, main
from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.errors import InterruptedRunError, UserError
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.sweep import one
from impact_xval.experiments.sweep import run as sweep
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.model import Collision, solve
from tests.experiments import fakes

CELL = ["--stiffness-ratio", "40", "--mass-ratio", str(2 / math.sqrt(3)), "--e1", "0.9", "--e2", "0.7"]


def _json(command, *arguments):
    # strict JSON has no NaN and no infinity
    return json.loads(command(["solve", *arguments, "--json"]), parse_constant=pytest.fail)


def test_solve_json_keeps_the_contract(command):
    (found,) = _json(command, *CELL, "--solver", "state-transition")
    outcome = solve(Collision.from_ratios(40, 2 / math.sqrt(3), 0.9, 0.7))
    assert (found["solver"], found["status"], found["states"]) == (
        "state-transition",
        "ok",
        [*outcome.states],
    )
    assert found["velocities"] == [found["v1"], found["v2"]] == [*outcome.velocities]
    assert found["impulses"] == [*outcome.impulses]


#: Options for a drop after which B2 is at rest on the table, at some speeds.
SOFT = ["--stiffness-ratio", "0.1", "--mass-ratio", "0.5", "--e1", "0.9", "--e2", "0.5", "--k1", "1e4"]


@pytest.mark.parametrize(
    ("cell", "faster"),
    [(CELL, ["--v0", "-4"]), ([*SOFT, "--scenario", "drop"], ["--v0", "-4", "--gravity", "39.24"])],
    ids=["impact", "drop"],
)
def test_no_number_of_the_list_depends_on_the_speed(command, cell, faster):
    """Velocities per |v0| and diagnostics do not depend on v0, in an impact and in a drop.

    In the drop g is scaled by the same factor as |v0|, which keeps the gravity number. Times do not depend on v0.
    """
    names = ["mujoco", "kelvin-voigt", "bistiffness", "state-transition"]
    asked = [word for name in names for word in ("--solver", name)]
    slow, quick = _json(command, *cell, *asked), _json(command, *cell, *asked, *faster)
    assert [each["solver"] for each in slow] == names
    for plain, fast in zip(slow, quick, strict=True):
        assert fast["states"] == plain["states"]
        for key in ("velocities", "impulses"):
            assert fast[key] == pytest.approx(plain[key], rel=1e-6, abs=1e-9)
        assert fast["diagnostics"] == pytest.approx(plain["diagnostics"], rel=1e-3, abs=1e-9)
    assert "v1_limit" in slow[0]["diagnostics"]


def test_solve_takes_an_infinite_ratio_and_shows_refusals(command):
    found = _json(command, "--stiffness-ratio", "inf", "--mass-ratio", "1", "--e1", "0.5", "--e2", "0.5")
    assert [each["solver"] for each in found] == list(solver_names())
    model = found[0]
    assert (model["v1"], model["v2"], model["status"]) == (0.5, 0.0, "closed-form")
    for other in (each for each in found if each["solver"] in ("mujoco", "pybullet")):
        assert other["status"] in ("unrepresentable", "unavailable")
        assert other["reason"]
        assert other["v1"] is None


@pytest.mark.parametrize(
    "of_collision", [CELL, ["--graph", "bernoulli", "--stiffness-ratio", "4"]], ids=["pair", "graph"]
)
def test_solve_fails_where_every_solver_that_was_asked_for_is_unavailable(command, of_collision):
    absent = [name for name in solver_names(on_request=True) if registry.get_solver(name).unavailable()]
    if not absent:
        pytest.skip("every engine is installed")
    asked = ["solve", *of_collision, "--solver", absent[0]]
    assert "unavailable" in command(asked, ends=1)
    assert command([*asked, "--solver", "kelvin-voigt"])


def test_help_and_version_are_quick_and_load_nothing_heavy():
    script = (
        "import sys; from impact_xval.__main__ import entry; code = entry();"
        "heavy = {'numpy', 'pandas', 'matplotlib', 'pyarrow', 'numba', 'mujoco', 'jinja2'} & set(sys.modules);"
        "sys.exit(f'{heavy}' if heavy else code)"
    )
    for arguments in (["--version"], [], ["solve", "--help"]):
        done = subprocess.run(
            [sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True
        )
        assert "impact-xval" in done.stdout
    solving = "import sys, impact_xval.experiments.sweep.chunk; assert not {'pandas', 'matplotlib'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", solving], check=True)


@pytest.mark.smoke
def test_a_run_from_end_to_end(tmp_path, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.toml").write_text(
        "name = '../<b>my [bold]run[/bold]</b>'\nsolvers = ['state-transition']\n"
        "[grid]\nstiffness_ratio = [0, 1, inf]\nmass_ratio = [1.0]\ne1 = [0.9]\ne2 = [0.7]\n"
    )
    *printed, last = command("run my.toml --workers 1").strip().splitlines()
    done, tables, page = (
        printed.index(next(line for line in printed if line.startswith(start)))
        for start in ("3 of 3 cells", "all cells are done: writing tables", "drawing figures and the page")
    )
    assert done < tables < page
    root = tmp_path / "runs" / "b-my-bold-run-bold-b"
    assert last.endswith("runs/b-my-bold-run-bold-b")
    names = ("cells.parquet", "divergence.parquet", "divergence.csv", "curves.parquet", "ladder.parquet")
    for name in ("manifest.json", *names, "ladder.csv", "summary.csv", "figures", "report.html", "parts"):
        assert (root / name).exists(), name
    for words in ("run my.toml --workers 1", ["report", root], ["show", root]):
        command(words)
    (row,) = json.loads(command(["show", root, "--cell", 1, "--json"]))
    assert (row["solver"], row["status"], row["velocity_divergence"]) == ("state-transition", "ok", None)
    (row,) = json.loads(command(["show", root, "--cell", 2, "--json"]))
    assert (row["status"], row["stiffness_ratio"]) == ("closed-form", None)  # JSON has no infinity


def test_ctrl_c_in_any_command_is_one_line_and_exit_code_1(capsys, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(one, "wait", interrupted)
    assert main(["solve", "--stiffness-ratio", "1", "--mass-ratio", "1", "--e1", "0.9", "--e2", "0.9"]) == 1
    assert capsys.readouterr().err == "impact-xval: interrupted\n"


@pytest.mark.parametrize(
    ("e1", "status", "reason"),
    [
        (fakes.HANG, "timeout", "no answer within 5 s; its process was ended"),
        (fakes.LEAVE, "crashed", "its process died: exit code 3"),
    ],
)
def test_a_solver_that_hangs_or_dies_costs_its_own_row(e1, status, reason, command, monkeypatch):
    monkeypatch.setattr(registry, "get_solver", fakes.faulty)
    cell = [*CELL[:4], "--e1", str(e1), "--e2", "0.7", "--cell-timeout", "5"]
    found = _json(command, *cell, "--solver", "mujoco", "--solver", "state-transition")
    assert [each["status"] for each in found] == [status, "ok"]
    assert found[0]["reason"] == reason


GRID = "[grid]\nstiffness_ratio = [0.1, 2, 10]\nmass_ratio = [1.25]\ne2 = {linear = [0.5, 0.9, 3]}\n"


def test_a_run_says_how_many_cells_there_are_and_which_axes_took_defaults(tmp_path, capsys, monkeypatch):
    def begun(config, root, *, progress, **_):
        progress(0, 0, "")
        raise UserError("far enough")

    monkeypatch.setattr(sweep, "run_sweep", begun)
    for text, says in (
        (
            GRID,
            "36 cells; values on each axis: 3 of stiffness_ratio, 1 of mass_ratio, 4 of e1 (default), 3 of e2",
        ),
        (
            "[chain]\narrangement = ['pile']\nballs = [2, 3]\ne = 0.9\n",
            "6 chains; values on each axis: 1 of arrangement, 2 of balls, 1 of exponent (default), "
            "1 of mass_taper (default), 3 of stiffness_taper (default), 1 of gap (default), 1 of e",
        ),
    ):
        (tmp_path / "my.toml").write_text(text)
        assert main(["run", str(tmp_path / "my.toml"), "--out", str(tmp_path / "a")]) == 2
        assert says in capsys.readouterr().out.splitlines()


def test_a_signal_outside_the_run_itself_tells_how_to_continue_too(tmp_path, capsys, monkeypatch):
    def begun(config, root, **_):
        raise KeyboardInterrupt

    monkeypatch.setattr(sweep, "run_sweep", begun)
    assert main(["run", "--quick", "--out", str(tmp_path / "run")]) == 1
    said = capsys.readouterr().err
    assert (
        f"interrupted; finished parts are kept; to continue: impact-xval run --quick --out {tmp_path}" in said
    )


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
    assert f"--quick with --out {tmp_path}, which has another run" in capsys.readouterr().err


def test_the_version_names_python_and_the_engines_that_are_installed(command):
    said = dict(line.split(" ") for line in command("--version").splitlines())
    assert said.pop("impact-xval") == version("impact-xval")
    assert said.pop("Python") == platform.python_version()
    assert set(said) <= {"numpy", *ENGINE_PACKAGES}
    assert {name: version(name) for name in said} == said
    assert {"numpy", "mujoco"} <= set(said)


def test_every_engine_is_named_by_its_package():
    solvers = (registry.get_solver(name) for name in solver_names(on_request=True))
    assert {solver.distribution for solver in solvers if isinstance(solver, Engine)} == set(ENGINE_PACKAGES)
