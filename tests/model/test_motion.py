"""The model's own cosine and sine against the library's, in the angles' whole range."""

import math

import numpy as np
import pytest

from impact_xval.model.motion import LARGEST_ANGLE, cos_sin


@pytest.mark.parametrize("largest", [1e-8, 1.0, 4.0, 100.0, 0.999 * LARGEST_ANGLE, 1e9])
def test_against_the_library(largest):
    for x in np.random.default_rng(1).uniform(0, largest, 5000):
        c, s = cos_sin(x)
        assert abs(c - math.cos(x)) < 4e-16
        assert abs(s - math.sin(x)) < 4e-16


def test_near_multiples_of_half_pi():
    for n in range(1, 2000):
        x = n * math.pi / 2
        for y in (math.nextafter(x, 0), x, math.nextafter(x, math.inf)):
            c, s = cos_sin(y)
            assert abs(c - math.cos(y)) < 4e-16
            assert abs(s - math.sin(y)) < 4e-16


def test_zero_is_exact():
    assert cos_sin(0.0) == (1.0, 0.0)
