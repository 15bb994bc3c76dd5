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


class Shown:
    """Tags of a piece of HTML, the texts of its cells, and what its pictures are."""

    def __init__(self, text):
        self.tags = re.findall(r"<([a-z]+)", text)
        self.sources = re.findall(r'<img [^>]*src="([^"]+)"', text)
        cells = re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", text, re.DOTALL)
        self.cells = [html.unescape(re.sub(r"<[^>]+>", "", cell)) for cell in cells]


def outcome(name, v1=0.5, v2=0.25, **more):
    return Outcome(name, (v1, v2), (1.5, 1.75), ("S1", "S4"), **more)


PLAIN = Collision.from_ratios(1, 1, 1, 1)


@pytest.fixture(scope="module")
def two_balls():
    collision = Collision.two_balls(m1=2.0, m2=3.0, k1=1e8, k2=4e9, e1=0.9, e2=0.7, v0=-4.0)
    return collision, compare(collision, ["kelvin-voigt"])


def test_the_model_is_added_and_d_is_what_a_hand_computation_gives(two_balls):
    collision, compared = two_balls
    assert list(compared.statuses.items()) == [("state-transition", "ok"), ("kelvin-voigt", "ok")]
    model, other = (compared.outcomes[name] for name in ("state-transition", "kelvin-voigt"))
    alone = solve(collision, stiffness_ratio_cutoff="exact")
    assert compared.velocities["state-transition"] == (alone.v1, alone.v2)
    assert compared.states["state-transition"] == alone.states
    by_hand = math.sqrt(
        (2.0 * (other.v1 - model.v1) ** 2 + 3.0 * (other.v2 - model.v2) ** 2) / (2.0 * 4.0**2)
    )
    assert compared.divergences == {"state-transition": 0, "kelvin-voigt": pytest.approx(by_hand, rel=1e-12)}
    assert by_hand > 0.01


def test_a_notebook_shows_a_table_and_a_picture(two_balls):
    _, compared = two_balls
    shown = Shown(compared._repr_html_())
    assert shown.tags.count("table") == shown.tags.count("img") == 1
    assert "kelvin-voigt" in shown.cells
    assert f"{compared.outcomes['kelvin-voigt'].v1 / 4:.6f}" in shown.cells
    (source,) = shown.sources
    assert base64.b64decode(source.removeprefix("data:image/png;base64,")).startswith(b"\x89PNG")


def test_a_column_has_d_velocities_paths_and_a_picture():
    column = Collision((1.0, 2.0, 1.0), (1e8, 2e8), (0.9, 0.8), (-3.0, 0.0, 0.0))
    compared = compare(column, ["kelvin-voigt"])
    model, other = (compared.velocities[name] for name in ("state-transition", "kelvin-voigt"))
    assert model == pytest.approx(solved(column).velocities, abs=1e-15)
    squares = sum(m * (b - a) ** 2 for m, a, b in zip(column.masses, model, other, strict=True))
    assert compared.divergences["kelvin-voigt"] == pytest.approx(math.sqrt(squares / 9), rel=1e-12)
    assert compared.states["state-transition"][-1] == "-"
    shown = Shown(compared._repr_html_())
    assert f"{model[2] / 3:.6f}" in shown.cells
    assert len(shown.sources) == 1
    assert "v3" in str(compared)
    hertz = compare(replace(column, exponent=1.5), ["state-transition"]).velocities["state-transition"]
    assert hertz == pytest.approx(solved(column, exponent=1.5).velocities, abs=1e-12)
    assert hertz != pytest.approx(model, abs=1e-3)


def test_who_refuses_has_a_status_and_no_d():
    compared = compare(Collision.from_ratios(40, 1, 0.0, 0.5), ["kelvin-voigt"])
    assert compared.statuses["kelvin-voigt"] == "unrepresentable"
    assert compared.divergences["kelvin-voigt"] is None
    assert compared.outcomes["kelvin-voigt"].reason in " ".join(str(compared).split())


def test_hostile_names_and_reasons_stay_text():
    collision = Collision.from_ratios(1.0, 1.0, 0.9, 0.9)
    failed = Outcome.failure(HOSTILE, PLAIN, "crashed", HOSTILE)
    outcomes = {"state-transition": solve(collision), HOSTILE: failed, HOSTILE + "2": outcome(HOSTILE + "2")}
    compared = Compared(collision, outcomes)
    shown = Shown(compared._repr_html_())
    assert not {"script", "strong", "img"} & set(shown.tags)
    assert HOSTILE in shown.cells
    assert HOSTILE in str(compared)


def test_without_any_result_there_is_a_table_and_no_picture():
    collision = Collision.from_ratios(1.0, 1.0, 0.9, 0.9)
    compared = Compared(
        collision, {"state-transition": Outcome.failure("state-transition", collision, "timeout", "late")}
    )
    assert "img" not in Shown(compared._repr_html_()).tags
    with pytest.raises(ValueError, match="no solver has a result"):
        compared.plot()


def test_what_is_illegal_is_named():
    for problem, options, error, says in (
        ((1, 2), {}, TypeError, "was given tuple; legal: a Collision"),
        (Collision.from_ratios(1, 1, 1, 1), {"solvers": ["newton"]}, ValueError, "'newton' is not a solver"),
        (Collision.from_ratios(1, 1, 1, 1), {"timeout": 0}, ValueError, "legal: greater than 0"),
    ):
        with pytest.raises(error, match=says):
            compare(problem, **options)


def test_outcomes_show_themselves_and_any_text_stays_text():
    cells = Shown(outcome("mujoco")._repr_html_()).cells
    assert cells[:2] == ["status", "ok"]
    assert cells[cells.index("v1 (m/s)") + 1] == "0.5"
    cells = Shown(Outcome("mujoco", (0.1, -0.2), (1.5,), ("1", "-"))._repr_html_()).cells
    assert cells[cells.index("v2 (m/s)") + 1] == "-0.2"
    failed = Outcome.failure(HOSTILE, PLAIN, "crashed", HOSTILE), Outcome(HOSTILE, (), (), reason=HOSTILE)
    for hostile in failed:
        shown = Shown(hostile._repr_html_())
        assert set(shown.tags) == {"table", "caption", "tbody", "tr", "th", "td"}
        assert HOSTILE in shown.cells
