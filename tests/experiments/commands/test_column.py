import json

import pytest

from impact_xval.experiments.commands.cli import main

pytestmark = pytest.mark.usefixtures("kernels")


def _solved(capsys, arguments, *solvers):
    asked = [word for name in solvers for word in ("--solver", name)]
    assert main(["solve", "--arrangement", "cradle", *arguments.split(), *asked, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_two_strike_and_about_two_leave(capsys):
    """Two Hertz balls that strike three: the first two of the far side leave with 1.14 and 0.80."""
    arguments = "--balls 5 --strike 2 --e 1 --exponent 1.5"
    model, law, engine = _solved(capsys, arguments, "state-transition", "kelvin-voigt", "mujoco")
    assert model["velocities"][:2:-1] == pytest.approx((-1.14, -0.80), abs=1e-2)
    assert law["velocities"] == pytest.approx(model["velocities"], abs=1e-9)
    assert (engine["status"], engine["velocities"]) == ("unrepresentable", [None] * 5)
    assert "exponent = 1.5" in engine["reason"]


def test_gaps_are_refused_by_who_knows_none(capsys):
    names = "state-transition", "bistiffness", "kelvin-voigt"
    model, *others = _solved(capsys, "--balls 3 --gap 2e-4 --e 1", *names)
    assert (model["status"], model["velocities"]) == ("unrepresentable", [None] * 3)
    assert "gaps of up to 0.0002 m: the model has no positions" in model["reason"]
    # While a pair is in contact a ball at rest moves by pi/2 sqrt(M/k) v0 = 1.1e-4 m: the balls meet one by one.
    for other in others:
        assert other["velocities"] == pytest.approx([0, 0, -1], abs=1e-12)
        assert other["D"] is None
