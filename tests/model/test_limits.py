"""Limits are legal input, have closed forms, and are approached at the expected rate."""

import math

import numpy as np
import pytest

from impact_xval.model import Collision, solve, solve_batch

MU = 2 / math.sqrt(3)


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


@pytest.mark.parametrize("e2", [0.0, 0.1, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("e1", [0.0, 0.2, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("mu", [1e-6, 0.2, 1.0, MU, 3.0, 10.0, 1e6])
def test_stiffness_ratio_zero_is_the_closed_form_of_the_supplement(mu, e1, e2):
    outcome = solve(Collision.from_ratios(0, mu, e1, e2))
    v1, v2, states = ball_ball_rigid(mu, e1, e2)
    assert (outcome.v1, outcome.v2) == pytest.approx((v1, v2), abs=1e-14, rel=0)
    assert outcome.status == "limit"
    if abs(e1 * mu - 1) > 1e-12:
        assert outcome.states == states


@pytest.mark.parametrize("e2", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("e1", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("mu", [1e-6, 0.2, MU, 1e6])
def test_stiffness_ratio_infinite_is_one_ball_on_the_table(mu, e1, e2):
    outcome = solve(Collision.from_ratios(math.inf, mu, e1, e2))
    assert (outcome.v1, outcome.v2) == pytest.approx((e1, 0), abs=1e-15, rel=0)
    assert outcome.states == ("S1", "S4")
    assert outcome.status == "limit"


def test_either_stiffness_may_be_the_zero_or_the_infinite_one():
    for k1, k2 in ((math.inf, 5.0), (2.0, 0.0)):
        outcome = solve(Collision(1, MU, k1, k2, 0.9, 0.7), path=True)
        assert outcome.v1 == pytest.approx(0.45203, abs=1e-5)
        assert outcome.path is not None
        assert not np.isnan(outcome.path.time).any()
    for k1, k2 in ((2.0, math.inf), (0.0, 5.0)):
        outcome = solve(Collision(1, MU, k1, k2, 0.9, 0.7), path=True)
        assert outcome.v1 == pytest.approx(0.9)
        assert not np.isnan(outcome.path.time).any()


def fitted_rate(ratios, distances):
    return np.polyfit(np.log10(ratios), np.log10(distances), 1)[0]


@pytest.mark.parametrize(
    ("mu", "e1", "e2"),
    [
        (5.0, 0.9, 0.1),
        (5.0, 0.8, 0.3),
        (MU, 0.5, 0.7),
        (0.5, 0.3, 0.9),
        (0.5, 0.6, 0.2),
        (3.0, 0.5, 0.7),
        (2.0, 0.8, 0.9),
    ],
    ids=["S2 ends", "S2 ends", "united early", "united early", "united early", "united late", "united late"],
)
def test_stiffness_ratio_towards_zero_at_first_order(mu, e1, e2):
    """From the finite side, cut-off switched off: |v - limit| falls in proportion to k2/k1."""
    ratios = np.logspace(-11, -5, 13)
    batch = solve_batch(ratios, mu, e1, e2, stiffness_ratio_cutoff=math.inf)
    v1, v2, _ = ball_ball_rigid(mu, e1, e2)
    distances = np.hypot(batch.v1 - v1, batch.v2 - v2)
    assert fitted_rate(ratios, distances) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize(
    ("mu", "e1", "e2", "rate", "band"),
    [
        # An elastic table contact keeps its stiffness: the expected first order (events shift about it).
        (MU, 0.9, 1.0, -1, 0.15),
        (0.5, 0.3, 1.0, -1, 0.15),
        (3.0, 0.5, 1.0, -1, 0.15),
        # A lossy one stiffens with every vibration of B2 on the table, and its ratio runs away: second order.
        (MU, 0.9, 0.5, -2, 0.05),
        (0.5, 0.3, 0.8, -2, 0.1),
        (3.0, 0.5, 0.7, -2, 0.05),
    ],
)
def test_stiffness_ratio_towards_infinity(mu, e1, e2, rate, band):
    """docs/errata.md: first order where e2 = 1, second where e2 < 1."""
    ratios = np.logspace(3.5, 7, 15)
    batch = solve_batch(ratios, mu, e1, e2, stiffness_ratio_cutoff=math.inf)
    assert fitted_rate(ratios, np.hypot(batch.v1 - e1, batch.v2)) == pytest.approx(rate, abs=band)


@pytest.mark.parametrize("kappa", [0.1, 1.0, 8.0])
@pytest.mark.parametrize("which", ["e1", "e2"])
def test_plastic_contact_is_the_limit_of_small_restitution(kappa, which):
    """e -> 0 reaches the closed form of e = 0 (supplement, 3.3)."""
    other = 0.7
    small = np.logspace(-6, -3, 7)
    e1, e2 = (small, other) if which == "e1" else (other, small)
    batch = solve_batch(kappa, MU, e1, e2, stiffness_ratio_cutoff=math.inf)
    at_zero = solve(
        Collision.from_ratios(kappa, MU, 0.0 if which == "e1" else other, 0.0 if which == "e2" else other)
    )
    distances = np.hypot(batch.v1 - at_zero.v1, batch.v2 - at_zero.v2)
    assert at_zero.status == "limit"
    # at least first order: first in S2 (v2 = e2 ...), up to fourth in S1
    assert np.all(distances < 2 * small)
    assert distances[-1] > distances[0] or distances[-1] < 1e-11


def test_plastic_ball_ball_contact_unites_the_balls_in_s2():
    outcome = solve(Collision.from_ratios(1, MU, 0, 0.7))
    assert outcome.v1 == outcome.v2
    assert outcome.states == ("S1", "S2", "S4")


def test_plastic_table_contact_leaves_the_lower_ball_on_the_table():
    outcome = solve(Collision.from_ratios(40, MU, 0.9, 0))
    assert outcome.v2 == 0
    assert outcome.states == ("S1", "S3", "S4")


def test_both_contacts_plastic():
    for kappa in (0, 1e-3, 1, 1e3, math.inf):
        outcome = solve(Collision.from_ratios(kappa, MU, 0, 0))
        assert (outcome.v1, outcome.v2) == pytest.approx((0, 0), abs=1e-15)


@pytest.mark.parametrize("ratio", [0.9e-5, 1.01e-5, 3e-5, 1e-4, 9e-4, 1.1e3, 5e4, 0.99e5, 1.1e5])
@pytest.mark.parametrize(("e1", "e2"), [(0.3, 0.7), (0.9, 0.3), (0.6, 1.0), (0.9, 0.7)])
@pytest.mark.parametrize("mu", [0.3, MU, 4.0])
def test_the_cutoff_changes_little_wherever_it_applies(mu, e1, e2, ratio):
    """Also next to the cut-off, where the stiff contact still holds all of its energy when the ratio leaves it."""
    c = Collision.from_ratios(ratio, mu, e1, e2)
    default, off = solve(c), solve(c, stiffness_ratio_cutoff=math.inf)
    assert (default.v1, default.v2) == pytest.approx((off.v1, off.v2), abs=5e-5, rel=0)


@pytest.mark.parametrize("cutoff", [1.0, 0.0, -5.0, math.nan, "high", None])
def test_an_illegal_cutoff_is_named(cutoff):
    with pytest.raises(ValueError, match=r"stiffness_ratio_cutoff = .*legal: greater than 1"):
        solve(Collision.from_ratios(1, 1, 0.5, 0.5), stiffness_ratio_cutoff=cutoff)
