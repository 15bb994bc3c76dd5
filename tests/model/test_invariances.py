"""Theorem 5, energy, and the order of the final velocities, for any collision."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from impact_xval.model import Collision, solve

pytestmark = pytest.mark.smoke

ratios = st.floats(-3, 3).map(lambda x: 10.0**x)
masses = st.floats(-2, 2).map(lambda x: 10.0**x)
restitution = st.floats(0, 1)
scale = st.floats(-6, 6).map(lambda x: 10.0**x)


@settings(max_examples=300)
@given(ratios, masses, restitution, restitution, scale, scale, scale)
def test_theorem_5(kappa, mu, e1, e2, stiffness, mass, speed):
    """Outcome per |v0| and states do not change when both stiffnesses, both masses or v0 are scaled."""
    plain = solve(Collision.from_ratios(kappa, mu, e1, e2))
    assume(plain.grazing_margin > 1e-9)  # the scaled ratios differ by rounding, which decides beside a jump
    scaled = solve(Collision(mass, mass * mu, stiffness, stiffness * kappa, e1, e2, -speed))
    assert scaled.v1 / speed == pytest.approx(plain.v1, abs=1e-10, rel=0)
    assert scaled.v2 / speed == pytest.approx(plain.v2, abs=1e-10, rel=0)
    assert scaled.impulse1 / (mass * speed) == pytest.approx(plain.impulse1, abs=1e-10, rel=0)
    assert scaled.states == plain.states


@settings(max_examples=500)
@given(
    st.one_of(st.just(0.0), st.just(math.inf), st.floats(-4, 4).map(lambda x: 10.0**x)),
    masses,
    restitution,
    restitution,
    st.sampled_from([1e3, 1e5, math.inf]),
)
def test_energy_never_grows_and_the_balls_part(kappa, mu, e1, e2, cutoff):
    c = Collision.from_ratios(kappa, mu, e1, e2)
    outcome = solve(c, stiffness_ratio_cutoff=cutoff)
    assert outcome.v1 >= outcome.v2 >= 0
    assert outcome.retained_energy(c) <= 1 + 1e-13
    assert outcome.states[0] == "S1"
    assert outcome.states[-1] == "S4"
    # momentum: each ball's from the impulses, (11) and (12)
    assert c.v0 + outcome.impulse1 / c.m1 == pytest.approx(outcome.v1, abs=1e-13)
    assert (outcome.impulse2 - outcome.impulse1) / c.m2 == pytest.approx(outcome.v2, abs=1e-12 / min(1, mu))


@settings(max_examples=200)
@given(ratios, masses)
def test_elastic_collisions_keep_their_energy(kappa, mu):
    c = Collision.from_ratios(kappa, mu, 1, 1)
    outcome = solve(c)
    assert outcome.retained_energy(c) == pytest.approx(1, abs=1e-12)


@settings(max_examples=100)
@given(ratios, masses, st.floats(0.05, 1), st.floats(0.05, 1))
def test_a_path_keeps_momentum_and_ends_in_the_outcome(kappa, mu, e1, e2):
    c = Collision(2.0, 2.0 * mu, 1e6, 1e6 * kappa, e1, e2, -3.0)
    outcome = solve(c, path=True)
    p = outcome.path
    assert np.all(np.diff(p.time) >= -1e-12 * p.time[-1])
    assert p.v1 == pytest.approx(c.v0 + p.impulse1 / c.m1, abs=1e-12 * abs(c.v0))
    assert (p.v1[-1], p.v2[-1]) == (outcome.v1, outcome.v2)


def test_a_path_has_times_whatever_the_ratios():
    for ratios in ((1e-30, 1.0, 0.0, 1e-300), (1.0, 1.0, 1e-300, 1e-300), (1e-300, 1e150, 1e-300, 1.0)):
        path = solve(Collision.from_ratios(*ratios), path=True).path
        assert path is not None
        assert path.time[0] == 0
        assert not np.isnan(path.time).any(), ratios
        assert np.all(path.time[1:] >= path.time[:-1]), ratios
