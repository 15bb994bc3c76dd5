"""The means of the search for first events, against scipy and against functions made to have the answer."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from impact_xval.model.grazing import NEAR, extremum_between
from impact_xval.model.roots import (
    ENVELOPE_RESERVE,
    EPSILON,
    envelope_time,
    root_before,
)


def value(c, omega, a, b, t, order=0):
    """f, f' or f'' of the sum of c_j (a_j cos(omega_j t) + b_j sin(omega_j t)), by the library's functions."""
    phase = 0.5 * math.pi * order  # a derivative turns a sinusoid by a quarter
    return sum(
        c[j] * omega[j] ** order * (a[j] * np.cos(omega[j] * t + phase) + b[j] * np.sin(omega[j] * t + phase))
        for j in (0, 1)
    )


def jet(c, omega, a, b, t):
    return tuple(float(value(c, omega, a, b, t, order)) for order in (0, 1, 2))


def pairs(rng, *ranges):
    return tuple(tuple(map(float, rng.uniform(low, high, 2))) for low, high in ranges)


def frequencies(rng):
    fast = 10 ** rng.uniform(-2, 2)
    return (float(fast * 10 ** rng.uniform(-3, 0)), float(fast))


def amplitude(c, a, b):
    return sum(abs(c[j]) * math.hypot(a[j], b[j]) for j in (0, 1))


def single_roots(rng, n):
    """Functions, and windows (t, t + h) that begin above zero, end below it, and hold one root."""
    while n:
        omega = frequencies(rng)
        c, a, b = pairs(rng, (-1, 1), (-1, 1), (-1, 1))
        t, h = float(rng.uniform(0, 100) / omega[1]), float(rng.uniform(0.1, 3.5) / omega[1])
        signs = np.sign(value(c, omega, a, b, t + np.linspace(0, h, 300)))
        if signs[0] > 0 > signs[-1] and np.count_nonzero(np.diff(signs)) == 1:
            n -= 1
            yield c, omega, a, b, t, h


def test_root_before_finds_the_root_and_the_state_there():
    for c, omega, a, b, t, h in single_roots(np.random.default_rng(1), 500):
        noise = 4 * EPSILON * amplitude(c, a, b)
        start, end = jet(c, omega, a, b, t), jet(c, omega, a, b, t + h)
        x, q, r = root_before(c, t, h, 0.0, start, end, noise, omega, a, b)
        assert 0 < x < h
        expected = brentq(lambda s: value(c, omega, a, b, s), t, t + h, xtol=1e-300, rtol=4 * EPSILON)  # noqa: B023
        slope = abs(value(c, omega, a, b, expected, 1))
        rounding = (1 + omega[1] * (t + h)) * 4 * noise
        assert abs(t + x - expected) <= rounding / slope + 8 * EPSILON * expected
        for j in (0, 1):
            w = omega[j] * (t + x)
            size = math.hypot(a[j], b[j]) * 8 * EPSILON * (1 + w)
            assert q[j] == pytest.approx(a[j] * math.cos(w) + b[j] * math.sin(w), abs=size)
            assert r[j] == pytest.approx(b[j] * math.cos(w) - a[j] * math.sin(w), abs=size)


def test_root_before_passes_over_the_zero_that_began_the_segment():
    rng = np.random.default_rng(2)
    tried = 0
    while tried < 200:
        omega = frequencies(rng)
        c, (a0, _), b = pairs(rng, (0.2, 1), (-1, 1), (-1, 1))
        a = (a0, -c[0] * a0 / c[1])  # f = 0 at t = 0
        h = float(rng.uniform(0.5, 3.5) / omega[1])
        inside = value(c, omega, a, b, np.linspace(0, h, 300)[1:])
        if inside[0] <= 0 or np.count_nonzero(np.diff(np.sign(inside))) != 1:
            continue
        tried += 1
        last = h * np.argmax(inside < 0) / 299  # sample above zero
        expected = brentq(lambda s: value(c, omega, a, b, s), last, h, xtol=1e-300, rtol=4 * EPSILON)  # noqa: B023
        noise = 4 * EPSILON * amplitude(c, a, b)
        start, end = (0.0, *jet(c, omega, a, b, 0.0)[1:]), jet(c, omega, a, b, h)
        x, _, _ = root_before(c, 0.0, h, 0.5 * expected, start, end, noise, omega, a, b)
        slope = abs(value(c, omega, a, b, expected, 1))
        assert abs(x - expected) <= 20 * noise / slope + 8 * EPSILON * expected


@pytest.mark.parametrize("height", [0.0, 1e-9, -1e-6, 1e-3, -0.03])
def test_extremum_between_is_exact_near_zero(height):
    """Functions made to have an extremum of that height (of about 2 in amplitude) at a known time."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        omega = frequencies(rng)
        omega = (0.9 * omega[0], omega[1])
        q0, r0 = rng.uniform(0.5, 1), rng.uniform(-1, 1)
        q, r = (q0, height - q0), (r0, -omega[0] * r0 / omega[1])  # at the extremum f = height, f' = 0
        at = float(rng.uniform(1, 50) / omega[1])
        turned = [(math.cos(w * at), math.sin(w * at)) for w in omega]
        a = tuple(float(q[j] * turned[j][0] - r[j] * turned[j][1]) for j in (0, 1))
        b = tuple(float(r[j] * turned[j][0] + q[j] * turned[j][1]) for j in (0, 1))
        c = (1.0, 1.0)
        size = amplitude(c, a, b)
        h = 0.2 / omega[1]
        t = at - float(rng.uniform(0.2, 0.8)) * h
        start, end = jet(c, omega, a, b, t), jet(c, omega, a, b, t + h)
        if start[1] * end[1] >= 0:
            continue  # two modes of nearly one frequency: hardly any curvature
        found = extremum_between(c, t, h, start, end, size, omega, a, b)
        assert found == pytest.approx(abs(height) / size, abs=1e-12)


def test_extremum_between_elsewhere_is_near_enough_to_tell():
    rng = np.random.default_rng(4)
    far = 0
    for _ in range(2000):
        omega = frequencies(rng)
        c, a, b = pairs(rng, (-1, 1), (-1, 1), (-1, 1))
        size = amplitude(c, a, b)
        t, h = float(rng.uniform(0, 100) / omega[1]), 1 / omega[1]
        start, end = jet(c, omega, a, b, t), jet(c, omega, a, b, t + h)
        if start[1] * end[1] >= 0:
            continue
        at = brentq(lambda s: value(c, omega, a, b, s, 1), t, t + h)  # noqa: B023
        true = abs(value(c, omega, a, b, at)) / size
        found = extremum_between(c, t, h, start, end, size, omega, a, b)
        if true < 0.5 * NEAR:
            assert found == pytest.approx(true, abs=1e-11)
        else:
            far += 1
            assert found == pytest.approx(true, abs=0.5 * NEAR)
    assert far > 100


@pytest.mark.parametrize("order", [0, 1])
def test_envelope_time_is_when_the_slow_part_comes_down_to_the_fast_amplitude(order):
    """Against the slow part itself, sampled: above that until then, at it then."""
    rng = np.random.default_rng(5 + order)
    skipped = 0
    for _ in range(500):
        omega = frequencies(rng)
        c, a, b = pairs(rng, (-1, 1), (-1, 1), (-1, 1))
        c = (c[0], 0.3 * c[1])
        t = float(rng.uniform(0, 20) / omega[0])
        radius = tuple(math.hypot(a[j], b[j]) for j in (0, 1))
        near = abs(c[1]) * radius[1] + ENVELOPE_RESERVE * abs(c[0]) * radius[0]

        def slow(s, c=c, a=a, b=b, w=omega[0]):
            rate = a[0] * np.cos(w * s) + b[0] * np.sin(w * s)
            force = b[0] * np.cos(w * s) - a[0] * np.sin(w * s)
            return c[0] * (rate, force)[order]

        found = envelope_time(order, c, t, omega, a, b, radius)
        if found == t:
            assert slow(t) <= near * (1 + 1e-9)
            continue
        skipped += 1
        assert found > t
        assert np.all(slow(np.linspace(t, found, 200)[:-1]) > near * (1 - 1e-9))
        assert slow(found) == pytest.approx(near, abs=1e-11 * abs(c[0]) * radius[0])
    assert skipped > 100
