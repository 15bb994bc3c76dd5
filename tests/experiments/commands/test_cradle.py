import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from impact_xval.compliant_baselines import solver_names
from impact_xval.compliant_baselines.contract import registry
from impact_xval.experiments.commands.cli import main
from tests.compliant_baselines.third_party import GOOD, install
from tests.experiments import faulty

ROOT = Path(__file__).parents[3]
EXACT = ["state-transition", "liu-zhao-brogliato", "bistiffness", "kelvin-voigt", "hunt-crossley"]


def _json(capsys, command, *arguments):
    assert main([command, *arguments, "--json"]) == 0

    def refuse(name):
        raise AssertionError(f"{name} is not strict JSON")

    return {each["solver"]: each for each in json.loads(capsys.readouterr().out, parse_constant=refuse)}


def _asked(*solvers):
    return [word for name in solvers for word in ("--solver", name)]


@pytest.mark.parametrize(
    ("arguments", "solver", "velocities", "bears"),
    [
        (["--balls", "3", "--e", "0.9"], "state-transition", (0.065303, -0.167191, -0.898113), 2e-5),
        (
            ["--balls", "5", "--e", "1", "--exponent", "1.5", "--arrangement", "chain"],
            "state-transition",
            (0.07108502, 0.03027376, 0.01446363, -0.12704499, -0.98877742),
            1e-8,
        ),
        (
            ["--balls", "3", "--e", "0.9", "--arrangement", "stack"],
            "liu-zhao-brogliato",
            (1.093749, 0.889333, 0.592184),
            2e-5,
        ),
        (
            ["--balls", "2", "--e", "1", "--arrangement", "drop", "--stiffness-taper", "0.01"],
            "state-transition",
            (0.717800, 0.696251),
            2e-5,
        ),
    ],
)
def test_what_others_have_printed(capsys, arguments, solver, velocities, bears):
    """Each number by others, with the precision it bears (docs/columns.md, section 5)."""
    found = _json(capsys, "cradle", *arguments, *_asked(solver))[solver]
    assert found["velocities"] == pytest.approx(velocities, abs=bears, rel=0)


def test_two_strike_and_about_two_leave(capsys):
    """Two Hertz balls that strike three: the first two of the far side leave with 1.14 and 0.80."""
    arguments = ["--balls", "5", "--strike", "2", "--e", "1", "--exponent", "1.5"]
    found = _json(capsys, "cradle", *arguments, *_asked("state-transition", "kelvin-voigt", "mujoco"))
    model, law, engine = found.values()
    assert model["velocities"][:2:-1] == pytest.approx((-1.14, -0.80), abs=1e-2)
    assert law["velocities"] == pytest.approx(model["velocities"], abs=1e-9)
    assert model["retained_energy"] == pytest.approx(1, abs=1e-9)
    assert model["retained_momentum"] == pytest.approx(1, abs=1e-12)
    assert (engine["status"], engine["velocities"]) == ("unrepresentable", [None] * 5)
    assert "exponent = 1.5" in engine["reason"]


def test_the_model_is_added_so_that_any_solver_has_a_divergence(capsys):
    found = _json(capsys, "cradle", "--balls", "3", "--e", "0.9", *_asked("bistiffness"))
    assert list(found) == ["bistiffness", "state-transition"]
    assert (
        found["bistiffness"]["velocity_divergence"] >= found["state-transition"]["velocity_divergence"] == 0
    )


def test_contacts_each_much_softer_than_the_last_make_the_cradle_of_the_textbooks(capsys):
    arguments = ["--balls", "4", "--e", "1", "--stiffness-taper", "1e-5", *_asked("state-transition")]
    (found,) = _json(capsys, "cradle", *arguments).values()
    assert found["velocities"] == pytest.approx((0, 0, 0, -1), abs=1e-2)


def test_two_balls_on_a_table_are_those_of_solve(capsys):
    ratios = ["--stiffness-taper", "3", "--mass-taper", "2", "--e", "0.8"]
    scale = ["--v0", "-2", *_asked(*EXACT)]
    found = _json(capsys, "cradle", "--arrangement", "drop", "--balls", "2", *ratios, "--m", "3", *scale)
    ratios = ["--stiffness-ratio", "3", "--mass-ratio", "2", "--e1", "0.8", "--e2", "0.8"]
    for name, expected in _json(capsys, "solve", *ratios, "--m1", "3", *scale).items():
        assert found[name]["velocities"] == pytest.approx([expected["v1"], expected["v2"]], abs=1e-12)
        impulses = [expected["impulse1"], expected["impulse2"]]
        assert found[name]["impulses"] == pytest.approx(impulses, abs=1e-12)
        assert found[name]["status"] == expected["status"]
        assert len(found[name]["states"]) == len(expected["states"])


def test_every_solver_stands_in_one_table(capsys):
    assert main(["cradle", "--balls", "3", "--e", "0.9"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "cradle: 1 of 3 balls strikes the others, e = 0.9."
    rows = {line.split()[0]: line.split()[1:] for line in lines[2:14]}
    shown = rows["solver"]
    assert shown[:3] == ["state-transition", "bistiffness", "kelvin-voigt"]
    assert rows["law"][:3] == shown[:3]
    assert set(rows["law"][3:]) <= {"kelvin-voigt"}
    assert [rows[f"v{i}"][0] for i in (1, 2, 3)] == ["0.065305", "-0.167193", "-0.898112"]
    assert rows["D"][0] == "0"
    assert set(rows["p/p0"]) == {"1.000000"}
    assert rows["states"][0] == "3"
    for name in set(solver_names()) - set(shown):
        assert [line for line in lines if line.startswith(f"{name}: un")] != []


def test_gaps_are_refused_by_who_knows_none(capsys):
    names = ["state-transition", "bistiffness", "kelvin-voigt"]
    found = _json(capsys, "cradle", "--balls", "3", "--gap", "2e-4", "--e", "1", *_asked(*names))
    model, *others = found.values()
    assert (model["status"], model["velocities"]) == ("unrepresentable", [None] * 3)
    assert "gaps = (0.0, 0.0002): the model has no positions" in model["reason"]
    # While a pair is in contact a ball at rest moves by pi/2 sqrt(M/k) v0 = 1.1e-4 m: the balls meet one by one.
    for other in others:
        assert other["velocities"] == pytest.approx([0, 0, -1], abs=1e-12)
        assert other["velocity_divergence"] is None


def test_no_number_depends_on_the_speed(capsys):
    names = ["state-transition", "kelvin-voigt", "mujoco"]
    plain, fast = (
        _json(capsys, "cradle", "--balls", "3", "--v0", v0, *_asked(*names)) for v0 in ("-1", "-4")
    )
    assert ("v3_limit" in plain["mujoco"]["diagnostics"]) == (plain["mujoco"]["status"] == "ok")
    for name in names:
        for key in ("velocities", "impulses"):
            assert fast[name][key] == pytest.approx(plain[name][key], rel=1e-6, abs=1e-9), key
        for key in ("velocity_divergence", "limit_distance", "limit_error"):
            if plain[name][key] is not None:
                assert fast[name][key] == pytest.approx(plain[name][key], rel=1e-3, abs=1e-7), key
        for key, value in plain[name]["diagnostics"].items():
            assert fast[name]["diagnostics"][key] == pytest.approx(value, rel=1e-3, abs=1e-9), key


@pytest.mark.parametrize(
    ("e", "status", "reason"),
    [
        (faulty.HANG, "timeout", "no answer within 5 s; its process was ended"),
        (faulty.ABORT, "crashed", "its process died: SIGABRT"),
    ],
)
def test_a_solver_that_hangs_or_dies_costs_its_own_row(capsys, monkeypatch, e, status, reason):
    monkeypatch.setattr(registry, "get_solver", faulty.faulty)
    names = _asked("mujoco", "pybullet", "state-transition")
    found = _json(capsys, "cradle", "--e", str(e), *names, "--cell-timeout", "5")
    assert [each["status"] for each in found.values()] == [status, "unavailable", "ok"]
    assert found["mujoco"]["reason"] == reason
    assert main(["cradle", "--e", str(e), *names, "--cell-timeout", "5"]) == 0
    assert f"mujoco: {status}: {reason}" in capsys.readouterr().out.splitlines()


#: A solver of columns; what it makes of each is put in.
_OTHER = """
import time
from impact_xval.compliant_baselines.contract.solver import SolverBase
from impact_xval.model import ColumnOutcome, solve, solve_column
class Mine(SolverBase):
    name = "mine"
    def version(self): return "1"
    def solve_many(self, collisions, settings): return list(map(solve, collisions))
    def solve_columns(self, columns, settings, exponent=1.0): return list(map(solve_column, columns))
class Stuck(Mine):
    name = "stuck"
    def solve_columns(self, columns, settings, exponent=1.0): time.sleep(3600)
class Short(Mine):
    name = "short"
    def solve_columns(self, columns, settings, exponent=1.0): return [ColumnOutcome("short", (1.0,), (1.0,))]
class Plain:
    name = "plain"
    def version(self): return "1"
    def unavailable(self): return None
    def solve_many(self, collisions, settings): return list(map(solve, collisions))
    def solve(self, collision, settings=None): return solve(collision)
"""


@pytest.mark.slow
def test_solvers_of_other_distributions_are_rows(tmp_path):
    points = {name: f"other:{name.capitalize()}" for name in ("mine", "stuck", "short", "plain")}
    install(tmp_path, "others", points | {"tiny": "tiny:TinyEngine"}, other=_OTHER, tiny=GOOD)
    command = ["cradle", "--json", "--cell-timeout", "5", *_asked("state-transition", *points, "tiny")]
    done = subprocess.run(
        [sys.executable, "-m", "impact_xval", *command],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])},
        capture_output=True,
        text=True,
        check=True,
    )
    found = {each["solver"]: each for each in json.loads(done.stdout)}
    assert found["mine"]["velocities"] == found["state-transition"]["velocities"]
    expected = {
        "stuck": ("timeout", "no answer within 5 s"),
        "short": ("crashed", "velocities; legal: a tuple of 5 numbers"),
        "plain": ("unrepresentable", "plain does not solve columns of N balls"),
        "tiny": ("unrepresentable", "tiny has no adapter for columns of N balls"),
    }
    for name, (status, says) in expected.items():
        assert (found[name]["status"], says in found[name]["reason"]) == (status, True), found[name]
