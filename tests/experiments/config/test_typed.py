"""One collision as it is typed: what is legal is tested where configurations are, and by the explorer."""

import math

import pytest

from impact_xval.experiments.config.typed import asked

CELL = {"e1": "0.9", "e2": "0.7", "v0": "-3"}


def test_si_units_and_ratios_are_one_collision():
    plain, _, _ = asked(CELL | {"stiffness_ratio": "40", "mass_ratio": str(2 / math.sqrt(3))})
    scaled, _, _ = asked(CELL | {"m1": "0.5", "m2": str(1 / math.sqrt(3)), "k1": "1e6", "k2": "4e7"})
    assert scaled.masses == pytest.approx((0.5, 1 / math.sqrt(3)))
    assert scaled.stiffnesses == pytest.approx((1e6, 4e7))
    for same in ("stiffness_ratio", "mass_ratio", "restitutions", "velocities"):
        assert getattr(scaled, same) == pytest.approx(getattr(plain, same), rel=1e-15)
