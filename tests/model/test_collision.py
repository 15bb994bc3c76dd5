"""Illegal input is refused by name, value and legal range."""

import math

import pytest

from impact_xval.model import Collision, solve_batch

GOOD = {"m1": 1.0, "m2": 1.0, "k1": 1.0, "k2": 1.0, "e1": 0.5, "e2": 0.5, "v0": -1.0}


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        *[(m, v, "finite number > 0") for m in ("m1", "m2") for v in (0.0, -1.0, math.inf)],
        *[(k, v, "from 0 to inf") for k in ("k1", "k2") for v in (-1.0, -math.inf)],
        *[(e, v, "from 0 to 1") for e in ("e1", "e2") for v in (-0.01, 1.01, math.inf)],
        *[("v0", v, "finite number < 0") for v in (0.0, 1.0, -math.inf)],
        *[(f, v, "not a number") for f in GOOD for v in (math.nan, "1", None, True, [1.0])],
    ],
)
def test_illegal_value(field, value, message):
    with pytest.raises(ValueError, match=message) as caught:
        Collision(**(GOOD | {field: value}))
    assert str(caught.value).startswith(f"{field} = ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("both", [0.0, math.inf])
def test_undefined_stiffness_ratio(both):
    with pytest.raises(ValueError, match="k2/k1 from 0 to inf, not 0/0"):
        Collision(**(GOOD | {"k1": both, "k2": both}))


def test_mass_ratio_beyond_double_precision():
    with pytest.raises(ValueError, match="mass ratio"):
        Collision(**(GOOD | {"m1": 1e-200, "m2": 1e200}))


@pytest.mark.parametrize(
    ("field", "value"), [("stiffness_ratio", -1.0), ("mass_ratio", 0.0), ("mass_ratio", math.inf)]
)
def test_illegal_ratio(field, value):
    ratios = {"stiffness_ratio": 1.0, "mass_ratio": 1.0, "e1": 0.5, "e2": 0.5}
    with pytest.raises(ValueError, match=f"{field} = {value}; legal"):
        Collision.from_ratios(**(ratios | {field: value}))
    with pytest.raises(ValueError, match=f"{field} = {value}; legal"):
        solve_batch(**(ratios | {field: [1.0, value]}))


def test_limits_are_legal():
    assert Collision(**(GOOD | {"k1": 0.0})).stiffness_ratio == math.inf
    assert Collision(**(GOOD | {"k1": math.inf})).stiffness_ratio == 0
    assert Collision.from_ratios(math.inf, 2, 0, 1).stiffness_ratio == math.inf
    assert Collision(**(GOOD | {"m1": 3.0, "m2": 6.0})).reduced_mass == pytest.approx(2.0)
    # m1/m2 beyond double precision: the lighter ball alone
    assert Collision(**(GOOD | {"m1": 1.0, "m2": 5e-324})).reduced_mass == 5e-324


def test_collisions_are_values():
    assert Collision(**GOOD) == Collision(**GOOD)
    with pytest.raises(AttributeError):
        Collision(**GOOD).m1 = 2.0
