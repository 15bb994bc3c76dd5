"""Taylor polynomials of the motion against the matrix exponential, and the rate at which their remainder falls."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from impact_xval.compliant_baselines.references.taylor import (
    ORDER,
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


def test_over_the_longest_step_the_polynomial_is_the_motion():
    pushes = 0.3, -0.7
    for column, state in columns(60, 2):
        h = min(longest_step(*column), 10.0)
        table = table_of(state)
        expand(table, ORDER, h, *column, *pushes)
        for x in (0.0, 0.25, 0.7, 1.0):
            exact = expm(system(*column, *pushes) * (x * h)) @ [*state, 1]
            size = np.abs(exact[:4]).max() + np.abs(state).max() * (1 + h)
            np.testing.assert_allclose(evaluate(table, ORDER, x), exact[:4], rtol=0, atol=2e-14 * size)


def test_the_remainder_falls_with_the_power_of_the_step_after_its_degree():
    column, state = (1.3, 1.0, 4.0, 0.3, 0.2), np.array([0.4, 0.8, -0.2, 0.5])
    for degree in (3, 5):
        steps = 0.25 * longest_step(*column) / 2.0 ** np.arange(5)
        errors = []
        for h in steps:
            table = table_of(state)
            expand(table, degree, h, *column, 0.0, 0.0)
            exact = (expm(system(*column, 0, 0) * h) @ [*state, 1])[:4]
            errors.append(np.abs(evaluate(table, degree, 1.0) - exact).max())
        assert errors[-1] > 1e-14  # else the fit would be one of rounding
        slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert slope == pytest.approx(degree + 1, abs=0.1)


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


def test_the_remainder_of_the_product_law_falls_at_its_rate():
    for degree in (3, 4, 6):
        steps = 0.2 / 2.0 ** np.arange(4 if degree < 6 else 3)
        errors = []
        for h in steps:
            table = table_of(STATE)
            expand_product(table, degree, h, *PRODUCT)
            errors.append(np.abs(evaluate(table, degree, 1.0) - product_motion(STATE, h, *PRODUCT)).max())
        assert errors[-1] > 1e-12
        slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert slope == pytest.approx(degree + 1, abs=0.15)


def test_the_product_law_holds_as_far_as_it_is_trusted():
    for h in (0.2, 1.0, 4.0):
        table = table_of(STATE)
        expand_product(table, ORDER, h, *PRODUCT)
        x = trusted(table, ORDER)
        assert 0 < x <= 1
        assert (x == 1) == (h == 0.2)
        np.testing.assert_allclose(
            evaluate(table, ORDER, x), product_motion(STATE, x * h, *PRODUCT), rtol=0, atol=2e-13
        )
