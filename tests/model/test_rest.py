"""When a drop is over: free, at rest or stuck, against the matrix exponential."""

import math

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model import Collision
from impact_xval.model.chain import rest
from impact_xval.model.chain.rest import GOING, REST, STUCK
from tests.compliant_baselines.reference_cells import dampings, random_cells
from tests.model.conftest import from_python
from tests.model.test_series import chain, linear_motion

how_over, settled = map(from_python, (rest.how_over, rest.settled))

G = 0.3


def oscillation(state, times, *column):
    """Penetrations (p1, p2) of springs that also pull; contact 2 carries m2 g at q2 = 0."""
    at = np.array([linear_motion(state, t, *column) for t in times])
    mu, _, k2, *_, g = column
    return at[:, 0], at[:, 2] + mu * g / k2


def test_b2_is_at_rest_if_and_only_if_its_vibration_never_unloads_the_table():
    rng = np.random.default_rng(7)
    seen = set()
    for _ in range(20):
        mu, k2, g = 10 ** rng.uniform(-1, 1, 3)
        column, rest = (mu, 0.0, k2, 0.0, 0.0, g), mu * g / k2
        q2, v2 = rest * rng.uniform(-1, 1), g * math.sqrt(mu / k2) * rng.uniform(-1, 1)
        times = np.linspace(0, 2 * math.pi * math.sqrt(mu / k2), 200)
        _, p2 = oscillation((-1.0, 0.0, q2, v2), times, *column)
        if abs(p2.min()) < 1e-3 * rest:
            continue  # too near to tell from samples
        # B1 above, rising faster than B2
        found = how_over(chain((-1.0, v2 - abs(v2) - 0.1, q2, v2), *column), 2)
        assert found == (REST if p2.min() > 0 else GOING)
        seen.add(found)
    assert seen == {REST, GOING}


def test_stuck_balls_never_unload_a_contact_and_a_little_more_energy_can():
    rng = np.random.default_rng(8)
    for _ in range(20):
        mu, k1, k2, g = 10 ** rng.uniform(-1, 1, 4)
        column, equilibrium = (mu, k1, k2, 0.0, 0.0, g), np.array([g / k1, 0, g / k2, 0])
        x = rng.normal(size=4)
        u1, u2, v1, v2 = x / np.array([math.sqrt(k1), math.sqrt(k2), 1, math.sqrt(mu)]) / np.linalg.norm(x)
        # energy of this shape is 1, times two; the least that unloads a contact stands in it alone
        least = min(g / math.sqrt(k1), (1 + mu) * g / math.sqrt(k2)) * np.array([u1, v2 - v1, u2, v2])
        for scale, end in ((0.999, STUCK), (1.001, GOING)):
            assert how_over(chain(equilibrium + scale * least, *column), 2) == end
        times = np.linspace(0, 30 * math.sqrt((1 + mu) / min(k1, k2)), 150)
        p1, p2 = oscillation(equilibrium + 0.999 * least, times, *column)
        assert min(p1.min(), p2.min()) > 0


def largest(away, mu, k, c1, c2):
    """Largest force beyond the weight, over that weight, of both contacts along 1500 short steps from equilibrium."""
    column, dt, states = (mu, 1.0, k, c1, c2), 0.05 / math.sqrt(max(1, k, 1 / mu)), [away]
    step = np.transpose([linear_motion(unit, dt, *column) for unit in np.eye(4)])
    for _ in range(1500):
        states.append(step @ states[-1])
    p1, d1, q2, v2 = np.transpose(states[:-1])
    return max(np.abs(p1 + c1 * d1).max(), np.abs(k * q2 - c2 * v2).max() / (1 + mu)) / G


def test_a_settled_column_never_lets_go_and_one_that_does_is_not_settled():
    rng, (kappa, mu, e1, e2), sharp = np.random.default_rng(1), random_cells(60, 1), []
    for m2, k, c1, c2 in zip(mu, kappa, *dampings("kelvin-voigt", kappa, mu, e1, e2), strict=True):
        x1, x2, v1, v2 = rng.normal(size=4)
        away = np.array([x2 - x1, v2 - v1, -x2, v2])
        away /= largest(away, m2, k, c1, c2)  # the largest force just unloads its contact

        def settles(scale, away=away, column=(m2, 1.0, k, c1, c2, G)):
            balls = chain(np.array([G, 0, G / column[2], 0]) + scale * away, *column)
            return settled(balls[0], balls[1])

        assert not settles(1.01)
        sharp.append(max(s for s in (0.1, 0.3, 0.5, 0.7, 0.9) if settles(s)))
    assert np.median(sharp) >= 0.7


def test_columns_that_ring_for_ever_are_stuck_at_once():
    # e2 = 1 on a soft table: of the slow motion next to nothing reaches the damped contact. Two million segments did
    # not end these, cells of the default grid at k1 = 1e6 and 1e5 N/m.
    for ratio, mass, e1, k1 in ((1e-3, 2.0, 0.5, 1e6), (10**-2.5, 2.0, 0.5, 1e6), (1e-2, 2.0, 0.5, 1e5)):
        c = Collision.two_balls(1.0, mass, k1, ratio * k1, e1, 1.0, -1.0)
        outcome = get_solver("kelvin-voigt").solve(c, Settings(scenario="drop"))
        assert (outcome.v1, outcome.v2) == (0, 0)
        assert outcome.diagnostics["n_steps"] < 1000
