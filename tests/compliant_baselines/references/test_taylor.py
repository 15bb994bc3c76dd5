"""Taylor polynomials of the motion against the matrix exponential, and the rate at which their remainder falls."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigvalsh, expm

from impact_xval.compliant_baselines.references.taylor import (
    ORDER,
    RADIUS,
    evaluate,
    expand,
    expand_product,
    longest_step,
    trusted,
)


def system(mu, k1, k2, c1, c2, push1, push2):
    """The linear equations of (p1, d1, q2, v2, 1), from forces on two masses."""
    rows = np.zeros((5, 5))
    F1, F2 = np.array([k1, c1, 0, 0, 0]), np.array([0, 0, k2, -c2, 0])
    rows[0, 1], rows[2, 3] = 1, -1
    acceleration1, acceleration2 = F1, (F2 - F1) / mu  # of B1 (m1 = 1, pushed up by contact 1) and of B2
    rows[1], rows[3] = acceleration2 - acceleration1, acceleration2
    rows[1, 4], rows[3, 4] = push1, push2
    return rows


def rate(mu, k1, k2, c1, c2):
    """Highest natural frequency plus highest eigenvalue of the damping, both per mass."""
    masses = np.diag([1, mu])
    pattern = [np.array([[1, -1], [-1, 1]]), np.diag([0, 1])]
    stiffness, damping = k1 * pattern[0] + k2 * pattern[1], c1 * pattern[0] + c2 * pattern[1]
    return math.sqrt(max(0, eigvalsh(stiffness, masses)[-1])) + eigvalsh(damping, masses)[-1]


def energy_norm(mu, k1, k2, y):
    p1, d1, q2, v2 = y
    return math.sqrt((v2 - d1) ** 2 + mu * v2 * v2 + k1 * p1 * p1 + k2 * q2 * q2)


def columns(n, seed):
    rng = np.random.default_rng(seed)
    for _ in range(n):
        mu, k1, k2, c1, c2 = 10 ** rng.uniform([-1, -2, -2, -2, -2], [1, 2, 2, 1, 1])
        on1, on2 = rng.integers(0, 2, 2)
        yield (mu, k1 * on1, k2 * on2, c1 * on1, c2 * on2), rng.uniform(-1, 1, 4)


def table_of(state):
    table = np.full((4, ORDER + 1), np.nan)
    table[:, 0] = state
    return table


def test_the_longest_step_is_the_radius_over_the_fastest_rate():
    for column, _ in columns(200, 1):
        fastest = rate(*column)
        expected = RADIUS / fastest if fastest > 0 else math.inf
        assert longest_step(*column) == pytest.approx(expected, rel=1e-12)


def test_over_the_longest_step_the_polynomial_is_the_motion():
    pushes = 0.3, -0.7
    for column, state in columns(100, 2):
        h = min(longest_step(*column), 10.0)
        table = table_of(state)
        expand(table, ORDER, h, *column, *pushes)
        for x in (0.0, 0.25, 0.7, 1.0):
            exact = expm(system(*column, *pushes) * (x * h)) @ [*state, 1]
            size = np.abs(exact[:4]).max() + np.abs(state).max() * (1 + h)
            np.testing.assert_allclose(evaluate(table, ORDER, x), exact[:4], rtol=0, atol=2e-14 * size)


@pytest.mark.parametrize("degree", [3, 5, 8])
def test_the_remainder_falls_with_the_power_of_the_step_after_its_degree(degree):
    column, state = (1.3, 1.0, 4.0, 0.3, 0.2), np.array([0.4, 0.8, -0.2, 0.5])
    steps = longest_step(*column) * (0.5 if degree == 8 else 0.25) / 2.0 ** np.arange(3 if degree == 8 else 5)
    errors = []
    for h in steps:
        table = table_of(state)
        expand(table, degree, h, *column, 0.0, 0.0)
        exact = (expm(system(*column, 0, 0) * h) @ [*state, 1])[:4]
        errors.append(np.abs(evaluate(table, degree, 1.0) - exact).max())
    assert errors[-1] > 1e-14  # else the fit would be one of rounding
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(degree + 1, abs=0.1)


def test_the_remainder_keeps_its_bound_at_every_degree():
    """(Lambda h)^n/n! of the state in the norm of energy, summed from the first term that is left out."""
    for column, state in columns(60, 3):
        mu, k1, k2, *_ = column
        if k1 == 0 or k2 == 0:
            continue  # the norm does not see a penetration without a spring
        h = longest_step(*column)
        exact = (expm(system(*column, 0, 0) * h) @ [*state, 1])[:4]
        start = energy_norm(mu, k1, k2, state)
        for degree in range(2, 14):
            table = table_of(state)
            expand(table, degree, h, *column, 0.0, 0.0)
            left_out = energy_norm(mu, k1, k2, np.array(evaluate(table, degree, 1.0)) - exact)
            bound = RADIUS ** (degree + 1) / math.factorial(degree + 1) / (1 - RADIUS / (degree + 2))
            assert left_out <= bound * start + 1e-13 * start


def product_motion(state, h, mu, k1, k2, a1, a2, r2, push1, push2):
    """Integrate the product law numerically: F_i = k_i p_i (1 + a_i p_i'), contact 2 without what carries m2 g."""

    def right(_t, y):
        p1, d1, q2, v2 = y
        F1 = k1 * p1 * (1 + a1 * d1)
        F2 = k2 * q2 - k2 * (q2 + r2) * a2 * v2
        return [d1, (F2 - F1) / mu - F1 + push1, -v2, (F2 - F1) / mu + push2]

    return solve_ivp(right, (0, h), state, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


PRODUCT = (1.3, 1.0, 4.0, 0.4, 0.3, 0.05, 0.0, -0.1)
STATE = np.array([0.4, 0.8, 0.3, -0.5])


@pytest.mark.parametrize("degree", [3, 4, 6])
def test_the_remainder_of_the_product_law_falls_at_its_rate(degree):
    steps = 0.2 / 2.0 ** np.arange(4 if degree < 6 else 3)
    errors = []
    for h in steps:
        table = table_of(STATE)
        expand_product(table, degree, h, *PRODUCT)
        errors.append(np.abs(evaluate(table, degree, 1.0) - product_motion(STATE, h, *PRODUCT)).max())
    assert errors[-1] > 1e-12
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(degree + 1, abs=0.15)


@pytest.mark.parametrize("h", [0.2, 1.0, 4.0])
def test_the_product_law_holds_as_far_as_it_is_trusted(h):
    table = table_of(STATE)
    expand_product(table, ORDER, h, *PRODUCT)
    x = trusted(table, ORDER)
    assert 0 < x <= 1
    assert (x == 1) == (h == 0.2)
    np.testing.assert_allclose(
        evaluate(table, ORDER, x), product_motion(STATE, x * h, *PRODUCT), rtol=0, atol=2e-13
    )


@pytest.mark.parametrize("ratio", [0.1, 0.5, 1.0, 3.0])
def test_trusted_is_where_the_last_two_terms_come_down_to_rounding(ratio):
    """Of a geometric series, whose terms are known."""
    terms = ratio ** np.arange(ORDER + 1)
    table = np.vstack([terms, 0 * terms, -5 * terms, 1e-30 * terms])
    x = trusted(table, ORDER)
    rounding = 2.0**-54 * terms[:7].max()
    last = terms[-2:] * x ** np.arange(ORDER - 1, ORDER + 1)
    assert last.max() <= rounding * (1 + 1e-12)
    assert x == 1 or last.max() == pytest.approx(rounding, rel=1e-12)
