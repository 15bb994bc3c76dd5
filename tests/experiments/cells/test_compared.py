"""What `compare` gives, and what a notebook shows of it: numbers by hand, any text stays text."""

import base64
import html
import math
import re
from dataclasses import replace

import pytest

from impact_xval import Collision, compare, solve
from impact_xval.experiments.cells.compared import Compared
from impact_xval.model.collision import Outcome
from tests.model.columns import solved

HOSTILE = "<script>alert('&')</script> | **bold** <img src=x onerror=alert(1)>"
PLAIN = Collision.from_ratios(1.0, 1.0, 0.9, 0.9)
PNG = 'src="data:image/png;base64,'


def cells_of(text):
    """Texts of the cells of the tables of a piece of HTML."""
    cells = re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", text, re.DOTALL)
    return [html.unescape(re.sub(r"<[^>]+>", "", cell)) for cell in cells]


def divergence(problem, model, other):
    """D by hand."""
    squares = sum(
        m * (b - a) ** 2 for m, a, b in zip(problem.masses, model.velocities, other.velocities, strict=True)
    )
    return math.sqrt(squares / sum(m * v**2 for m, v in zip(problem.masses, problem.velocities, strict=True)))


def test_the_model_is_added_and_d_is_what_a_hand_computation_gives():
    collision = Collision.two_balls(m1=2.0, m2=3.0, k1=1e8, k2=4e9, e1=0.9, e2=0.7, v0=-4.0)
    compared = compare(collision, ["kelvin-voigt"])
    model, other = compared.outcomes.values()
    alone = solve(collision, stiffness_ratio_cutoff="exact")
    assert (model.velocities, model.states) == (alone.velocities, alone.states)
    by_hand = divergence(collision, model, other)
    assert compared.divergences == {"state-transition": 0, "kelvin-voigt": pytest.approx(by_hand, rel=1e-12)}
    assert by_hand > 0.01
    shown = compared._repr_html_()
    assert shown.count("<table") == shown.count("<img") == 1
    assert {"kelvin-voigt", f"{other.v1 / 4:.6f}"} < {*cells_of(shown)}
    assert base64.b64decode(shown.split(PNG)[1].split('"')[0]).startswith(b"\x89PNG")


def test_a_column_has_d_velocities_paths_and_a_picture():
    column = Collision((1.0, 2.0, 1.0), (1e8, 2e8), (0.9, 0.8), (-3.0, 0.0, 0.0))
    compared = compare(column, ["kelvin-voigt"])
    model, other = compared.outcomes.values()
    assert model.velocities == pytest.approx(solved(column).velocities, abs=1e-14)
    hertz = compare(replace(column, exponent=1.5), "state-transition").outcomes["state-transition"].velocities
    assert hertz == pytest.approx(solved(column, exponent=1.5).velocities, abs=1e-12)
    assert hertz != pytest.approx(model.velocities, abs=1e-3)
    assert compared.divergences["kelvin-voigt"] == pytest.approx(divergence(column, model, other), rel=1e-12)
    assert model.path.velocities[-1] == pytest.approx(model.velocities)
    assert f"{model.velocities[2] / 3:.6f}" in cells_of(compared._repr_html_())
    assert PNG in compared._repr_html_()
    assert "v3" in str(compared)


def test_hostile_names_and_reasons_stay_text_and_without_a_path_there_is_no_picture():
    failed = Outcome.failure(HOSTILE, PLAIN, "crashed", HOSTILE)
    answered = Outcome(HOSTILE + "2", (0.5, 0.25), (1.5, 1.75), ("S1", "S4"))
    compared = Compared(PLAIN, {"state-transition": solve(PLAIN), HOSTILE: failed, answered.solver: answered})
    assert compared.divergences[HOSTILE] is None
    shown = compared._repr_html_()
    assert not {"script", "strong", "img"} & {*re.findall(r"<([a-z]+)", shown)}
    assert HOSTILE in cells_of(shown)
    assert HOSTILE in str(compared)
    assert "mujoco-naive: damping 1 is " in str(compare(PLAIN, ["mujoco-naive"]))  # not what was asked for
    with pytest.raises(ValueError, match="no solver has a path to draw"):
        compared.plot()


def test_what_is_illegal_is_named():
    for problem, options, error, says in (
        ((1, 2), {}, TypeError, "was given tuple; legal: a Collision"),
        (PLAIN, {"solvers": ["bullet"]}, ValueError, "'bullet' is not a solver"),
        (PLAIN, {"timeout": 0}, ValueError, "legal: greater than 0"),
    ):
        with pytest.raises(error, match=says):
            compare(problem, **options)
