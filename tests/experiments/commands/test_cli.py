import json
import math
import subprocess
import sys

import pytest

from impact_xval.compliant_baselines import registry, solver_names
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.sweep import one
from tests.experiments import fakes

CELL = ["--stiffness-ratio", "40", "--mass-ratio", str(2 / math.sqrt(3)), "--e1", "0.9", "--e2", "0.7"]


def _json(command, *arguments):
    return json.loads(command(["solve", *arguments, "--json"]), parse_constant=pytest.fail)  # strict JSON


def test_solve_json_keeps_the_contract(command):
    (found,) = _json(command, *CELL, "--solver", "state-transition")
    assert found["solver"] == "state-transition"
    assert found["v1"] == pytest.approx(0.88981120733190, abs=1e-12)
    assert found["v2"] == pytest.approx(0.00016910787873, abs=1e-12)
    assert found["states"] == ["S1", "S3", "S1", "S2", "S4"]
    assert found["status"] == "ok"
    assert found["velocities"] == [found["v1"], found["v2"]]
    impulse1, impulse2 = found["impulses"]
    assert impulse1 == pytest.approx(1 + found["v1"], abs=1e-12)
    assert impulse2 == pytest.approx(impulse1 + 2 / math.sqrt(3) * found["v2"], abs=1e-12)


#: A drop after which B2 is at rest on the table, at some speed.
SOFT = ["--stiffness-ratio", "0.1", "--mass-ratio", "0.5", "--e1", "0.9", "--e2", "0.5", "--k1", "1e4"]


@pytest.mark.parametrize(
    ("cell", "faster"),
    [(CELL, ["--v0", "-4"]), ([*SOFT, "--scenario", "drop"], ["--v0", "-4", "--gravity", "39.24"])],
    ids=["impact", "drop"],
)
def test_no_number_of_the_list_depends_on_the_speed(command, cell, faster):
    """g in proportion to |v0| keeps the gravity number of a drop; times do not depend on the speed anyway."""
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
    assert (model["v1"], model["v2"], model["status"]) == (0.5, 0.0, "limit")
    for other in (each for each in found if each["solver"] in ("mujoco", "pybullet")):
        assert other["status"] in ("unrepresentable", "unavailable")
        assert other["reason"]
        assert other["v1"] is None


def test_help_and_version_are_quick_and_load_nothing_heavy():
    script = (
        "import sys; from impact_xval.experiments.commands.cli import main; code = main(sys.argv[1:]);"
        "heavy = {'numpy', 'pandas', 'matplotlib', 'pyarrow', 'numba', 'mujoco', 'jinja2'} & set(sys.modules);"
        "sys.exit(f'{heavy}' if heavy else code)"
    )
    for arguments in (["--version"], [], ["solve", "--help"]):
        done = subprocess.run(
            [sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True
        )
        assert "impact-xval" in done.stdout


@pytest.mark.smoke
def test_a_run_from_end_to_end(tmp_path, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.toml").write_text(
        "name = '../<b>my [bold]run[/bold]</b>'\nsolvers = ['state-transition']\n"
        "[grid]\nstiffness_ratio = [0, 1, inf]\nmass_ratio = [1.0]\ne1 = [0.9]\ne2 = [0.7]\n"
    )
    last = command("run my.toml --workers 1").strip().splitlines()[-1]
    root = tmp_path / "runs" / "b-my-bold-run-bold-b"
    assert last.endswith("runs/b-my-bold-run-bold-b")
    names = ("cells.parquet", "divergence.parquet", "divergence.csv", "curves.parquet", "ladder.parquet")
    for name in ("manifest.json", *names, "ladder.csv", "summary.csv", "figures", "report.html", "parts"):
        assert (root / name).exists(), name
    for words in ("run my.toml --workers 1", f"report {root}", f"show {root}"):
        command(words)
    (row,) = json.loads(command(f"show {root} --cell 1 --json"))
    assert (row["solver"], row["status"], row["velocity_divergence"]) == ("state-transition", "ok", None)
    (row,) = json.loads(command(f"show {root} --cell 2 --json"))
    assert (row["status"], row["stiffness_ratio"]) == ("limit", None)  # JSON has no infinity


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
