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
    assert outcome.retained_energy(c) <= 1 + 1e-13 + 1e-15 * outcome.n_events  # each of them rounds
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
def test_equations_13_and_14_hold_along_the_path(kappa, mu, e1, e2):
    """dE1 = (v2 - v1) dI1 and dE2 = -v2 dI2 inside every stretch."""
    c = Collision(2.0, 2.0 * mu, 1e6, 1e6 * kappa, e1, e2, -3.0)
    outcome = solve(c, path=True)
    p = outcome.path
    unit = c.m1 * c.v0**2
    smooth = (np.diff(p.state) == 0) & (np.diff(p.phase1) == 0) & (np.diff(p.phase2) == 0)
    ends = [e for e in outcome.events if e.kind != "limit"]
    assert all(np.any(np.isclose(p.time, e.time)) for e in ends)
    dI1, dI2 = np.diff(p.impulse1)[smooth], np.diff(p.impulse2)[smooth]
    # Exact trapezoid sums where one impulse grows; in S1, with some 50 points a half period, to second order.
    middle1 = 0.5 * ((p.v2 - p.v1)[1:] + (p.v2 - p.v1)[:-1])[smooth]
    middle2 = -0.5 * (p.v2[1:] + p.v2[:-1])[smooth]
    assert np.diff(p.energy1)[smooth] == pytest.approx(middle1 * dI1, abs=1e-5 * unit)
    assert np.diff(p.energy2)[smooth] == pytest.approx(middle2 * dI2, abs=1e-5 * unit)
    assert np.all(np.diff(p.time) >= -1e-12 * p.time[-1])
    assert p.v1 == pytest.approx(c.v0 + p.impulse1 / c.m1, abs=1e-12 * abs(c.v0))
    assert (p.v1[-1], p.v2[-1]) == (outcome.v1, outcome.v2)


def test_sums_along_a_path_converge_at_second_order_in_the_spacing_of_its_points():
    c = Collision.from_ratios(40, 2 / math.sqrt(3), 0.9, 0.7)
    p = solve(c, path=True).path
    residuals = []
    for every in (1, 2, 4):
        worst = 0.0
        for start, stop in smooth_pieces(p):
            i = slice(start, stop, every)
            for d, impulse, energy in ((p.v2 - p.v1, p.impulse1, p.energy1), (-p.v2, p.impulse2, p.energy2)):
                middle = 0.5 * (d[i][1:] + d[i][:-1])
                worst = max(worst, abs(np.sum(np.diff(energy[i]) - middle * np.diff(impulse[i]))))
        residuals.append(worst)
    assert residuals[0] < 1e-4
    assert math.log2(residuals[2] / residuals[0]) / 2 == pytest.approx(2, abs=0.3)


def test_equation_15_along_the_path():
    """dI_i/dt = sqrt(2 k_i E_i) for both contacts in S1, whose ratio is (15); k_i follows the ends of compression."""
    c = Collision(1.0, 1.3, 2e5, 3e5, 0.8, 0.6, -2.0)
    p = solve(c, path=True).path
    checked = 0
    stiffness = [c.k1, c.k2]
    phases = [p.phase1, p.phase2]
    for start, stop in smooth_pieces(p):
        for i, e in ((0, c.e1), (1, c.e2)):
            if start and phases[i][start - 1] == 1 and phases[i][start] == 2:
                stiffness[i] /= e * e
        if p.state[start] != 1 or stop - start < 5:
            continue
        piece, inner = slice(start, stop), slice(1, -1)
        for k, impulse, energy in (
            (stiffness[0], p.impulse1, p.energy1),
            (stiffness[1], p.impulse2, p.energy2),
        ):
            force = np.gradient(impulse[piece], p.time[piece])
            assert force[inner] == pytest.approx(
                np.sqrt(2 * k * energy[piece])[inner], rel=2e-3, abs=2e-3 * force.max()
            )
            checked += 1
    assert checked >= 6


def smooth_pieces(p):
    """Index ranges without an event inside, S1 stretches that meet in a restart of compression apart too."""
    key = np.stack([p.state, p.phase1, p.phase2])
    repeated = np.append(
        False, (np.diff(p.time) == 0) & (np.diff(p.impulse1) == 0) & (np.diff(p.impulse2) == 0)
    )
    borders = np.flatnonzero(np.append(True, np.any(np.diff(key, axis=1) != 0, axis=0)) | repeated)
    return [(a, b) for a, b in zip(borders, [*borders[1:], p.time.size], strict=True) if b - a > 2]
