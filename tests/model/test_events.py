"""The first event in S1 is never missed: close pairs, ties, tangencies, against brute force."""

import math

import numpy as np
import pytest

from model import Collision, solve
from model.events import first_event, positive_between, value
from model.motion import amplitudes, modal, modes, motion, single_contact

WATCH_ALL = (True, True, True, True)


def stretch(rng):
    """A random S1 state of a random two-spring system, and the four functions watched in it."""
    mu, k1, k2 = 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(-2, 2), 10 ** rng.uniform(-2, 2)
    d1, v2, F1, F2 = rng.normal(), rng.normal(), abs(rng.normal()) * math.sqrt(k1), abs(rng.normal()) * math.sqrt(k2)
    omega, phi1, phi2, delta, sigma = modes(mu, k1, k2)
    a, b = amplitudes(d1, v2, F1, F2, omega, phi1, phi2, delta, sigma)
    s1, s2 = math.copysign(1, d1), math.copysign(1, v2)
    c = ((s1 * delta[0], s1 * delta[1]), (s2 * phi2[0], s2 * phi2[1]), phi1, sigma)
    return c, omega, a, b


def search(c, omega, a, b, active=WATCH_ALL):
    no, zero = (False,) * 4, (0.0,) * 4
    return first_event(active, (0, 0, 1, 1), c, no, zero, zero, omega, a, b)


def on_grid(c, omega, a, b, t):
    q = [a[j] * np.cos(omega[j] * t) + b[j] * np.sin(omega[j] * t) for j in (0, 1)]
    p = [omega[j] * (b[j] * np.cos(omega[j] * t) - a[j] * np.sin(omega[j] * t)) for j in (0, 1)]
    return [value.py_func(order, cc, q, p, omega)[0] for order, cc in zip((0, 0, 1, 1), c, strict=True)]


def test_modes_solve_the_equations_of_motion():
    """K phi = omega^2 diag(1, mu) phi row by row, of unit modal mass; states are recovered from modal coordinates."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        mu, k1, k2 = 10 ** rng.uniform(-4, 4), 10 ** rng.uniform(-4, 4), 10 ** rng.uniform(-4, 4)
        omega, phi1, phi2, delta, sigma = modes(mu, k1, k2)
        for j in (0, 1):
            rows = (k1 * (phi1[j] - phi2[j]), k2 * phi2[j] - k1 * (phi1[j] - phi2[j]))
            sizes = (k1 * (abs(phi1[j]) + abs(phi2[j])), (k1 + k2) * abs(phi2[j]) + k1 * abs(phi1[j]))
            for row, size, mass, phi in zip(rows, sizes, (1, mu), (phi1[j], phi2[j]), strict=True):
                assert row == pytest.approx(omega[j] ** 2 * mass * phi, abs=1e-14 * size)
            assert phi1[j] ** 2 + mu * phi2[j] ** 2 == pytest.approx(1, rel=1e-14)
            assert delta[j] == pytest.approx(phi2[j] - phi1[j], abs=1e-14 * (abs(phi1[j]) + abs(phi2[j])))
            assert sigma[j] == pytest.approx(phi1[j] + mu * phi2[j], abs=1e-14 * (abs(phi1[j]) + mu * abs(phi2[j])))
        assert omega[0] < omega[1]
        state = rng.normal(size=4)
        a, b = amplitudes(*state, omega, phi1, phi2, delta, sigma)
        q, p = modal(0.0, omega, a, b)
        scale = np.abs(state).max() * max(1, math.sqrt(max(k1, k2)), math.sqrt(max(mu, 1 / mu)))
        assert motion(q, p, phi1, phi2, delta, sigma) == pytest.approx(state, abs=1e-12 * scale)


def test_the_certificate_never_lies():
    """Wherever it says positive, ten thousand samples of f are."""
    rng = np.random.default_rng(4)
    certified = 0
    for _ in range(3000):
        c, omega, a, b = stretch(rng)
        h = rng.uniform(0, 2) / omega[1]
        t = np.linspace(0, h, 400)
        f = on_grid(c, omega, a, b, t)[0]
        radius = [math.hypot(a[j], b[j]) for j in (0, 1)]
        C = sum(abs(c[0][j]) * radius[j] * omega[j] ** 4 for j in (0, 1))
        slopes = [value(0, c[0], *modal(x, omega, a, b), omega)[1] for x in (0.0, h)]
        if positive_between(f[0], slopes[0], f[-1], slopes[1], h, C):
            certified += 1
            assert f[1:-1].min() > 0
    assert certified > 500


def test_first_event_against_brute_force():
    """No watched function is negative before the event, and the one that fires is zero there."""
    rng = np.random.default_rng(5)
    for _ in range(2000):
        c, omega, a, b = stretch(rng)
        time, fired, _, _ = search(c, omega, a, b)
        assert any(fired)
        before = on_grid(c, omega, a, b, np.linspace(0, time, 2000))
        scales = [sum(abs(cc[j]) * math.hypot(a[j], b[j]) * (omega[j] if i > 1 else 1) for j in (0, 1)) for i, cc in enumerate(c)]
        for f, scale, fires in zip(before, scales, fired, strict=True):
            assert f.min() > -1e-14 * scale * (10 + omega[1] * time)
            if fires:
                assert abs(f[-1]) < 1e-13 * scale * (1 + omega[1] * time)


@pytest.mark.parametrize("depth", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, -1e-12, -1e-10, -1e-8, -1e-4])
def test_two_roots_arbitrarily_close_are_not_stepped_over(depth):
    """f = 1 - cos(t - 1) - depth touches zero around t = 1: two roots sqrt(2 depth) apart either side, or none.

    Built from one function of two modes: a slow one that is nearly constant, and a fast cosine.
    """
    slow = 1e-3
    omega = (slow, 1.0)
    a = (1.0 - depth, -math.cos(1.0))
    b = (0.0, -math.sin(1.0))
    c = ((1.0, 1.0), (1.0, 0.0), (1.0, 0.0), (1.0, 0.0))
    time, fired, margin, _ = search(c, omega, a, b, (True, False, False, False))
    assert fired[0]
    # The slow cosine lowers each touching point a little more than the one before.
    touching = 1 + 2 * math.pi * np.arange(1000)
    height = (1 - depth) * np.cos(slow * touching) - 1
    crossing = np.argmax(height < 0)
    assert time == pytest.approx(touching[crossing] - math.acos(1 + height[crossing]), abs=1e-4)
    if crossing > 0:
        assert margin == pytest.approx(height[:crossing].min(), rel=1e-3)


def test_events_close_together_or_at_once_are_all_found():
    """Two functions whose roots are d apart: the earlier fires; within rounding both do, in whatever order given."""
    omega = (0.7, 1.9)
    a, b = (0.8, 0.3), (0.1, -0.2)
    base = (0.5, 0.4)
    alone = search((base, base, base, base), omega, a, b, (True, False, False, False))[0]
    # a multiple of the same function has the same root: a tie
    double = (2 * base[0], 2 * base[1])
    for c in ((base, double, base, base), (double, base, base, base)):
        time, fired, _, _ = search(c, omega, a, b, (True, True, False, False))
        assert time == pytest.approx(alone, rel=1e-14)
        assert fired[:2] == (True, True)
    # one a hair earlier: at the root, the slow mode is negative, and more of it brings the root forward
    for d in (1e-3, 1e-6, 1e-9, 1e-12):
        earlier = (base[0] + d, base[1])
        for c, i in (((base, earlier, base, base), 1), ((earlier, base, base, base), 0)):
            time, fired, _, _ = search(c, omega, a, b, (True, True, False, False))
            assert time < alone
            assert fired[:2] == (i == 0, i == 1)


def test_the_collision_starts_off_the_expansion():
    """At first touch delta2' is zero to higher order; a search that looked at signs would end its compression there."""
    outcome = solve(Collision.from_ratios(1, 1.3, 0.8, 0.8), path=True)
    assert outcome.events[0].time > 0.1
    early = outcome.path.time < 0.05
    t = outcome.path.time[early]
    # I2 = (k2/k1) I1^2/(6 m2 |v0|) + ... reads, in time, with I1 = t^2/2: I2 = t^4/24 / m2
    assert outcome.path.impulse2[early] == pytest.approx(t**4 / 24 / 1.3, rel=1e-2, abs=1e-16)


def test_single_contact_against_the_supplement():
    """Section 1, both phases: the impulse that spends the contact, and the energy on the way."""
    M, d, E, e = 0.7, 0.9, 0.3, 0.6
    returns, ended, impulse, d_exit, E_exit = single_contact(M, d, E, e, True, math.inf)
    assert (returns, ended, E_exit) == (False, True, 0.0)
    assert impulse == pytest.approx(M * (d + e * math.sqrt(d * d + 2 * E / M)), rel=1e-15)
    returns, ended, impulse, d_exit, E_exit = single_contact(M, -d, E, e, False, math.inf)
    assert impulse == pytest.approx(M * (-d + math.sqrt(d * d + 2 * E / M)), rel=1e-15)
    # in between, equation (4): energy after the loss
    part = M * d * 1.3
    returns, ended, impulse, d_exit, E_exit = single_contact(M, d, E, e, True, part)
    assert (returns, ended, impulse) == (True, True, part)
    lost = (1 - e * e) * (E + 0.5 * M * d * d)
    assert E_exit == pytest.approx(E + d * part - part**2 / (2 * M) - lost, rel=1e-13)


@pytest.mark.parametrize("swap", [False, True])
def test_a_tie_between_the_contacts_is_symmetric_under_their_exchange(swap):
    """Both compressions end at once in a state made symmetric: both fire, whichever is listed first."""
    omega = (0.6, 1.4)
    a, b = (1.0, 0.2), (0.0, 0.0)
    first, second = (0.5, 0.1), (1.0, 0.2)
    c = (second, first, first, first) if swap else (first, second, first, first)
    _, fired, _, _ = search(c, omega, a, b, (True, True, False, False))
    assert fired == (True, True, False, False)
