"""Theorem 5, energy, and the order of the final velocities, for any collision."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from impact_xval.model import Collision, solve
from impact_xval.model.pair.following import follow_with_paths
from impact_xval.model.pair.path import POINTS
from impact_xval.model.pair.record import PairEnding, PairOptions, PairRatios

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
    scaled = solve(Collision.two_balls(mass, mass * mu, stiffness, stiffness * kappa, e1, e2, -speed))
    assert np.array(scaled.velocities) / speed == pytest.approx(plain.velocities, abs=1e-10, rel=0)
    assert scaled.impulse1 / (mass * speed) == pytest.approx(plain.impulse1, abs=1e-10, rel=0)
    assert scaled.states == plain.states


@settings(max_examples=200)
@given(ratios, masses)
def test_elastic_collisions_keep_their_energy(kappa, mu):
    c = Collision.from_ratios(kappa, mu, 1, 1)
    outcome = solve(c)
    assert outcome.retained_energy(c) == pytest.approx(1, abs=1e-12)


def path_of(kappa, mu, e1, e2, points):
    """Rows of a path in the kernel's units, as arrays, and stiffnesses in them; where smooth pieces begin; its end.

    An active contact ends compression where its rate ceases to be positive, and is stiffer by 1/e^2 from there on.
    """
    cells = PairRatios(*(np.array([x], dtype=float) for x in (kappa, mu, e1, e2)))
    options = PairOptions(cutoff=math.inf, max_events=10_000, stiffens=True, points=points)
    result, log = follow_with_paths(cells, options)
    state, time, v1, v2, forces = log.state, log.time, log.v1, log.v2, (log.F1, log.F2)
    middle = np.append(np.diff(time), 1.0) > 0  # not the last point of a piece
    begins = np.flatnonzero(np.append(True, ~middle[:-1]))
    stiffness = np.empty((2, state.size))
    for i, (rate, e) in enumerate(((v2 - v1, e1), (-v2, e2))):
        k, was = (1.0, kappa)[i], True
        for a, b in zip(begins, [*begins[1:], state.size], strict=True):
            compresses = rate[(a + b - 1) // 2] > 0
            if state[a] in ((1, 3), (1, 2))[i]:
                k = k / e**2 if was and not compresses else k
                was = compresses
            else:
                was = False
            stiffness[i, a:b] = k
    return state, time, (v1, v2), np.array(forces), stiffness, begins, result.records.ending[0]


@settings(max_examples=20)
@given(ratios, masses, st.floats(0.05, 1), st.floats(0.05, 1), st.sampled_from([1, 2, 4]))
@example(100.0, 0.016603333911881832, 0.4, 0.96, 2)
def test_equations_13_to_15_hold_along_the_path_at_second_order_in_its_spacing(kappa, mu, e1, e2, finer):
    """dE1 = (v2 - v1) dI1, dE2 = -v2 dI2 and F_i = dI_i/dt = sqrt(2 k_i E_i) inside every piece; (11), (12) too.

    The error of a trapezoid of a sinusoid at 48 points per half period is 4e-4 of it.
    """
    state, time, (v1, v2), forces, stiffness, begins, end = path_of(kappa, mu, e1, e2, finer * POINTS)
    impulses = np.array([1 + v1, 1 + v1 + mu * v2])
    energies = forces**2 / (2 * stiffness)
    inside = np.setdiff1d(np.arange(state.size - 1), begins[1:] - 1)
    steps = np.diff(time)[inside]
    for force, impulse, energy, rate in zip(forces, impulses, energies, (v2 - v1, -v2), strict=True):
        means = [0.5 * (x[1:] + x[:-1])[inside] for x in (force, rate)]
        gained = np.diff(impulse)[inside]
        error, least = 4e-4 / finer**2, 1e-5 / finer**2
        assert gained == pytest.approx(means[0] * steps, rel=error, abs=least * (1 + mu))
        assert np.diff(energy)[inside] == pytest.approx(means[1] * gained, rel=error, abs=least)
    assert np.all(steps >= 0)
    # Where stiffness runs away, a closed form gives what follows.
    assert end == PairEnding.PRECISION or not forces[:, -1].any()
