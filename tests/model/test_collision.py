"""Illegal input is refused by name, value and legal range, singly and in a batch; limits are legal."""

import math

import numpy as np
import pytest

from impact_xval.model import Collision, Outcome, solve_batch

GOOD = {"m1": 1.0, "m2": 1.0, "k1": 1.0, "k2": 1.0, "e1": 0.5, "e2": 0.5, "v0": -1.0}

RATIOS = {"stiffness_ratio": 1.0, "mass_ratio": 1.0, "e1": 0.5, "e2": 0.5}


def test_an_illegal_value_is_refused_in_one_line_that_names_field_value_and_range():
    cases = [
        *[(m, v, "a finite number > 0") for m in ("m1", "m2") for v in (0.0, -1.0, math.inf)],
        *[(k, v, "from 0 to inf") for k in ("k1", "k2") for v in (-1.0, -math.inf)],
        *[(e, v, "from 0 to 1") for e in ("e1", "e2") for v in (-0.01, 1.01, math.inf)],
        *[("v0", v, "a finite number < 0") for v in (0.0, 1.0, -math.inf)],
        *[(field, math.nan, "not a number") for field in GOOD],
    ]
    for field, value, legal in cases:
        with pytest.raises(ValueError, match=f"^{field} = {value}.*{legal}.*$") as caught:
            Collision.two_balls(**(GOOD | {field: value}))
        assert "\n" not in str(caught.value)


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
        with pytest.raises(ValueError, match=says):
            solve_batch(**(RATIOS | {field: [RATIOS[field], value, -2.0]}))
        if not math.isnan(value):
            with pytest.raises(ValueError, match=says):
                Collision.from_ratios(**(RATIOS | {field: value}))


def test_what_has_no_ratio_is_refused():
    for both in (0.0, math.inf):
        with pytest.raises(ValueError, match="k2/k1 from 0 to inf, not 0/0"):
            Collision.two_balls(**(GOOD | {"k1": both, "k2": both}))
    with pytest.raises(ValueError, match="mass ratio"):
        Collision.two_balls(**(GOOD | {"m1": 1e-200, "m2": 1e200}))


def test_limits_are_legal():
    assert Collision.two_balls(**(GOOD | {"k1": 0.0})).stiffness_ratio == math.inf
    assert Collision.two_balls(**(GOOD | {"k1": math.inf})).stiffness_ratio == 0
    assert Collision.from_ratios(math.inf, 2, 0, 1).stiffness_ratio == math.inf
    assert set(solve_batch([0, math.inf], [[0.5], [2.0]], 0, [[0], [1]]).statuses.ravel()) == {"limit"}


def test_the_arrays_of_a_batch_are_broadcast_and_an_empty_batch_is_legal():
    batch = solve_batch([[1], [2]], 3, [0.4, 0.5, 0.6], 0.9)
    assert batch.v1.shape == (2, 3)
    assert batch.v1[1, 2] == solve_batch(2, 3, 0.6, 0.9).v1
    assert np.shape(solve_batch([], 1, 1, 1).v1) == (0,)


def test_an_outcome_that_is_none_is_refused_where_it_is_made():
    for fields, says in (
        ({"status": "fine"}, r"status = 'fine'; legal: ok, limit, .*crashed"),
        ({"velocities": (0.1, math.nan)}, r"velocities\[2\] = nan; legal with the status 'ok': finite"),
        (
            {"impulses": (math.inf, 0.0), "status": "limit"},
            r"impulses\[1\] = inf; legal with the status 'limit'",
        ),
        ({"impulses": (1.0, 2.0, 3.0)}, "impulses: 3 values for 2 balls; legal: 1 or 2"),
        ({"status": "timeout"}, "reason = ''; legal with the status 'timeout': why"),
    ):
        with pytest.raises(ValueError, match=says):
            Outcome(**{"solver": "x", "velocities": (0.1, 0.2), "impulses": (1.0, 2.0)} | fields)
    unfinished = Outcome("x", (math.nan, 0.2), (1.0,), status="unconverged", reason="too few steps")
    assert math.isnan(unfinished.v1)
