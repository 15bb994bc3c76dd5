"""What the figures show of whom."""

import dataclasses

import numpy as np
import pytest

from impact_xval.experiments.hypothesis import figures, page
from impact_xval.experiments.hypothesis.cases import BY_KEY, Point
from impact_xval.experiments.hypothesis.config import parse
from impact_xval.experiments.hypothesis.mechanism import Motion, count_branches
from impact_xval.experiments.hypothesis.run import Results, ratios_of
from impact_xval.experiments.hypothesis.solvers import under_test
from impact_xval.experiments.hypothesis.verdicts import Series

NAMES = ("state-transition", "liu-zhao-brogliato", "bistiffness", "mujoco")


def moving(joined):
    time = np.linspace(0, 1, 5)
    return Motion(time, np.cos(time), np.sin(time), np.ones(5, bool), joined)


def results(motions):
    config = parse({"solvers": list(NAMES)}, "test")
    case = BY_KEY["infinity"]
    nothing = np.zeros(0)
    series = [Series(under_test(name, 100), case, (), nothing, None) for name in NAMES]
    empty = {field.name: [] for field in dataclasses.fields(Results)}
    return Results(**empty | {"config": config, "series": series, "motions": motions})


def lines(motions):
    """Lines of the separation towards k2/k1 → infinity."""
    figure = figures._relative_motion(results(motions))
    return figure.axes[5].lines


def test_engines_and_nobody_else_are_dashed():
    drawn = lines({(name, "infinity"): moving(None) for name in NAMES})
    assert [line.get_linestyle() for line in drawn] == ["-", "-", "-", "--"]


@pytest.mark.parametrize("joined", [0, 3])
def test_a_dot_says_where_the_pair_is_joined_at_the_first_instant_too(joined):
    curve, dot = lines({("bistiffness", "infinity"): moving(joined)})
    assert dot.get_marker() == "o"
    assert dot.get_xydata().tolist() == [curve.get_xydata()[joined].tolist()]


def test_no_dot_where_the_pair_is_never_joined():
    assert len(lines({("bistiffness", "infinity"): moving(None)})) == 1


#: At e1 = 1: a B2 that makes one end of compression or two, and one that makes two or three.
HEAVY, LIGHT = Point(0.3, 1.0, 0.7), Point(0.08, 1.0, 0.7)


def without_limit(*points):
    found, model, x = results({}), under_test("state-transition", 100), np.logspace(4, 5, 9)
    case = BY_KEY["zero-early"]
    series = Series(model, case, points, x, model.solve(*ratios_of(case, points, x)))
    return dataclasses.replace(found, series=[series], branches=[count_branches(p, 4) for p in points])


def test_a_light_b2_is_described_as_it_is_in_whatever_order_the_points_are_given():
    first, second = (page._no_limit(without_limit(*points)) for points in ((HEAVY, LIGHT), (LIGHT, HEAVY)))
    assert first == second
    assert first["light"]
    assert not page._no_limit(without_limit(HEAVY))["light"]


@pytest.mark.parametrize(("point", "ends"), [(HEAVY, (1, 2)), (LIGHT, (2, 3))])
def test_the_lines_without_a_limit_are_where_the_outcomes_lie(point, ends):
    found = without_limit(point)
    figure = figures._no_limit(found)
    outcomes, *levels = (line.get_ydata() for line in figure.axes[0].lines)
    assert [level[0] for level in levels] == pytest.approx(
        [0.7**n / np.sqrt(1 + point.mass_ratio) for n in ends]
    )
    nearest = np.min([np.abs(outcomes - level[0]) for level in levels], axis=0)
    assert nearest.max() < 5e-3
    assert page._no_limit(found)["drawn"].more_ends + 1 == ends[0]
