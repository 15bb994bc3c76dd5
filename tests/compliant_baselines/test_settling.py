"""The leap of a settling drop against the matrix exponential, and against the stretches it replaces."""

import numpy as np
import pytest
from scipy.linalg import expm

from compliant_baselines import get_solver
from compliant_baselines.contract import Settings
from compliant_baselines.kelvin_voigt import dampings, kelvin_voigt_batch
from compliant_baselines.settling import quiet, settle
from model import Collision
from tests.compliant_baselines.reference_cells import random_cells

G = 0.3


def columns(n, seed):
    """Random columns and states about their equilibrium (heights x1, x2 and velocities) of E(y') = 0.99 G^2."""
    rng = np.random.default_rng(seed)
    kappa, mu, e1, e2 = random_cells(n, seed)
    _, c1, c2 = dampings("pair", kappa, mu, e1, e2)
    for i in range(n):
        m, k = np.diag([1, mu[i]]), kappa[i]
        stiff, damp = (np.array([[a, -a], [-a, a + b]]) for a, b in ((1, k), (c1[i], c2[i])))
        inverse = np.linalg.inv(m)
        a = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiff, -inverse @ damp]])
        y = rng.normal(size=4)
        rates = a @ y
        y *= G * np.sqrt(0.99 / (rates[2:] @ m @ rates[2:] + rates[:2] @ stiff @ rates[:2]))
        yield (mu[i], k, c1[i], c2[i]), a, stiff, m, y


def kernel_state(y, kappa, g=G):
    """(p1, d1, q2, v2) of heights and velocities about equilibrium; the kernel's k1 is 1."""
    x1, x2, v1, v2 = y
    return x2 - x1 + g, v2 - v1, -x2 + g / kappa, v2


def test_a_quiet_column_never_lets_go():
    for (mu, k, c1, c2), a, _, _, y in columns(60, 1):
        assert quiet(mu, k, c1, c2, G, *kernel_state(y, k))
        assert not quiet(mu, k, c1, c2, G, *kernel_state(1.01 * y, k))
        step = expm(a * 0.05 / np.sqrt(max(1, k, 1 / mu)))
        for _ in range(1000):
            y = step @ y
            p1, d1, q2, v2 = kernel_state(y, k)
            assert p1 + c1 * d1 > 0
            assert k * q2 + mu * G - c2 * v2 > 0


def test_the_leap_is_the_exponential_and_ends_where_the_energy_is_still_too_large():
    leapt = 0
    for (mu, k, c1, c2), a, stiff, m, y in columns(200, 2):
        start = kernel_state(y, k)
        *state, time = settle(mu, k, c1, c2, G, *start)
        if time == 0:
            continue
        leapt += 1
        there = expm(a * time) @ y
        np.testing.assert_allclose(state, kernel_state(there, k), atol=1e-11)
        least = G * G * min(1, (1 + mu) ** 2 / k)

        def energy(z, stiff=stiff, m=m):
            return z[2:] @ m @ z[2:] + z[:2] @ stiff @ z[:2]

        assert energy(there) > least
        # and a stretch of the kernel later, at most 2 over the slowest frequency there is, no longer
        assert energy(expm(a * (time + 2 / np.sqrt(min(k, 1) / (1 + mu)))) @ y) <= least
    assert leapt > 20


def test_with_and_without_the_leap():
    cells = random_cells(1500, 5)
    batch = kelvin_voigt_batch(*cells, 0.05)
    stuck = np.flatnonzero(batch.end == "stuck")[:30]
    assert len(stuck) == 30
    saved = 0
    for i in stuck:
        c = Collision.from_ratios(*(x[i] for x in cells))
        g = 0.05 * np.sqrt(1 + 1 / c.mass_ratio)
        outcome = get_solver("kelvin-voigt").solve(c, Settings(scenario="drop", gravity=g))
        assert (outcome.v1, outcome.v2) == (0, 0)
        assert outcome.diagnostics["duration"] == pytest.approx(batch.duration[i], rel=1e-9)
        assert outcome.impulse2 == pytest.approx(batch.impulse2[i], rel=1e-9)
        assert outcome.states[-32:] == batch.states(i)
        saved += outcome.diagnostics["n_steps"] > 2 * batch.n_steps[i]
    assert saved > 8


def test_an_elastic_column_never_settles():
    batch = kelvin_voigt_batch(0.05, 1.0, 1.0, 1.0, 0.3)
    assert batch.status in ("ok", "timeout")
    start = kernel_state(np.array([5.0, 5.0, 0.01, 0.0]), 0.05)
    assert quiet(1.0, 0.05, 0.0, 0.0, G, *start)
    assert settle(1.0, 0.05, 0.0, 0.0, G, *start)[4] == np.inf
