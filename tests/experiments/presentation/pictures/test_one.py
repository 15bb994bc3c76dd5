"""What is drawn of one collision against printed digits."""

import math

import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.presentation.pictures.curves import draw_collision, drawn_paths
from impact_xval.model import Collision, Outcome, solve

M2 = 2 / math.sqrt(3)
#: tests/published/test_printed_values.py has where they are from.
V1, V2 = 0.88981120733190, 0.00016910787873


def test_curves_end_at_the_published_numbers_whatever_the_units():
    collision = Collision.two_balls(m1=3.0, m2=3.0 * M2, k1=1e7, k2=40e7, e1=0.9, e2=0.7, v0=-2.0)
    outcomes = {
        "state-transition": solve(collision, path=True),
        "kelvin-voigt": get_solver("kelvin-voigt").solve(collision, Settings(record_path=True)),
        "mujoco": Outcome.failure("mujoco", collision, "timeout", "too long"),
    }
    figure = draw_collision(collision, drawn_paths(collision, outcomes))
    curve, upper, lower = figure.axes
    ends = [1 + V1, 1 + V1 + M2 * V2]
    lines = {ax: [line for line in ax.lines if line.get_label() == "the model"] for ax in figure.axes}
    assert lines[curve][0].get_xydata()[-1] == pytest.approx(ends, abs=1e-11)
    for ax, start, end in ((upper, -1.0, V1), (lower, 0.0, V2)):
        (line,) = lines[ax]
        assert line.get_xydata()[0] == pytest.approx([0, start], abs=1e-12)
        assert line.get_xydata()[-1] == pytest.approx([sum(ends), end], abs=1e-11)
