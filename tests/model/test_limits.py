"""Limiting cases and extreme parameters of two balls.

At the limits the model gives the closed forms of the supplement, and approaches them at the expected rate. Random cells
with k2/k1 over 24 decades and m2/m1 over 12 decades all have an outcome or a reason.
"""

import math
from itertools import product

import numpy as np
import pytest
from scipy.optimize import brentq

from impact_xval.model import Collision, solve, solve_batch
from impact_xval.model.pair.law import Contact, Pair, Phase
from impact_xval.model.pair.limits import Rigid
from impact_xval.model.pair.lone import lone_contact
from impact_xval.model.pair.record import State
from tests.model.conftest import from_python
from tests.model.test_events import evolve

MU = 2 / math.sqrt(3)
lone_contact = from_python(lone_contact)


def ball_ball_rigid(mu, e1, e2):
    """Return v1, v2 and states for k2/k1 = 0 as printed in the supplement, 3.2, with the misprint in (13) corrected."""
    v11, v21 = (e1 * mu - 1) / (1 + mu), -(1 + e1) / (1 + mu)
    if e1 * mu >= 1 and e2 * (1 + e1) <= e1 * mu - 1:
        return v11, -e2 * v21, ("S1", "S2", "S4")
    if e1 * mu < 1:
        v = e2 * math.sqrt(1 + mu * e1 * e1) / (1 + mu)
    else:
        v = math.sqrt((e1 * mu - 1) ** 2 + mu * e2**2 * (1 + e1) ** 2) / (1 + mu) ** 1.5
    return v, v, ("S1", "S2", "S1", "S4")


def ball_on_table(_mu, e1, _e2):
    return e1, 0.0, ("S1", "S4")


@pytest.mark.parametrize(
    ("ratio", "closed_form", "bound"), [(0.0, ball_ball_rigid, 1e-14), (math.inf, ball_on_table, 1e-15)]
)
def test_at_a_limit_of_the_stiffness_ratio_the_outcome_is_its_closed_form(ratio, closed_form, bound):
    restitutions = (0.0, 0.2, 0.5, 0.9, 1.0), (0.0, 0.1, 0.3, 0.7, 1.0)
    for cell in product((1e-6, 0.2, 1.0, MU, 3.0, 10.0, 1e6), *restitutions):
        outcome = solve(Collision.from_ratios(ratio, *cell))
        v1, v2, states = closed_form(*cell)
        assert outcome.velocities == pytest.approx((v1, v2), abs=bound, rel=0), cell
        assert outcome.status == "closed-form"
        if abs(cell[0] * cell[1] - 1) > 1e-12:
            assert outcome.states == states, cell


def test_either_stiffness_may_be_the_zero_or_the_infinite_one():
    for k1, k2, v1 in ((math.inf, 5, 0.45203), (2, 0, 0.45203), (2, math.inf, 0.9), (0, 5, 0.9)):
        outcome = solve(Collision.two_balls(1, MU, k1, k2, 0.9, 0.7), path=True)
        assert outcome.v1 == pytest.approx(v1, abs=1e-5)
        assert not np.isnan(outcome.path.time).any()


def test_a_limit_of_the_stiffness_ratio_is_reached_at_its_rate():
    """Near a limit, log |v - limit| is a straight line over log k2/k1 with the expected slope; no cut-off is used."""
    to_zero, to_infinity = np.logspace(-11, -5, 13), np.logspace(3.5, 7, 15)
    for ratios, cells, limit, rate, band in (
        # Three cases: contact 2 ends in S2, the balls are united early, and the balls are united late.
        (to_zero, ((5.0, 0.9, 0.1), (5.0, 0.8, 0.3)), ball_ball_rigid, 1, 0.1),
        (to_zero, ((MU, 0.5, 0.7), (0.5, 0.3, 0.9), (0.5, 0.6, 0.2)), ball_ball_rigid, 1, 0.1),
        (to_zero, ((3.0, 0.5, 0.7), (2.0, 0.8, 0.9)), ball_ball_rigid, 1, 0.1),
        # An elastic contact with the table keeps its stiffness.
        (to_infinity, ((MU, 0.9, 1.0), (0.5, 0.3, 1.0), (3.0, 0.5, 1.0)), ball_on_table, -1, 0.15),
        # A contact with losses stiffens with every vibration of B2 on the table, so that the stiffness ratio grows
        # without bound.
        (to_infinity, ((MU, 0.9, 0.5), (3.0, 0.5, 0.7)), ball_on_table, -2, 0.05),
        (to_infinity, ((0.5, 0.3, 0.8),), ball_on_table, -2, 0.1),
    ):
        for cell in cells:
            batch = solve_batch(ratios, *cell, stiffness_ratio_cutoff=math.inf)
            v1, v2, _ = limit(*cell)
            distances = np.hypot(batch.v1 - v1, batch.v2 - v2)
            slope = np.polyfit(np.log10(ratios), np.log10(distances), 1)[0]
            assert slope == pytest.approx(rate, abs=band), cell


@pytest.mark.parametrize("mu", [0.6, 0.25, 0.08, 0.03])
def test_the_model_has_no_limit_where_the_ringing_decides(mu):
    """For k2/k1 -> infinity with e1 = 1, the number n of ends of compression at the table varies and has no limit.

    Each number n occurs in a share 1 - |n - 1 - r| of the stiffness ratios, to 0.045. The formula for r is derived in
    docs/errata.md.
    """
    e2, count, q = 0.7, 1000, math.sqrt((3 - mu) / (mu * (1 + mu)))
    r = (math.sqrt(q * q - 1) - math.acos(1 / q)) / math.pi
    x = np.exp(np.random.default_rng(4).uniform(*np.log([1e4, 1e6]), count))
    v1 = solve_batch(1 / x, mu, 1.0, e2, stiffness_ratio_cutoff=math.inf, max_events=300_000).v1
    ends = 1 + np.log(v1 * math.sqrt(1 + mu) / e2) / math.log(e2)
    assert np.abs(ends - np.round(ends)).max() < 0.01
    shares = [max(0.0, 1 - abs(n - r)) for n in range(5)]
    assert sum(shares) == pytest.approx(1, abs=1e-12)
    for n, share in enumerate(shares, start=1):
        assert np.mean(np.round(ends) == n) == pytest.approx(share, abs=0.045 if share else 0)


def test_a_plastic_contact_is_the_limit_of_small_restitution():
    """As e -> 0, the outcome approaches the closed form for e = 0 (supplement, 3.3) at least as fast as 2 e."""
    small, other = np.logspace(-6, -3, 7), 0.7
    for kappa, which in product((0.1, 1.0, 8.0), ("e1", "e2")):
        given = {"e1": other, "e2": other}
        batch = solve_batch(kappa, MU, **(given | {which: small}), stiffness_ratio_cutoff=math.inf)
        at_zero = solve(Collision.from_ratios(kappa, MU, **(given | {which: 0.0})))
        distances = np.hypot(batch.v1 - at_zero.v1, batch.v2 - at_zero.v2)
        assert at_zero.status == "closed-form"
        # the distance falls at least linearly with e: linearly in S2 (where v2 = e2 ...), with up to the fourth power
        # in S1
        assert np.all(distances < 2 * small), (kappa, which)
        assert distances[-1] > distances[0] or distances[-1] < 1e-11, (kappa, which)


def extreme_cells(n, seed):
    rng = np.random.default_rng(seed)

    def restitution():
        e = rng.uniform(0, 1, n)
        kind = rng.uniform(0, 1, n)
        tiny, nearly = 10 ** rng.uniform(-12, 0, n), 1 - 10 ** rng.uniform(-12, -1, n)
        return np.select([kind < 0.03, kind < 0.06, kind < 0.1, kind < 0.13], [0.0, 1.0, tiny, nearly], e)

    ratios = 10 ** rng.uniform(-12, 12, n)
    ratios[:200] = np.repeat([0.0, math.inf], 100)
    return ratios, 10 ** rng.uniform(-6, 6, n), restitution(), restitution()


@pytest.mark.slow
@pytest.mark.parametrize("cutoff", [1e5, "exact", math.inf])
def test_no_corner_fails(cutoff):
    """Every extreme cell has an outcome or a reason why not. The balls separate, and energy never grows."""
    cells = extreme_cells(20_000, seed=1)
    batch = solve_batch(*cells, stiffness_ratio_cutoff=cutoff, max_events=20_000)
    done = batch.statuses != "unconverged"
    # Only collisions with a contact that is nearly elastic are unconverged. They need more events than allowed.
    assert np.all(batch.n_events[~done] > 20_000)
    assert np.all(np.maximum(cells[2], cells[3])[~done] > 0.99)
    assert np.mean(done) > 0.97
    assert np.all((np.isfinite(batch.v1) & (batch.v1 >= batch.v2) & (batch.v2 >= 0))[done])
    energy = batch.v1**2 + cells[1] * batch.v2**2
    assert np.all((energy <= 1 + 1e-13 + 1e-15 * batch.n_events)[done])  # every event adds a rounding error
    # The energy balance closes to rounding, or, where the cut-off was used, to the energy that the cut-off neglects.
    residual = batch.diagnostics["energy_residual"]
    dropped = np.where((batch.statuses == "closed-form") & (cutoff == 1e5), 1e-4, 1e-10)
    assert np.all(((residual > -1e-10) & (residual < dropped))[done])


@pytest.mark.parametrize("mu", [0.2, MU, 5.0])
def test_a_stiff_contact_that_passes_on_a_force_parts_its_bodies_with_the_rest_of_its_energy(mu):
    """A stiff contact that transmits a force separates its bodies at the relative speed s, with M s^2/2 = E - F F_s/k.

    The formula (`pair.lone`) is compared with the motion of the two springs in time at a stiffness ratio of 1e-8, to
    1e-6. The springs start at the end of compression, where the stiff one carries three times its static force F_s.
    """
    M = mu / (1 + mu)
    for k, F, mass, i in (((1e8, 1.0), (3 / (1 + mu), 1.0), M, 0), ((1.0, 1e8), (1.0, 3.0), mu, 1)):

        def motion(time, k=k, F=F):
            return evolve(mu, k[0], k[1], (0.0, 0.0, *F), time)

        half = math.pi * math.sqrt(mass / k[i])
        spent = brentq(lambda time, f=motion, i=i: f(time)[2 + i], half / 2, half, xtol=1e-18)
        one, two = (
            Contact(Phase.RESTITUTION, k, F**2 / (2 * k), F, 0.5, k) for k, F in zip(k, F, strict=True)
        )
        rigid = (Rigid.CONTACT1, Rigid.CONTACT2)[i]
        left = lone_contact(Pair(0.0, 0.0, one, two, 0.0), mu, M, State.S1, rigid, 1e30).contact.E
        assert left == pytest.approx(mass * motion(spent)[i] ** 2 / 2, rel=1e-6, abs=0)


def test_a_very_heavy_lower_ball_is_hit_and_then_hits_the_table():
    """A very heavy B2 is hit first, with I1 = 1 + e1, and then hits the table, with I2 = (1 + e2) I1."""
    for mass_ratio in (1e20, 1e100, 1e149):
        outcome = solve(Collision.from_ratios(40.0, mass_ratio, 0.9, 0.7))
        assert (outcome.impulse1, outcome.impulse2) == pytest.approx((1.9, 1.7 * 1.9), rel=1e-9)


def test_where_no_event_can_be_certified_the_search_ends():
    for mass_ratio in (1e-104, 1e-149):  # the sixth derivative of a rate exceeds double precision
        assert solve(Collision.from_ratios(1.0, mass_ratio, 0.9, 0.9)).status == "unconverged"
