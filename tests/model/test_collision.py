"""Illegal input is refused with field, value and legal range, in single collisions and in batches; limits are legal."""

import math
import re
from itertools import product

import numpy as np
import pytest

from impact_xval.model import Collision, Outcome, solve, solve_batch

TWO = {"m1": 1.0, "m2": 1.0, "k1": 1.0, "k2": 1.0, "e1": 0.5, "e2": 0.5, "v0": -1.0}
RATIOS = {"stiffness_ratio": 1.0, "mass_ratio": 1.0, "e1": 0.5, "e2": 0.5}
LINE = {"masses": (1, 2, 3), "stiffnesses": (1, 1), "restitutions": (0.9, 1), "velocities": (-1, 0, 0)}


def refuses(says, call, **given):
    """Assert that a call raises a ValueError whose message is one line and matches `says`."""
    with pytest.raises(ValueError, match=says) as caught:
        call(**given)
    assert "\n" not in str(caught.value)


def test_an_illegal_number_of_two_balls_is_refused_by_field_value_and_range():
    for fields, values, legal in (
        (("m1", "m2"), (0.0, -1.0, math.inf), "a finite number > 0"),
        (("k1", "k2"), (-1.0, -math.inf), "from 0 to inf"),
        (("e1", "e2"), (-0.01, 1.01, math.inf), "from 0 to 1"),
        (("v0",), (0.0, 1.0, -math.inf), "a finite number < 0"),
        (TWO, (math.nan,), "not a number"),
    ):
        for field, value in product(fields, values):
            refuses(f"^{field} = {value}.*{legal}.*$", Collision.two_balls, **TWO | {field: value})


def test_an_illegal_ratio_is_named_alike_by_a_collision_and_by_a_batch():
    for field, value, legal in (
        ("stiffness_ratio", -1.0, r"from 0 to inf \(k2/k1\)"),
        ("stiffness_ratio", math.nan, "from 0 to inf"),
        ("mass_ratio", 0.0, r"a finite number > 0 \(m2/m1\)"),
        ("mass_ratio", math.inf, "a finite number > 0"),
        ("e1", 1.5, "from 0 to 1"),
        ("e2", math.nan, "from 0 to 1"),
    ):
        says = f"{field} = {value}.*{legal}"
        refuses(says, solve_batch, **RATIOS | {field: [RATIOS[field], value, -2.0]})
        if not math.isnan(value):
            refuses(says, Collision.from_ratios, **RATIOS | {field: value})
    for both in (0.0, math.inf):
        refuses("k2/k1 from 0 to inf, not 0/0", Collision.two_balls, **TWO | {"k1": both, "k2": both})
    refuses("mass ratio", Collision.two_balls, **TWO | {"m1": 1e-200, "m2": 1e200})


def test_an_illegal_line_of_balls_is_refused_by_field_value_and_range():
    for field, value, says in (
        ("masses", (1, 0, 3), r"masses\[2\] = 0.0; legal: finite numbers > 0 \(kg\)"),
        ("masses", (1, math.inf, 3), r"masses\[2\] = inf; legal: finite"),
        ("masses", (1, math.nan, 3), r"masses\[2\] = nan: not a number"),
        ("masses", (), "masses: 0 balls; legal: from 1 to 1000"),
        ("masses", (1,) * 1001, "masses: 1001 balls; legal: from 1 to 1000"),
        ("stiffnesses", (1, -1), r"stiffnesses\[2\] = -1.0; legal: finite numbers > 0 \(N/m\)"),
        ("stiffnesses", (1, 1, 1), "stiffnesses: 3 values; legal: 2, for 3 balls without a table"),
        ("table", True, "stiffnesses: 2 values; legal: 3, for 3 balls on a table"),
        ("restitutions", (0.9, 1.1), r"restitutions\[2\] = 1.1; legal: from 0 to 1"),
        ("velocities", (0, 0), "velocities: 2 values; legal: 3"),
        ("velocities", (1, 0, 0), r"\(1.0, 0.0, 0.0\): nothing meets; legal: a ball is slower"),
        ("exponent", 0.5, r"exponent = 0\.5; legal: from 1"),
        ("gaps", (0, -1), r"gaps\[2\] = -1\.0; legal: finite numbers >= 0"),
        ("gaps", (0,), "gaps: 1 values; legal: 2, for 3 balls without a table"),
    ):
        refuses(says, Collision, **LINE | {field: value})


def test_an_illegal_way_to_solve_is_refused_by_name():
    refuses("a chain on a table has no reverse", Collision.from_ratios(1, 1, 1, 1).reversed)
    says = "law = 'newton'; legal: jia-mason-erdmann, liu-zhao-brogliato"
    refuses(says, solve, collision=Collision(**LINE), law="newton")
    refuses(says, solve_batch, **RATIOS, law="newton")
    for cutoff in (1.0, -5.0, math.nan):
        says = f"stiffness_ratio_cutoff = {cutoff}.*legal: greater than 1"
        refuses(says, solve_batch, **RATIOS, stiffness_ratio_cutoff=cutoff)


def test_limits_are_legal():
    for k1, k2, ratio in ((0.0, 1.0, math.inf), (math.inf, 1.0, 0.0)):
        assert Collision.two_balls(**TWO | {"k1": k1, "k2": k2}).stiffness_ratio == ratio
    assert Collision.from_ratios(math.inf, 2, 0, 1).stiffness_ratio == math.inf
    assert set(solve_batch([0, math.inf], [[0.5], [2.0]], 0, [[0], [1]]).statuses.ravel()) == {"closed-form"}


def test_the_arrays_of_a_batch_are_broadcast_and_an_empty_batch_is_legal():
    batch = solve_batch([[1], [2]], 3, [0.4, 0.5, 0.6], 0.9)
    assert batch.v1.shape == (2, 3)
    assert batch.v1[1, 2] == solve_batch(2, 3, 0.6, 0.9).v1
    assert np.shape(solve_batch([], 1, 1, 1).v1) == (0,)


def test_an_illegal_outcome_is_refused_when_it_is_made():
    for fields, says in (
        ({"status": "fine"}, r"status = 'fine'; legal: ok, closed-form, .*crashed"),
        ({"velocities": (0.1, math.nan)}, r"velocities\[2\] = nan; legal with the status 'ok': finite"),
        (
            {"impulses": (math.inf, 0.0), "status": "closed-form"},
            r"impulses\[1\] = inf; legal with .* 'closed-form'",
        ),
        ({"impulses": (1.0, 2.0, 3.0)}, "impulses: 3 values for 2 balls; legal: 1 or 2"),
        *(
            ({"states": ("S1", state)}, f"states: {re.escape(repr(state))}; legal: S1 to S4, .* '-'")
            for state in ("<script>", "S1\x1b[2J", "S5", "0", "1+", "1 + 2", "S1\n", "")
        ),
        ({"status": "timeout"}, "reason = ''; legal with the status 'timeout': why"),
    ):
        refuses(says, Outcome, **{"solver": "x", "velocities": (0.1, 0.2), "impulses": (1.0, 2.0)} | fields)
    for states in ((), ("S1", "S4"), ("1+3", "12", "-")):
        assert Outcome("x", (0.1, 0.2), (1.0,), states).states == states
    unfinished = Outcome("x", (math.nan, 0.2), (1.0,), status="unconverged", reason="too few steps")
    assert math.isnan(unfinished.v1)
