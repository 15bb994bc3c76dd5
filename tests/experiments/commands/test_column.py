import json

import pytest

from impact_xval.compliant_baselines import registry
from impact_xval.experiments.commands.cli import main
from tests.experiments import faulty

pytestmark = pytest.mark.usefixtures("kernels")


def _json(capsys, *arguments):
    assert main(["solve", "--arrangement", "cradle", *arguments, "--json"]) == 0

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
    assert (engine["status"], engine["velocities"]) == ("unrepresentable", [None] * 5)
    assert "exponent = 1.5" in engine["reason"]


def test_gaps_are_refused_by_who_knows_none(capsys):
    names = ["state-transition", "bistiffness", "kelvin-voigt"]
    found = _json(capsys, "--balls", "3", "--gap", "2e-4", "--e", "1", *_asked(*names))
    model, *others = found.values()
    assert (model["status"], model["velocities"]) == ("unrepresentable", [None] * 3)
    assert "gaps of up to 0.0002 m: the model has no positions" in model["reason"]
    # While a pair is in contact a ball at rest moves by pi/2 sqrt(M/k) v0 = 1.1e-4 m: the balls meet one by one.
    for other in others:
        assert other["velocities"] == pytest.approx([0, 0, -1], abs=1e-12)
        assert other["D"] is None


def test_a_solver_that_dies_costs_its_own_row(capsys, monkeypatch):
    monkeypatch.setattr(registry, "get_solver", faulty.faulty)
    found = _json(capsys, "--e", str(faulty.ABORT), *_asked("mujoco", "state-transition"))
    assert [each["status"] for each in found.values()] == ["crashed", "ok"]
    assert found["mujoco"]["reason"] == "its process died: SIGABRT"
