"""Limits: closed forms, reached at the expected rate; and far corners: k2/k1 over 24 decades, m2/m1 over 12."""

import math
from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from impact_xval.model import Collision, solve, solve_batch
from impact_xval.model.pair import kernel
from impact_xval.model.pair.law import RESTITUTION, Contact
from tests.model.kernels import from_python
from tests.model.oracle import solve_oracle

MU = 2 / math.sqrt(3)
at_work = from_python(kernel.at_work)


def ball_ball_rigid(mu, e1, e2):
    """Supplement 3.2, written out as it stands there ((13) without its misprint)."""
    v11, v21 = (e1 * mu - 1) / (1 + mu), -(1 + e1) / (1 + mu)
    if e1 * mu >= 1 and e2 * (1 + e1) <= e1 * mu - 1:
        return v11, -e2 * v21, ("S1", "S2", "S4")
    if e1 * mu < 1:
        v = e2 * math.sqrt(1 + mu * e1 * e1) / (1 + mu)
    else:
        v = math.sqrt((e1 * mu - 1) ** 2 + mu * e2**2 * (1 + e1) ** 2) / (1 + mu) ** 1.5
    return v, v, ("S1", "S2", "S1", "S4")


def test_stiffness_ratio_zero_is_the_closed_form_of_the_supplement():
    for mu, e1, e2 in product(
        (1e-6, 0.2, 1.0, MU, 3.0, 10.0, 1e6), (0.0, 0.2, 0.5, 0.9, 1.0), (0.0, 0.1, 0.3, 0.7, 1.0)
    ):
        outcome = solve(Collision.from_ratios(0, mu, e1, e2))
        v1, v2, states = ball_ball_rigid(mu, e1, e2)
        assert (outcome.v1, outcome.v2) == pytest.approx((v1, v2), abs=1e-14, rel=0), (mu, e1, e2)
        assert outcome.status == "limit"
        if abs(e1 * mu - 1) > 1e-12:
            assert outcome.states == states, (mu, e1, e2)


def test_stiffness_ratio_infinite_is_one_ball_on_the_table():
    for mu, e1, e2 in product((1e-6, 0.2, MU, 1e6), (0.0, 0.2, 1.0), (0.0, 0.5, 1.0)):
        outcome = solve(Collision.from_ratios(math.inf, mu, e1, e2))
        assert (outcome.v1, outcome.v2) == pytest.approx((e1, 0), abs=1e-15, rel=0), (mu, e1, e2)
        assert (outcome.states, outcome.status) == (("S1", "S4"), "limit")


def test_either_stiffness_may_be_the_zero_or_the_infinite_one():
    for k1, k2, v1 in ((math.inf, 5, 0.45203), (2, 0, 0.45203), (2, math.inf, 0.9), (0, 5, 0.9)):
        outcome = solve(Collision.two_balls(1, MU, k1, k2, 0.9, 0.7), path=True)
        assert outcome.v1 == pytest.approx(v1, abs=1e-5)
        assert not np.isnan(outcome.path.time).any()


def fitted_rate(ratios, distances):
    return np.polyfit(np.log10(ratios), np.log10(distances), 1)[0]


def test_stiffness_ratio_towards_zero_at_first_order():
    """From the finite side, cut-off switched off: |v - limit| falls in proportion to k2/k1."""
    ratios = np.logspace(-11, -5, 13)
    for mu, e1, e2 in (
        *((5.0, 0.9, 0.1), (5.0, 0.8, 0.3)),  # S2 ends
        *((MU, 0.5, 0.7), (0.5, 0.3, 0.9), (0.5, 0.6, 0.2)),  # united early
        *((3.0, 0.5, 0.7), (2.0, 0.8, 0.9)),  # united late
    ):
        batch = solve_batch(ratios, mu, e1, e2, stiffness_ratio_cutoff=math.inf)
        v1, v2, _ = ball_ball_rigid(mu, e1, e2)
        distances = np.hypot(batch.v1 - v1, batch.v2 - v2)
        assert fitted_rate(ratios, distances) == pytest.approx(1, abs=0.1), (mu, e1, e2)


@pytest.mark.parametrize("mu", [0.6, 0.25, 0.08, 0.03])
def test_the_model_has_no_limit_where_the_ringing_decides(mu):
    """Every number n of ends of compression occurs in the share 1 - |n - 1 - r| of the contrasts (docs/errata.md)."""
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


def test_both_outcomes_of_a_ringing_pair_are_those_of_the_oracle():
    once = 0.7 / math.sqrt(1.3)
    for x, v in ((1000, once), (1500, 0.7 * once)):
        c = Collision.from_ratios(1 / x, 0.3, 1.0, 0.7)
        for solver in (solve_oracle, solve):
            assert solver(c, stiffness_ratio_cutoff=math.inf).v1 == pytest.approx(v, abs=5e-3)


def test_stiffness_ratio_towards_infinity_at_first_order_and_at_second_where_the_table_contact_loses_energy():
    ratios = np.logspace(3.5, 7, 15)
    for mu, e1, e2, rate, band in (
        # An elastic table contact keeps its stiffness.
        *((MU, 0.9, 1.0, -1, 0.15), (0.5, 0.3, 1.0, -1, 0.15), (3.0, 0.5, 1.0, -1, 0.15)),
        # A lossy one stiffens with every vibration of B2 on the table, and its ratio runs away: second order.
        *((MU, 0.9, 0.5, -2, 0.05), (0.5, 0.3, 0.8, -2, 0.1), (3.0, 0.5, 0.7, -2, 0.05)),
    ):
        batch = solve_batch(ratios, mu, e1, e2, stiffness_ratio_cutoff=math.inf)
        found = fitted_rate(ratios, np.hypot(batch.v1 - e1, batch.v2))
        assert found == pytest.approx(rate, abs=band), (mu, e1, e2)


def test_a_plastic_contact_is_the_limit_of_small_restitution():
    """e -> 0 reaches the closed form of e = 0 (supplement, 3.3)."""
    small, other = np.logspace(-6, -3, 7), 0.7
    for kappa, which in product((0.1, 1.0, 8.0), ("e1", "e2")):
        given = {"e1": other, "e2": other}
        batch = solve_batch(kappa, MU, **(given | {which: small}), stiffness_ratio_cutoff=math.inf)
        at_zero = solve(Collision.from_ratios(kappa, MU, **(given | {which: 0.0})))
        distances = np.hypot(batch.v1 - at_zero.v1, batch.v2 - at_zero.v2)
        assert at_zero.status == "limit"
        # at least first order: first in S2 (v2 = e2 ...), up to fourth in S1
        assert np.all(distances < 2 * small), (kappa, which)
        assert distances[-1] > distances[0] or distances[-1] < 1e-11, (kappa, which)


def test_an_illegal_cutoff_is_named():
    for cutoff in (1.0, -5.0, math.nan):
        with pytest.raises(ValueError, match=f"stiffness_ratio_cutoff = {cutoff}.*legal: greater than 1"):
            solve(Collision.from_ratios(1, 1, 0.5, 0.5), stiffness_ratio_cutoff=cutoff)


def extreme_cells(n, seed):
    rng = np.random.default_rng(seed)

    def restitution():
        e = rng.uniform(0, 1, n)
        kind = rng.uniform(0, 1, n)
        tiny, nearly = 10 ** rng.uniform(-12, 0, n), 1 - 10 ** rng.uniform(-12, -1, n)
        return np.select([kind < 0.03, kind < 0.06, kind < 0.1, kind < 0.13], [0.0, 1.0, tiny, nearly], e)

    return 10 ** rng.uniform(-12, 12, n), 10 ** rng.uniform(-6, 6, n), restitution(), restitution()


@pytest.mark.slow
@pytest.mark.parametrize("cutoff", [1e5, "exact", math.inf])
def test_no_corner_fails(cutoff):
    """Every cell is answered or says why not; the balls part; energy never grows and its balance closes."""
    cells = extreme_cells(20_000, seed=1)
    batch = solve_batch(*cells, stiffness_ratio_cutoff=cutoff, max_events=20_000)
    done = batch.statuses != "unconverged"
    # Given up are only collisions all but elastic at one contact, which take more events than were allowed.
    assert np.all(batch.n_events[~done] > 20_000)
    assert np.all(np.maximum(cells[2], cells[3])[~done] > 0.99)
    assert np.mean(done) > 0.97
    assert np.all(np.isfinite(batch.v1[done]))
    assert np.all((batch.v1 >= batch.v2)[done])
    assert np.all(batch.v2[done] >= 0)
    energy = batch.v1**2 + cells[1] * batch.v2**2
    assert np.max(energy[done]) <= 1 + 1e-11
    # The balance closes to rounding; where the cut-off was used, to what it drops.
    ok = done & (batch.statuses == "ok")
    assert np.max(np.abs(batch.diagnostics["energy_residual"][ok])) < 1e-10
    assert np.min(batch.diagnostics["energy_residual"][done]) > -1e-10
    assert np.max(batch.diagnostics["energy_residual"][done]) < (1e-4 if cutoff == 1e5 else 1e-10)


@pytest.mark.parametrize("mu", [0.2, MU, 5.0])
def test_a_stiff_contact_that_passes_on_a_force_parts_its_bodies_with_the_rest_of_its_energy(mu):
    """M s^2/2 = E - F F_s/k for the relative speed s when F = 0, by the two springs in time, at a ratio of 1e-8.

    They start at their end of compression, the stiff one with three times its static force F_s (`pair.kernel.at_work`).
    """
    for k1, k2, F1, F2 in ((1e8, 1.0, 3 / (1 + mu), 1.0), (1.0, 1e8, 1.0, 3.0)):

        def springs(_, y, k1=k1, k2=k2):
            d1, v2, F1, F2 = y
            return F2 / mu - F1 * (1 + 1 / mu), (F2 - F1) / mu, k1 * d1, -k2 * v2

        def spent(_, y, stiff=2 if k1 > k2 else 3):
            return y[stiff]

        spent.terminal = True
        run = solve_ivp(springs, (0, 1e-3), (0, 0, F1, F2), "DOP853", events=spent, rtol=1e-10, atol=1e-14)
        d1, v2 = run.y_events[0][0][:2]
        E1, E2 = F1**2 / (2 * k1), F2**2 / (2 * k2)
        one, two = (Contact(RESTITUTION, k, E, F, 0.5, k) for k, E, F in ((k1, E1, F1), (k2, E2, F2)))
        rigid, parting = (1, mu / (1 + mu) * d1**2 / 2) if k1 > k2 else (2, mu * v2**2 / 2)
        left = at_work(mu, mu / (1 + mu), kernel.S1, 0.0, 0.0, one, two, rigid, 1e30)[2].E
        assert left == pytest.approx(parting, rel=1e-6, abs=0)


def test_a_very_heavy_lower_ball_is_hit_and_then_hits_the_table():
    """One impact after the other: I1 = 1 + e1, which is all of B2's momentum, and I2 = (1 + e2) I1."""
    for mass_ratio in (1e20, 1e100, 1e149):
        outcome = solve(Collision.from_ratios(40.0, mass_ratio, 0.9, 0.7))
        assert (outcome.impulse1, outcome.impulse2) == pytest.approx((1.9, 1.7 * 1.9), rel=1e-9)


def test_what_double_precision_cannot_tell_is_refused_and_not_answered_wrongly():
    for mass_ratio in (1e-151, 1e151, 1e308):
        outcome = solve(Collision.from_ratios(40.0, mass_ratio, 0.9, 0.7))
        batch = solve_batch(40.0, mass_ratio, 0.9, 0.7)
        assert outcome.status == batch.statuses == "unrepresentable"
        assert "one mass or stiffness exceeds 1e+150 times another" in outcome.reason
        assert np.isnan([batch.v1, batch.v2]).all()


def test_where_no_event_can_be_certified_the_search_ends():
    for mass_ratio in (1e-104, 1e-149):  # the sixth derivatives of a rate leave double precision
        assert solve(Collision.from_ratios(1.0, mass_ratio, 0.9, 0.9)).status == "unconverged"


def test_a_plastic_contact_unites_the_balls_or_keeps_the_lower_one_on_the_table():
    united = solve(Collision.from_ratios(1, MU, 0, 0.7))
    assert (united.v1, united.states) == (united.v2, ("S1", "S2", "S4"))
    kept = solve(Collision.from_ratios(40, MU, 0.9, 0))
    assert (kept.v2, kept.states) == (0, ("S1", "S3", "S4"))
    for kappa in (0, 1e-3, 1, 1e3, math.inf):
        outcome = solve(Collision.from_ratios(kappa, MU, 0, 0))
        assert (outcome.v1, outcome.v2) == pytest.approx((0, 0), abs=1e-15)
