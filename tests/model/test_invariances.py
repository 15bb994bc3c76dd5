"""Invariances of the model for any collision of two balls.

The tests check Theorem 5 (only ratios matter), the energy of elastic collisions, and equations (13)-(15) along the
path.
"""

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
    """Scaling both stiffnesses, both masses or v0 changes neither the velocities per |v0| (to 1e-10) nor the states."""
    plain = solve(Collision.from_ratios(kappa, mu, e1, e2))
    # scaling rounds the ratios, and beside a jump rounding decides the outcome
    assume(plain.grazing_margin > 1e-9)
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
    """Follow a collision; return its path in the kernel's units, where its smooth pieces begin, and how it ended.

    The path is returned as arrays: states, times, velocities, forces and stiffnesses. An active contact ends
    compression where its rate stops being positive. From there on its stiffness is 1/e^2 times as large.
    """
    cells = PairRatios(*(np.array([x], dtype=float) for x in (kappa, mu, e1, e2)))
    options = PairOptions(cutoff=math.inf, max_events=10_000, stiffens=True, points=points)
    result, log = follow_with_paths(cells, options)
    state, time, v1, v2, forces = log.state, log.time, log.v1, log.v2, (log.F1, log.F2)
    # the value is False at the last point of a smooth piece of the path
    middle = np.append(np.diff(time), 1.0) > 0
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
    """Equations (11) to (15) are true along a path, up to the error of the trapezoidal rule.

    Inside every smooth piece dE1 = (v2 - v1) dI1, dE2 = -v2 dI2 and F_i = dI_i/dt = sqrt(2 k_i E_i). The relative error
    of the trapezoidal rule is 4e-4 for a sinusoid with 48 points per half period, and falls with the square of the
    spacing.
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
    # A path may end with forces only where the stiffness ratio grows without bound, and a closed form finishes the
    # collision.
    assert end == PairEnding.PRECISION or not forces[:, -1].any()
