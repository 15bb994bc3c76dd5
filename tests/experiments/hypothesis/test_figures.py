"""What the figures show of whom."""

import dataclasses

import numpy as np
import pytest

from experiments.hypothesis import figures
from experiments.hypothesis.cases import BY_KEY
from experiments.hypothesis.config import parse
from experiments.hypothesis.mechanism import Motion
from experiments.hypothesis.run import Results
from experiments.hypothesis.series import Series
from experiments.hypothesis.subjects import subject

NAMES = ("state-transition", "liu-zhao-brogliato", "bistiffness", "mujoco")


def moving(joined):
    time = np.linspace(0, 1, 5)
    return Motion(time, np.cos(time), np.sin(time), np.ones(5, bool), joined)


def results(motions):
    config = parse({"solvers": list(NAMES)}, "test")
    case = BY_KEY["infinity"]
    nothing = np.zeros(0)
    series = [Series(subject(name, 100), case, (), nothing, None) for name in NAMES]
    empty = {field.name: [] for field in dataclasses.fields(Results)}
    return Results(**empty | {"config": config, "series": series, "motions": motions})


def lines(motions):
    """Lines of the separation towards k2/k1 → infinity."""
    figure, _ = figures._relative_motion(results(motions))
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
