"""What bodies are given combines to what was asked for, or there is nothing to give."""

import itertools
import math

import pytest

from impact_xval.compliant_baselines.practical.mixing import factors, means


@pytest.mark.parametrize(
    "wanted", [(0.9,), (0.9, 0.5), (0.5, 1.0), (0.8,) * 5, (0.6, 0.5, 0.6), (0.0, 0.0), (0, 0.7)]
)
def test_products_are_what_was_wanted(wanted):
    found = factors(wanted)
    assert found is not None
    assert all(0 <= f <= 1 for f in found)
    assert [a * b for a, b in itertools.pairwise(found)] == pytest.approx(list(wanted), rel=1e-12)


def test_of_two_contacts_the_lower_ball_has_one():
    assert factors((0.9, 0.7)) == pytest.approx((0.9, 1.0, 0.7))


@pytest.mark.parametrize("wanted", [(1.0, 0.1, 1.0), (1.0, 0.0, 1.0), (0.5, 1.0, 1.0, 0.5, 0.2, 1.0)])
def test_products_that_no_factors_have(wanted):
    # The ends need neighbours near 1, which the middle then does not allow.
    assert factors(wanted) is None


@pytest.mark.parametrize("ratio", [1e-3, 1.0, 1e3])
def test_means_of_two_contacts_share_as_the_softer_one_allows(ratio):
    found = means((1.0, ratio))
    lower = min(1.0, ratio)
    assert found == pytest.approx((2 - lower, lower, 2 * ratio - lower), rel=1e-12, abs=1e-12)


def test_means_within_bounds_only():
    assert means((1.0, 0.5), 1.0) == pytest.approx((1.0, 1.0, 0.0))
    assert means((1.0, 0.4), 1.0) is None
    assert means((1.0, 3.0, 1.0), math.inf) is None
