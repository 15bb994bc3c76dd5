"""The certified first root of a polynomial is compared with all of its roots, from numpy."""

import numpy as np
import pytest

from impact_xval.model.chain import roots
from tests.model.conftest import from_python

first_root = from_python(roots.first_root)


def call(coefficients, sign=1.0, start=None, limit=1.0):
    row = np.array(coefficients, float)
    return first_root(row, sign, sign * row[0] if start is None else start, row.size - 1, limit)


def test_a_close_pair_of_roots_is_not_stepped_over():
    # (t - a)^2 - h^2 is positive at both ends of the unit interval
    a = 0.637
    for half_gap in (1e-2, 1e-4, 1e-6):
        assert call([a * a - half_gap**2, -2 * a, 1.0]) == pytest.approx(a - half_gap, abs=1e-9)
        assert call([a * a + half_gap**2, -2 * a, 1.0]) == np.inf


@pytest.mark.parametrize("roots", [(0.25, 0.4), (-0.1, 0.125, 0.2), (-0.1, 0.5, 0.8)])
def test_a_root_where_a_bracket_begins(roots):
    """A root at the point where a bracketing interval begins is found to rounding, next to other roots.

    From such a start the root of the parabola and Newton's steps leave the bracket.
    """
    coefficients = np.polynomial.polynomial.polyfromroots(roots)
    assert call(coefficients * np.sign(coefficients[0])) == pytest.approx(roots[-2], abs=1e-14)


def test_the_zero_a_segment_starts_from_is_not_found_again():
    for order in (1, 2, 3):  # the polynomial t^order (t - 1/2)(t - 3/4)
        coefficients = np.concatenate([np.zeros(order), [0.375, -1.25, 1.0]])
        assert call(coefficients) == pytest.approx(0.5, abs=1e-14)
        assert call(-coefficients) == 0.0  # a polynomial that falls from its zero at the start fires at once
    # a value that is given for the start replaces the rounded first coefficient
    assert call([-1e-18, 1.0, -2.0], start=0.0) == pytest.approx(0.5, abs=1e-14)
    assert call([0.0, 0.0, 0.0]) == np.inf


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_random_polynomials_of_full_degree(sign):
    rng = np.random.default_rng(5)
    n_with = 0
    for _ in range(300):
        coefficients = rng.normal(size=23) / np.cumprod(np.maximum(1, np.arange(23)) / 2.0)
        coefficients[0] = abs(coefficients[0])
        roots = np.roots(coefficients[::-1])
        real = roots[np.abs(roots.imag) < 1e-9].real
        first = min(real[(real > 1e-9) & (real <= 1)], default=np.inf)
        n_with += first < np.inf
        for limit in (0.5, 1.0):
            within = first if first <= limit else np.inf
            assert call(sign * coefficients, sign, limit=limit) == pytest.approx(within, abs=1e-9)
    assert n_with > 50
