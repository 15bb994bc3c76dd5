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
