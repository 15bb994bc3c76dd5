"""The search for the first event in state S1 misses none: close pairs of events, ties and tangencies.

The events are compared with densely sampled motion (brute force), and with the known event of states that are built
backwards from it. The certificates and the steps of the search are tested alone, too.
"""

import math
from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from impact_xval.model.pair import events, motion, roots
from tests.model.conftest import from_python

COMPRESSING, RESTORING = 1, 2

parts = events.first_event, motion.amplitudes, motion.modes_of, roots.positive_between, roots.step_to_root
first_event, amplitudes, modes_of, positive_between, step_to_root = map(from_python, parts)


def evolve(mu, k1, k2, state, times):
    """Return the states at equally spaced times, shape (4, n), or at one time, shape (4,), by the matrix exponential.

    Times may be negative. The equations of motion are d1' = F2/mu - (1 + 1/mu) F1, v2' = (F2 - F1)/mu, F1' = k1 d1 and
    F2' = -k2 v2, where d1 is the compression rate of contact 1 and F1, F2 are forces.
    """
    matrix = np.array([[0, 0, -(1 + 1 / mu), 1 / mu], [0, 0, -1 / mu, 1 / mu], [k1, 0, 0, 0], [0, -k2, 0, 0]])
    return np.moveaxis(expm(matrix * np.asarray(times)[..., None, None]) @ state, -1, 0)


def search(mu, k1, k2, state, phases=(COMPRESSING, COMPRESSING)):
    """Search the first event after a state; return it, the signs of the watched rates, and the amplitude of d1."""
    modes, (d1, v2, F1, F2) = modes_of(mu, k1, k2), map(float, state)
    a, b = amplitudes(d1, v2, F1 / k1, F2 / k2, modes)
    segment = events.Segment(
        mu=mu,
        modes=modes,
        signs=(1.0 if phases[0] == COMPRESSING else -1.0, -1.0 if phases[1] == COMPRESSING else 1.0),
        watches_force=(phases[0] == RESTORING, phases[1] == RESTORING),
        losses=(1.0, 1.0),  # restitutions of zero: every near miss counts for the grazing margin
        a=a,
        b=b,
    )
    event = first_event(segment, motion.Motion(d1, v2, F1, F2), math.inf)
    return event, segment.signs, np.abs(modes.delta) @ np.hypot(a, b)


def random_springs(rng):
    return 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(-2, 2), 10 ** rng.uniform(-2, 2)


def test_the_certificate_never_lies():
    """Wherever `positive_between` certifies a function as positive, all of 400 samples of the function are positive."""
    rng = np.random.default_rng(4)
    certified = 0
    for _ in range(3000):
        omega, size, phase = rng.uniform(0.1, 3, 2), rng.normal(size=2), rng.uniform(0, 2 * math.pi, 2)
        h = rng.uniform(0, 4) / omega.max()
        # each derivative shifts the phase of a sinusoid by a quarter of a period
        n = np.arange(3)[:, None, None]
        angles = np.linspace(0, h, 400)[:, None] * omega + phase
        f = (size * omega**n * np.cos(angles + 0.5 * math.pi * n)).sum(axis=2)
        start, end = (roots.Jet(*f[:, i].tolist()) for i in (0, -1))
        if f[0, -1] > 0 and positive_between(start, end, h, float(np.abs(size) @ omega**6 / 28800)):
            certified += 1
            assert f[0, 1:-1].min() > 0
    assert certified > 500


def test_a_step_to_a_root_is_of_order_seven_at_least():
    """A step to a root of two sinusoids, from a distance h, misses the root by an error that falls faster than h^7.

    With so high an order a few steps reach the precision of doubles.
    """
    h = np.array([0.2, 0.15, 0.1])
    for size, omega, phase in (((1, 0.4), (0.8, 2), (0.3, 1)), ((1, -0.3), (1, 3), (0.3, 0.2))):
        size, omega, phase = map(np.array, (size, omega, phase))
        root = brentq(lambda t, a=size, w=omega, p=phase: a @ np.cos(w * t + p), 0, 2, xtol=1e-15)
        angles = omega * (root - h[:, None]) + phase
        values, slopes = size * np.cos(angles), -size * omega * np.sin(angles)
        steps = [step_to_root(*x, *y, *-(omega**2)) for x, y in zip(values, slopes, strict=True)]
        assert np.polyfit(np.log(h), np.log(np.abs(steps - h)), 1)[0] > 7


@pytest.mark.slow
def test_first_event_against_brute_force():
    """No watched function is below zero before the event, and the one that fires is zero there, to 1e-13."""
    rng = np.random.default_rng(5)
    for _ in range(60):
        mu, k1, k2 = random_springs(rng)
        d1, v2 = rng.normal(size=2)
        F1, F2 = abs(rng.normal()) * math.sqrt(k1), abs(rng.normal()) * math.sqrt(k2)
        phases = (COMPRESSING if d1 > 0 else RESTORING, COMPRESSING if v2 < 0 else RESTORING)
        (time, fired, at_event, _, _), signs, _ = search(mu, k1, k2, (d1, v2, F1, F2), phases)
        assert any(fired)
        states = evolve(mu, k1, k2, (d1, v2, F1, F2), np.linspace(0, time, 150))
        assert at_event == pytest.approx(states[:, -1], abs=1e-12 * max(1, np.abs(states).max()))
        speed = np.abs(states[:2]).max() + np.abs(states[2:]).max() / math.sqrt(min(k1, k2))
        for i, (f, fires) in enumerate(zip(states, fired, strict=True)):
            if i > 1 and phases[i - 2] == COMPRESSING:
                assert not fires
                continue
            scale = speed * (math.sqrt(max(k1, k2)) if i > 1 else 1) * (1 + 1 / mu)
            assert (f * (*signs, 1, 1)[i]).min() > -1e-13 * scale
            assert not fires or abs(f[-1]) < 1e-13 * scale


def test_a_near_tangency_is_seen():
    """A compression rate that nearly touches zero fires if it dips below zero, or else gives a grazing margin.

    The rate turns around at the value `depth`. The start is built backwards: from the turning point, where d1 = depth
    and d1' = 0 < d1'', the equations of motion are followed back in time.
    """
    depths = [1e-4, 1e-6, 1e-8, 1e-10, 1e-12, -1e-12, -1e-10, -1e-8, -1e-4]
    for seed, depth in product(range(8), depths):
        rng = np.random.default_rng(seed)
        mu, k1, k2 = random_springs(rng)
        F1, v2 = rng.uniform(0.5, 2), -rng.uniform(0.5, 2)
        bottom = (depth, v2, F1, F1 * (1 + mu))  # at the turning point d1' = F2/mu - F1/M = 0
        lead = 0.8 / modes_of(mu, k1, k2).omega[1]
        start = evolve(mu, k1, k2, bottom, -lead)
        assert start[0] > 0 > start[1]
        (time, fired, _, margin, _), _, amplitude = search(mu, k1, k2, start)
        if depth < 0:
            curvature = -k2 * v2 / mu - k1 * depth * (1 + 1 / mu)
            assert fired[0], (seed, depth)
            before = lead - time  # the parabola depth + curvature before^2/2 = 0
            assert before == pytest.approx(math.sqrt(-2 * depth / curvature), rel=0.2), (seed, depth)
        else:
            assert time > lead, (seed, depth)
            assert margin == pytest.approx(depth / amplitude, rel=1e-3, abs=1e-13), (seed, depth)


def test_events_close_together_or_at_once():
    """Two compressions end at nearly the same time: the earlier end fires alone, and both fire if they end at once.

    The start is built backwards, from the state in which one rate is zero and the other is `apart` away from zero.
    """
    for seed, apart, first in product(range(8), (0.0, 1e-3, 1e-6, 1e-9, 1e-12), (0, 1)):
        rng = np.random.default_rng(seed)
        mu, k1, k2 = random_springs(rng)
        fast = modes_of(mu, k1, k2).omega[1]
        F1 = rng.uniform(1, 2)
        F2 = F1 * (1 + mu * rng.uniform(0.2, 0.8))  # this choice gives d1' < 0 < v2'
        rates = [0.0, 0.0]
        rates[1 - first] = apart if first == 1 else -apart
        start = evolve(mu, k1, k2, (*rates, F1, F2), -0.01 / fast)
        (time, fired, at_event, _, _), *_ = search(mu, k1, k2, start)
        case = seed, apart, first
        assert time == pytest.approx(0.01 / fast, rel=1e-9), case
        assert fired[2:] == (False, False), case
        if apart == 0:
            # The start is rounded, so one end may fire alone. The other rate is then zero to rounding.
            assert any(fired), case
            assert np.abs(at_event[:2]).max() < 1e-14 * np.abs(start).max() * (1 + math.sqrt(1 / mu)), case
        else:
            assert fired[:2] == (first == 0, first == 1), case
