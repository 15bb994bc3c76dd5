"""Roots and extrema of one sum of two sinusoids: the means of `model.events`.

Each function is f = sum c_j q_j (a rate) or sum c_j q_j' (a force) of the two modes of `model.motion`. None of these
decides what happens; that a root is the first one is certified by the caller.
"""

from __future__ import annotations

from math import acos, atan2, pi, sqrt

from model.compiled import compiled
from model.motion import modal, rotate

EPSILON = 2.0**-52

#: How far from zero, relative to its slow amplitude, a function stays where the envelope steps over it.
ENVELOPE_RESERVE = 0.05

#: While a root is closed in on, every BISECT-th step halves its bracket whatever is predicted.
BISECT = 6

#: Steps shorter than this (in radians of the fast mode) are rotations by a short series (`model.motion.rotate`).
SHORT_ROTATION = 0.1


@compiled
def predicted_root(h, f0, df0, f1, df1, ddf1):
    """Where in (0, h) a function with f1 < 0 at h vanished, as nearly as both ends tell.

    Halley's step from the end where that is near the root, else one Newton step on the cubic through both ends from the
    root of its parabola.
    """
    x = 0.0
    if df1 < 0:
        step = 2 * f1 * df1 / (2 * df1 * df1 - f1 * ddf1)
        if 0 < step < 0.1 * h:
            return h - step
        curve = (f0 - f1 + h * df1) / (h * h)
        discriminant = df1 * df1 - 4 * curve * f1
        if discriminant > 0:
            y = 2 * f1 / (sqrt(discriminant) - df1)
            # the cubic: parabola through f0, f1, df1 plus r y^2 (y + h), of slope df0 at y = -h
            r = (df0 - df1 + 2 * h * curve) / (h * h)
            x = y + h
            slope = df1 + y * (2 * curve + r * (3 * y + 2 * h))
            if slope < 0:
                x -= (f1 + y * (df1 + y * (curve + r * x))) / slope
    return x if 0 < x < h else 0.5 * h


@compiled
def root_before(force, c0, c1, t, h, low, f0, df0, q, p, noise, omega, a, b):
    """Root of one function in (t + low, t + h), at whose end it is negative; alone, so that an iteration costs little.

    Halley's iteration inside a bracket that is halved now and then, whatever the iteration says.

    Returns
    -------
    x : float
        The root, from t on.
    q, p : pairs
        Modal coordinates and rates there.
    """
    w0, w1 = -omega[0] * omega[0], -omega[1] * omega[1]
    high, x, step = h, h, h
    for i in range(200):
        if force:
            f, df, ddf = (
                c0 * p[0] + c1 * p[1],
                w0 * c0 * q[0] + w1 * c1 * q[1],
                w0 * c0 * p[0] + w1 * c1 * p[1],
            )
        else:
            f, df, ddf = c0 * q[0] + c1 * q[1], c0 * p[0] + c1 * p[1], w0 * c0 * q[0] + w1 * c1 * q[1]
        if abs(f) <= noise or abs(step) <= EPSILON * (t + x):
            break
        if f > 0:
            low = x
        else:
            high = x
        if i == 0:
            nxt = predicted_root(h, f0, df0, f, df, ddf)
        else:
            nxt = x - 2 * f * df / (2 * df * df - f * ddf) if df < 0 else low
        if not low < nxt < high or i % BISECT == BISECT - 1:
            nxt = 0.5 * (low + high)
        step, x = nxt - x, nxt
        if abs(step) * omega[1] < SHORT_ROTATION:
            q, p = rotate(step, omega, q, p)
        else:
            q, p = modal(t + x, omega, a, b)
    return x, q, p


@compiled
def extremum_between(c, t, h, f0, df0, df1, size, omega, a, b):
    """Value of the extremum in (t, t + h) of a watched rate whose slopes at the ends differ in sign.

    A parabola places it; where it comes near zero (of the amplitude `size`), Newton's iteration on f' makes it exact.
    """
    low, high = 0.0, h
    x = h * df0 / (df0 - df1)
    f = f0 + 0.5 * df0 * x
    if abs(f) > 0.1 * size:
        return f
    w0, w1 = omega[0] * omega[0], omega[1] * omega[1]
    for _ in range(20):
        q, p = modal(t + x, omega, a, b)
        f = c[0] * q[0] + c[1] * q[1]
        df = c[0] * p[0] + c[1] * p[1]
        ddf = -w0 * c[0] * q[0] - w1 * c[1] * q[1]
        if df * df0 > 0:
            low = x
        else:
            high = x
        nxt = x - df / ddf if ddf != 0 else low
        if not low < nxt < high:
            nxt = 0.5 * (low + high)
        if abs(nxt - x) < 1e-6 * h:
            break
        x = nxt
    return f


@compiled
def envelope_time(order, c, t, omega, a, b, radius):
    """Earliest time from t on at which the slow sinusoid of a watched function comes near its fast amplitude.

    Near is within `ENVELOPE_RESERVE` of the slow amplitude, so that no near-miss is stepped over unseen.
    """
    slow = abs(c[0]) * radius[0]
    fast = abs(c[1]) * radius[1]
    if order == 1:
        slow *= omega[0]
        fast *= omega[1]
    fast += ENVELOPE_RESERVE * slow
    if slow <= fast:
        return t
    # the slow part is slow * cos(omega t - phase)
    phase = atan2(b[0], a[0])
    if order == 1:
        phase -= 0.5 * pi
    if c[0] < 0:
        phase += pi
    now = (omega[0] * t - phase) % (2 * pi)
    if now > pi:
        now -= 2 * pi
    limit = acos(fast / slow)
    if abs(now) >= limit:
        return t
    return t + (limit - now) / omega[0]
