"""What `compare` gives, and what a notebook shows of it: numbers by hand, any text stays text."""

import base64
import re
from dataclasses import replace

import numpy as np
import pytest
from markupsafe import escape

from impact_xval import Collision, compare, solve
from impact_xval.experiments.cells.compared import Compared
from impact_xval.model.collision import Outcome

HOSTILE = "<script>alert('&')</script> | **bold** <img src=x onerror=alert(1)>"
PLAIN = Collision.from_ratios(1.0, 1.0, 0.9, 0.9)
PAIR = Collision.two_balls(m1=2.0, m2=3.0, k1=1e8, k2=4e9, e1=0.9, e2=0.7, v0=-4.0)
COLUMN = Collision((1.0, 2.0, 1.0), (1e8, 2e8), (0.9, 0.8), (-3.0, 0.0, 0.0))
HERTZ = replace(COLUMN, exponent=1.5)


@pytest.mark.parametrize(
    ("problem", "law"), [(PAIR, "kelvin-voigt"), (COLUMN, "kelvin-voigt"), (HERTZ, "hunt-crossley")]
)
def test_the_model_is_added_and_d_is_what_a_hand_computation_gives(problem, law):
    compared = compare(problem, [law])
    model, other = compared.outcomes.values()
    alone = solve(problem)
    assert (model.velocities, model.states) == (alone.velocities, alone.states)
    assert model.path.velocities[-1] == pytest.approx(model.velocities)
    masses, away = np.array(problem.masses), np.subtract(model.velocities, other.velocities)
    by_hand = np.sqrt(masses @ away**2 / (masses @ np.square(problem.velocities)))
    assert by_hand > 0.01
    assert compared.divergences == {"state-transition": 0, law: pytest.approx(by_hand, rel=1e-12)}
    shown = compared._repr_html_()
    assert shown.count("<table") == shown.count("<img") == 1
    for cell in (law, f"{other.v1 / -problem.velocities[0]:.6f}"):
        assert f">{cell}</td>" in shown
    picture = shown.split('src="data:image/png;base64,')[1].split('"')[0]
    assert base64.b64decode(picture).startswith(b"\x89PNG")
    assert f"v{len(masses)}" in str(compared)


def test_hostile_names_and_reasons_stay_text_and_without_a_path_there_is_no_picture():
    failed = Outcome.failure(HOSTILE, PLAIN, "crashed", HOSTILE)
    answered = Outcome(HOSTILE + "2", (0.5, 0.25), (1.5, 1.75), ("S1", "S4"))
    compared = Compared(PLAIN, {"state-transition": solve(PLAIN), HOSTILE: failed, answered.solver: answered})
    assert compared.divergences[HOSTILE] is None
    shown = compared._repr_html_()
    assert not {"script", "strong", "img"} & {*re.findall(r"<([a-z]+)", shown)}
    assert re.search(rf">{re.escape(escape(HOSTILE))}</t[dh]>", shown)
    assert HOSTILE in str(compared)
    assert "mujoco-naive: damping 1 is " in str(compare(PLAIN, ["mujoco-naive"]))  # not what was asked for
    with pytest.raises(ValueError, match="no solver has a path to draw"):
        compared.plot()


def test_what_is_illegal_is_named():
    for options, says in (({"solvers": ["bullet"]}, "is not a solver"), ({"timeout": 0}, "greater than 0")):
        with pytest.raises(ValueError, match=says):
            compare(PLAIN, **options)
