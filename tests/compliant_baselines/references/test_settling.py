"""When a column is certain to be stuck: against the matrix exponential."""

import numpy as np
from scipy.linalg import expm

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.references.ending import eliminate, settled
from impact_xval.compliant_baselines.references.kelvin_voigt import dampings, kelvin_voigt_batch
from impact_xval.model import Collision
from tests.compliant_baselines.reference_cells import random_cells

G = 0.3


def columns(n, seed):
    """Random columns and states about their equilibrium: heights x1, x2 and velocities."""
    rng = np.random.default_rng(seed)
    kappa, mu, e1, e2 = random_cells(n, seed)
    _, c1, c2 = dampings("pair", kappa, mu, e1, e2)
    for i in range(n):
        m, k = np.diag([1, mu[i]]), kappa[i]
        stiff, damp = (np.array([[a, -a], [-a, a + b]]) for a, b in ((1, k), (c1[i], c2[i])))
        inverse = np.linalg.inv(m)
        a = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiff, -inverse @ damp]])
        yield (mu[i], k, c1[i], c2[i]), a, rng.normal(size=4)


def kernel_state(y, kappa, g=G):
    """(p1, d1, q2, v2) of heights and velocities about equilibrium; the kernel's k1 is 1."""
    x1, x2, v1, v2 = y
    return x2 - x1 + g, v2 - v1, -x2 + g / kappa, v2


def largest(mu, k, c1, c2, a, y):
    """Largest force beyond the weight, over that weight, of both contacts along 1500 short steps."""
    step, most = expm(a * 0.05 / np.sqrt(max(1, k, 1 / mu))), 0.0
    for _ in range(1500):
        p1, d1, q2, v2 = kernel_state(y, k)
        f1, f2 = p1 - G + c1 * d1, k * q2 - G - c2 * v2
        most = max(most, abs(f1) / G, abs(f2) / ((1 + mu) * G))
        y = step @ y
    return most


def test_a_settled_column_never_lets_go_and_one_that_does_is_not_settled():
    sharp = []
    for column, a, y in columns(60, 1):
        k = column[1]
        y = y / largest(*column, a, y)  # the largest force just unloads its contact
        assert not settled(*column, G, *kernel_state(1.01 * y, k))
        sharp.append(
            max(s for s in (0.1, 0.3, 0.5, 0.7, 0.9) if settled(*column, G, *kernel_state(s * y, k)))
        )
    assert np.median(sharp) >= 0.7


def test_columns_that_ring_for_ever_are_stuck_at_once():
    # e2 = 1 on a soft table: of the slow motion next to nothing reaches the damped contact. Two million segments did
    # not end these, cells of the default grid at k1 = 1e6 and 1e5 N/m.
    for ratio, mass, e1, k1 in ((1e-3, 2.0, 0.5, 1e6), (10**-2.5, 2.0, 0.5, 1e6), (1e-2, 2.0, 0.5, 1e5)):
        c = Collision(1.0, mass, k1, ratio * k1, e1, 1.0, -1.0)
        outcome = get_solver("kelvin-voigt").solve(c, Settings(scenario="drop"))
        assert (outcome.v1, outcome.v2) == (0, 0)
        assert outcome.diagnostics["n_steps"] < 1000
        batch = kelvin_voigt_batch(ratio, mass, e1, 1.0, 9.81 / np.sqrt(k1 * (1 + 1 / mass)))
        assert batch.end == "stuck"


def test_an_elastic_column_that_cannot_part_is_stuck():
    start = kernel_state(np.array([5.0, 5.0, 0.01, 0.0]), 0.05)
    assert settled(1.0, 0.05, 0.0, 0.0, G, *start)


def test_elimination_solves_and_gives_the_determinant():
    rng = np.random.default_rng(2)
    for _ in range(50):
        real, imaginary = rng.normal(size=(2, 4, 5))
        A, b = (real + 1j * imaginary)[:, :4].copy(), (real + 1j * imaginary)[:, 4].copy()
        A[0, 0] *= rng.integers(2)  # a pivot of zero is no end
        x = b.copy()
        assert np.isclose(eliminate(A.copy(), x), abs(np.linalg.det(A)))
        np.testing.assert_allclose(A @ x, b, atol=1e-12)
    A[1] = A[3] = 0
    assert eliminate(A, b) == 0
