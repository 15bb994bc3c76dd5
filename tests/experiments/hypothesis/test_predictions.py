"""The rigid ball-ball contact above the table, against integrations that know no closed form and no end of a force."""

import math
from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from impact_xval.experiments.hypothesis.cases import BY_KEY, Point, after_first_impact
from impact_xval.experiments.hypothesis.predictions import (
    NEARLY,
    TableContact,
    _Oscillator,
    predict,
    rigid_on_soft,
)

#: Damping ratios: under, just under, at, just over and over the critical one, up to that of e = 0.02.
ZETAS = (0.1, 0.6, 1 - 1e-3, 1 - 1e-7, 1 - NEARLY / 2, 1.0, 1 + 1e-12, 1 + 1e-3, 1.24, 2.0, 3.3)

#: Of the integrations.
TIGHT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14}


def force(zeta, mu, p, u):
    """F2 of a dashpot with k2 = 1: as its law says it, without an event."""
    return max(0.0, p + 2 * zeta * math.sqrt(mu) * u) if p >= 0 else 0.0


def integrated(mu, e1, v1, v2, zeta):
    """Velocities when the balls part, by impacts between integrations of three bodies with a force cut at zero."""
    x1 = x2 = 0.0
    for _ in range(1000):
        press = force(zeta, mu, -x2, -v2)
        if x1 - x2 <= 1e-13 and press > 0 and abs(v1 - v2) < 1e-7:
            v = (v1 + mu * v2) / (1 + mu)

            def pulls(_, y):
                return -y[0] - 2 * zeta * math.sqrt(mu) * y[1]

            pulls.terminal, pulls.direction = True, -1
            end = solve_ivp(
                lambda _, y: (y[1], force(zeta, mu, -y[0], -y[1]) / (1 + mu)),
                (0, 50),
                (x2, v),
                events=pulls,
                **TIGHT,
            )
            assert end.status == 1
            return end.y[1, -1], end.y[1, -1]

        def gap(_, y):
            return y[0] - y[2]

        gap.terminal, gap.direction = True, -1
        flight = solve_ivp(
            lambda _, y: (y[1], 0.0, y[3], force(zeta, mu, -y[2], -y[3]) / mu),
            (0, 50),
            (max(x1, x2 + 1e-15), v1, x2, v2),
            events=gap,
            max_step=0.02,
            **TIGHT,
        )
        x1, v1, x2, v2 = flight.y[:, -1]
        if flight.status == 0:
            assert v1 >= v2 >= 0
            return v1, v2
        impulse = mu / (1 + mu) * (1 + e1) * (v2 - v1)
        v1, v2 = v1 + impulse, v2 - impulse / mu
    raise AssertionError("not over")


def test_the_motion_on_a_dashpot_is_that_of_its_equation():
    for zeta, start in product(ZETAS, ((0.0, 1.3), (0.4, 0.7), (0.4, -0.02))):  # at touch, deeper, returning
        held_against_its_equation(zeta, start)


def held_against_its_equation(zeta, start):
    b, w = 1.7 * zeta, 1.7
    k, c = w * w, 2 * b  # per unit of mass

    def pulls(_, y):
        return k * y[0] + c * y[1]

    pulls.terminal, pulls.direction = True, -1
    found = solve_ivp(
        lambda _, y: (y[1], -c * y[1] - k * y[0]), (0, 20), start, events=pulls, dense_output=True, **TIGHT
    )
    spring = _Oscillator(*start, b, w)
    end = spring.zero_of(k, c)
    assert end == pytest.approx(found.t_events[0][0], rel=1e-8)
    times = np.linspace(0, end, 50)
    p, u = found.sol(times)
    moved, rate = np.transpose([spring.moved(t) for t in times])
    np.testing.assert_allclose(start[0] + moved, p, rtol=0, atol=1e-9)
    np.testing.assert_allclose(rate, u, rtol=0, atol=1e-9)
    assert (k * p + c * u).max() <= spring.most(k, c) * (1 + 1e-9)


def test_a_short_time_moves_by_as_much_as_a_series_says():
    """An impact under load comes after no time to speak of: p - p0 = u0 t - (2 b u0 + w^2 p0) t^2/2 + ..."""
    for zeta in ZETAS:
        p0, u0, t = 0.4, -0.02, 1e-6
        moved, _ = _Oscillator(p0, u0, zeta, 1.0).moved(t)
        assert moved == pytest.approx(u0 * t - 0.5 * (2 * zeta * u0 + p0) * t * t, rel=1e-9)


@pytest.mark.parametrize(("mu", "e1"), [(0.5, 0.9), (0.2, 0.5), (0.8, 1.0)])
def test_both_balls_end_where_an_integration_takes_them(mu, e1):
    for zeta in ZETAS:
        v1, v2 = after_first_impact(mu, e1)
        expected = integrated(mu, e1, v1, v2, zeta)
        found = rigid_on_soft(mu, e1, v1, v2, TableContact(zeta, 1.0))
        assert found == pytest.approx(expected, abs=1e-6), zeta


def test_every_legal_restitution_of_a_dashpot_has_a_prediction():
    for e2, family in product((0.02, 0.1, math.exp(-2), 0.14), ("kelvin-voigt", "kelvin-voigt-anchored")):
        found = predict(BY_KEY["zero-early"], Point(0.5, 0.9, e2), family)
        assert found.v1 >= found.v2 >= 0
