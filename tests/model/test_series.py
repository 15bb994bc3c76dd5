"""Power series of the motion in time, and the rule for drops that have settled.

The series are compared with the matrix exponential and with a numerical integration, and their remainder with the power
of the step that it should have.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model import Collision
from impact_xval.model.chain import drop, series
from impact_xval.model.chain.laws import Law
from impact_xval.model.chain.power_law import new_workspace
from impact_xval.model.chain.series import ORDER
from impact_xval.model.chain.state import begin, new_chain
from impact_xval.model.pair.law import Phase
from tests.compliant_baselines.reference_cells import dampings, random_cells
from tests.model.conftest import from_python

begin, expand = from_python(begin), from_python(series.expand)
expand_product, window_length = from_python(series.expand_product), from_python(series.window_length)
settled = from_python(drop.settles)


def make_chain(state, mu, k1, k2, c1, c2, g=0.0, law=Law.KELVIN_VOIGT):
    """Make two balls on a table in the state (p1, d1, q2, v2), m1 = 1. A stiffness of 0 means an inactive contact."""
    stiffnesses = np.array([k1 or 1.0, k2 or 1.0])
    rates, dampings = np.array([1.0, 0.0]), np.array([c1, c2])
    c = new_chain(2, 1.0, law, False)
    begin(c, np.array([1.0, mu]), stiffnesses, np.ones(2), dampings, rates, np.zeros(2), g)
    c.delta[:2], c.w[:2] = (state[0], state[2]), (state[1], -state[3])
    c.phase[:2] = [Phase.COMPRESSION if k > 0 else Phase.INACTIVE for k in (k1, k2)]
    return c


def moved(c, h, x=1.0, degree=ORDER):
    """Return (p1, d1, q2, v2) at the fraction x of the time h, by the terms of the series up to `degree`."""
    work = new_workspace(2)
    expand(c, 2, h, work)
    w, delta = (
        np.polynomial.polynomial.polyval(x, table[:, : degree + 1].T) for table in (work.rates, work.deltas)
    )
    return np.array([delta[0], w[0], delta[1], -w[1]])


def linear_motion(state, t, mu, k1, k2, c1, c2, g=0.0):
    """Return (p1, d1, q2, v2) after a time t by the matrix exponential; springs and dashpots may also pull here."""
    F1, F2 = np.array([k1, c1 * (k1 > 0), 0, 0, 0]), np.array([0, 0, k2, -c2 * (k2 > 0), 0])
    rows = np.zeros((5, 5))
    rows[0, 1], rows[2, 3] = 1, -1
    # accelerations of B1 (m1 = 1, pushed up by contact 1) and of B2
    acceleration1, acceleration2 = F1, (F2 - F1) / mu
    rows[1], rows[3] = acceleration2 - acceleration1, acceleration2
    # An active table carries the weight of B2. Relative to B2, gravity then accelerates only B1.
    rows[[1, 3], 4] = (g, 0.0) if k2 else (0.0, -g)
    return (expm(rows * t) @ [*state, 1])[:4]


def product_motion(state, h, mu, k1, k2, a1, a2, g):
    """Integrate the law in which spring and dashpot multiply: F_i = k_i p_i (1 + a_i p_i').

    Contact 2 is written without the part of its force that carries m2 g.
    """

    def right(_t, y):
        p1, d1, q2, v2 = y
        F1 = k1 * p1 * (1 + a1 * d1)
        F2 = k2 * q2 - (k2 * q2 + mu * g) * a2 * v2
        return [d1, (F2 - F1) / mu - F1 + g, -v2, (F2 - F1) / mu]

    return solve_ivp(right, (0, h), state, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


MOTIONS = {Law.KELVIN_VOIGT: linear_motion, Law.HUNT_CROSSLEY: product_motion}
CHAIN = (1.3, 1.0, 4.0, 0.4, 0.3, 0.1)
STATE = np.array([0.4, 0.8, 0.3, -0.5])


def test_over_a_window_the_series_is_the_motion():
    rng = np.random.default_rng(2)
    for _ in range(60):
        mu, k1, k2, c1, c2 = 10 ** rng.uniform([-1, -2, -2, -2, -2], [1, 2, 2, 1, 1])
        on1, on2 = rng.integers(0, 2, 2)
        chain, state = (mu, k1 * on1, k2 * on2, c1 * on1, c2 * on2, 0.7), rng.uniform(-1, 1, 4)
        c = make_chain(state, *chain)
        h = min(window_length(c, 2, new_workspace(2)), 10.0)
        for x in (0.0, 0.25, 0.7, 1.0):
            exact = linear_motion(state, x * h, *chain)
            size = np.abs(exact).max() + np.abs(state).max() * (1 + h)
            np.testing.assert_allclose(moved(c, h, x), exact, rtol=0, atol=2e-14 * size)


@pytest.mark.parametrize("law", MOTIONS)
def test_the_remainder_falls_with_the_power_of_the_step_after_its_degree(law):
    c = make_chain(STATE, *CHAIN, law)
    steps = 0.4 / 2.0 ** np.arange(4)
    exact = [MOTIONS[law](STATE, h, *CHAIN) for h in steps]
    for degree in (3, 4, 6):
        errors = [np.abs(moved(c, h, degree=degree) - y).max() for h, y in zip(steps, exact, strict=True)]
        assert errors[-1] > 1e-12  # otherwise the fit would measure rounding
        slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert slope == pytest.approx(degree + 1, abs=0.1)


def test_the_product_law_holds_as_far_as_it_is_trusted():
    c, work = make_chain(STATE, *CHAIN, Law.HUNT_CROSSLEY), new_workspace(2)
    for h in (0.2, 1.0, 4.0):
        short = expand_product(c, 2, h, work)
        assert 0 < short <= h
        assert (short == h) == (h == 0.2)
        exact = product_motion(STATE, short, *CHAIN)
        np.testing.assert_allclose(moved(c, short), exact, rtol=0, atol=2e-13)


G = 0.3


def largest(away, mu, k, c1, c2):
    """Return the largest force of both contacts beyond the weight they carry, over that weight.

    The motion is followed for 1500 short steps from the equilibrium, disturbed by `away`.
    """
    chain, dt, states = (mu, 1.0, k, c1, c2), 0.05 / np.sqrt(max(1, k, 1 / mu)), [away]
    step = np.transpose([linear_motion(unit, dt, *chain) for unit in np.eye(4)])
    for _ in range(1500):
        states.append(step @ states[-1])
    p1, d1, q2, v2 = np.transpose(states[:-1])
    return max(np.abs(p1 + c1 * d1).max(), np.abs(k * q2 - c2 * v2).max() / (1 + mu)) / G


def test_a_settled_chain_never_lets_go_and_one_that_does_is_not_settled():
    rng, (kappa, mu, e1, e2), sharp = np.random.default_rng(1), random_cells(60, 1), []
    for m2, k, c1, c2 in zip(mu, kappa, *dampings("kelvin-voigt", kappa, mu, e1, e2), strict=True):
        x1, x2, v1, v2 = rng.normal(size=4)
        away = np.array([x2 - x1, v2 - v1, -x2, v2])
        away /= largest(away, m2, k, c1, c2)  # scaled so that the largest force just unloads its contact

        def settles(scale, away=away, chain=(m2, 1.0, k, c1, c2, G)):
            balls = make_chain(np.array([G, 0, G / chain[2], 0]) + scale * away, *chain)
            return settled(balls[0], balls[1])

        assert not settles(1.01)
        sharp.append(max(s for s in (0.1, 0.3, 0.5, 0.7, 0.9) if settles(s)))
    assert np.median(sharp) >= 0.7


def test_chains_that_ring_for_ever_are_stuck_at_once():
    # Three collisions of the default grid with k1 = 1e6 or 1e5 N/m, a much softer table, and e2 = 1. The contact with
    # the table is elastic. The slow vibration of both balls on the table hardly deforms the damped contact between
    # them, so that it hardly loses energy. The solver has a rule that detects balls whose contacts will never
    # open again. Without this rule these collisions did not end within two million segments.
    for ratio, mass, e1, k1 in ((1e-3, 2.0, 0.5, 1e6), (10**-2.5, 2.0, 0.5, 1e6), (1e-2, 2.0, 0.5, 1e5)):
        c = Collision.two_balls(1.0, mass, k1, ratio * k1, e1, 1.0, -1.0)
        outcome = get_solver("kelvin-voigt").solve(c, Settings(scenario="drop"))
        assert (outcome.v1, outcome.v2) == (0, 0)
        assert outcome.diagnostics["n_steps"] < 1000
