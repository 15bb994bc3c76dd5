import json

import pytest

from impact_xval.compliant_baselines import solver_names
from impact_xval.experiments.commands.cli import main

pytestmark = pytest.mark.usefixtures("kernels")


def _json(capsys, *arguments):
    assert main(["cradle", *arguments, "--json"]) == 0

    def refuse(name):
        raise AssertionError(f"{name} is not strict JSON")

    return {each["solver"]: each for each in json.loads(capsys.readouterr().out, parse_constant=refuse)}


def _asked(*solvers):
    return [word for name in solvers for word in ("--solver", name)]


def test_what_others_have_printed(capsys):
    """Each number by others, with the precision it bears (docs/columns.md, section 5)."""
    hertz = (0.07108502, 0.03027376, 0.01446363, -0.12704499, -0.98877742)
    for arguments, solver, velocities, bears in (
        ("--balls 3 --e 0.9", "state-transition", (0.065303, -0.167191, -0.898113), 2e-5),
        ("--balls 5 --e 1 --exponent 1.5 --arrangement chain", "state-transition", hertz, 1e-8),
        ("--balls 3 --e 0.9 --arrangement stack", "liu-zhao-brogliato", (1.093749, 0.889333, 0.592184), 2e-5),
        (
            "--balls 2 --e 1 --arrangement drop --stiffness-taper 0.01",
            "state-transition",
            (0.717800, 0.696251),
            2e-5,
        ),
    ):
        found = _json(capsys, *arguments.split(), *_asked(solver))[solver]
        assert found["velocities"] == pytest.approx(velocities, abs=bears, rel=0), arguments


def test_two_strike_and_about_two_leave(capsys):
    """Two Hertz balls that strike three: the first two of the far side leave with 1.14 and 0.80."""
    arguments = ["--balls", "5", "--strike", "2", "--e", "1", "--exponent", "1.5"]
    found = _json(capsys, *arguments, *_asked("state-transition", "kelvin-voigt", "mujoco"))
    model, law, engine = found.values()
    assert model["velocities"][:2:-1] == pytest.approx((-1.14, -0.80), abs=1e-2)
    assert law["velocities"] == pytest.approx(model["velocities"], abs=1e-9)
    assert model["retained_energy"] == pytest.approx(1, abs=1e-9)
    assert model["retained_momentum"] == pytest.approx(1, abs=1e-12)
    assert (engine["status"], engine["velocities"]) == ("unrepresentable", [None] * 5)
    assert "exponent = 1.5" in engine["reason"]


def test_every_solver_stands_in_one_table(capsys):
    assert main(["cradle", "--balls", "3", "--e", "0.9"]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = {line.split()[0]: line.split()[1:] for line in lines[2:14]}
    shown = rows["solver"]
    assert shown[:3] == ["state-transition", "bistiffness", "kelvin-voigt"]
    assert [rows[f"v{i}"][0] for i in (1, 2, 3)] == ["0.065305", "-0.167193", "-0.898112"]
    for name in set(solver_names()) - set(shown):
        assert [line for line in lines if line.startswith(f"{name}: un")] != []


def test_gaps_are_refused_by_who_knows_none(capsys):
    names = ["state-transition", "bistiffness", "kelvin-voigt"]
    found = _json(capsys, "--balls", "3", "--gap", "2e-4", "--e", "1", *_asked(*names))
    model, *others = found.values()
    assert (model["status"], model["velocities"]) == ("unrepresentable", [None] * 3)
    assert "gaps = (0.0, 0.0002): the model has no positions" in model["reason"]
    # While a pair is in contact a ball at rest moves by pi/2 sqrt(M/k) v0 = 1.1e-4 m: the balls meet one by one.
    for other in others:
        assert other["velocities"] == pytest.approx([0, 0, -1], abs=1e-12)
        assert other["velocity_divergence"] is None


def test_no_number_depends_on_the_speed(capsys):
    names = ["state-transition", "kelvin-voigt", "mujoco"]
    plain, fast = (_json(capsys, "--balls", "3", "--v0", v0, *_asked(*names)) for v0 in ("-1", "-4"))
    assert ("v3_limit" in plain["mujoco"]["diagnostics"]) == (plain["mujoco"]["status"] == "ok")
    for name in names:
        for key in ("velocities", "impulses"):
            assert fast[name][key] == pytest.approx(plain[name][key], rel=1e-6, abs=1e-9), key
        for key in ("velocity_divergence", "limit_distance", "limit_error"):
            if plain[name][key] is not None:
                assert fast[name][key] == pytest.approx(plain[name][key], rel=1e-3, abs=1e-7), key
        for key, value in plain[name]["diagnostics"].items():
            assert fast[name]["diagnostics"][key] == pytest.approx(value, rel=1e-3, abs=1e-9), key
