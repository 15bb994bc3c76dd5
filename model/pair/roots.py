"""Roots and extrema of one sum of two sinusoids: the means of `pair.events`.

Each function is f = sum c_j q_j (a rate) or sum c_j q_j' (a force) of the two modes of `pair.motion`. None of these
decides what happens; that a root is the first one is certified by the caller.

The amplitudes are known, so that the second and the sixth derivative are bounded by known numbers. Let H be the quintic
that takes the values, slopes and second derivatives of f at both ends of an interval of length h, and C the bound of
the sixth derivative. Then f(x h) >= H(x h) - C h^6 x^3 (1 - x)^3/720, and since x^3 (1 - x)^3 <= (B2 + B3)/40 in
Bernstein polynomials of degree five, f is positive inside the interval if the Bernstein coefficients of H satisfy b0,
b1, b4, b5 >= 0 and b2, b3 > C h^6/28800 (`positive_between`). The ends themselves may be zeros: the event that began
the segment, and the root that will end it.
"""

from __future__ import annotations

from math import acos, atan2, pi, sqrt

from impact_xval.model.compiled import inlined
from impact_xval.model.pair.motion import modal, turn_little

EPSILON = 2.0**-52

#: How far from zero, relative to the sum of its amplitudes, a function stays where the envelope steps over it; not less
#: than `pair.grazing.NEAR`, so that no near-miss is stepped over.
ENVELOPE_RESERVE = 0.05

#: While a root is closed in on, every BISECT-th step halves its bracket whatever is predicted.
BISECT = 6

#: Steps to a root shorter than this (in radians of the fast mode) are found from the Taylor polynomial of degree seven,
#: which is then exact to 1e-15 of an amplitude; and the motion follows by the series of `pair.motion.turn_little`.
SERIES = 0.05


@inlined
def predicted_root(h, start, end):
    """Where in (0, h) a function with end[0] < 0 vanished, as nearly as (f, f', f'') at both ends tell.

    Halley's step from the end, bettered by another on the quintic through both ends.
    """
    f0, f1, slope, curve = start[0], end[0], h * end[1], h * h * end[2]
    # in x = t/h, a0 + x (a1 + x (a2 + x (a3 + x (a4 + x a5))))
    a1, a2 = h * start[1], 0.5 * h * h * start[2]
    r0, r1, r2 = f1 - f0 - a1 - a2, slope - a1 - 2 * a2, 0.5 * curve - a2
    a3, a4, a5 = 10 * r0 - 4 * r1 + r2, -15 * r0 + 7 * r1 - 2 * r2, 6 * r0 - 3 * r1 + r2
    x = 1 - 2 * f1 * slope / (2 * slope * slope - f1 * curve)
    x = x if (x > 0) & (x < 1) else 0.5
    x2 = x * x
    f = (f0 + x * a1) + x2 * ((a2 + x * a3) + x2 * (a4 + x * a5))
    df = (a1 + x * 2 * a2) + x2 * ((3 * a3 + x * 4 * a4) + x2 * (5 * a5))
    ddf = (2 * a2 + x * 6 * a3) + x2 * (12 * a4 + x * 20 * a5)
    y = x - 2 * f * df / (2 * df * df - f * ddf)
    return h * (y if (y > 0) & (y < 1) else x)


@inlined
def step_to_root(x0, x1, y0, y1, w0, w1):
    """Step from a point to a root nearby of f = x_0 + x_1, f' = y_0 + y_1, x_j'' = w_j x_j.

    Householder's step of third order, bettered by one of Newton's on the Taylor polynomial of degree seven.
    """
    f, df = x0 + x1, y0 + y1
    w00, w11 = w0 * w0, w1 * w1
    c2, c3 = 0.5 * (w0 * x0 + w1 * x1), (w0 * y0 + w1 * y1) * (1 / 6)
    c4, c5 = (w00 * x0 + w11 * x1) * (1 / 24), (w00 * y0 + w11 * y1) * (1 / 120)
    c6, c7 = (w00 * w0 * x0 + w11 * w1 * x1) * (1 / 720), (w00 * w0 * y0 + w11 * w1 * y1) * (1 / 5040)
    u, v = df * df, f * c2
    s = -f * (u - v) / (df * (u - 2 * v) + f * f * c3)
    s2 = s * s
    g = ((f + s * df) + s2 * (c2 + s * c3)) + s2 * s2 * ((c4 + s * c5) + s2 * (c6 + s * c7))
    dg = (df + s * 2 * c2) + s2 * ((3 * c3 + s * 4 * c4) + s2 * (5 * c5 + s * 6 * c6))
    return s - g / dg


@inlined
def root_before(c, t, h, low, start, end, noise, omega, a, b):
    """Root of sum c_j q_j in (t + low, t + h), at whose end it is negative; alone, so that an iteration costs little.

    From each point tried the step of `step_to_root`, inside a bracket that is halved now and then, whatever the step.
    Gives the root, from t on, and the modal coordinates q and r there.
    """
    w0, w1 = -omega[0] * omega[0], -omega[1] * omega[1]
    g0, g1 = c[0] * omega[0], c[1] * omega[1]
    high, x, step = h, predicted_root(h, start, end), h
    x = x if x > low else 0.5 * (low + h)
    q, r = modal(t + x, omega, a, b)
    for i in range(1, 200):
        x0, x1, y0, y1 = c[0] * q[0], c[1] * q[1], g0 * r[0], g1 * r[1]
        f = x0 + x1
        if abs(f) <= noise or abs(step) <= EPSILON * (t + x):
            break
        step = step_to_root(x0, x1, y0, y1, w0, w1)
        low, high = max(low, x if f > 0 else low), min(high, x if f < 0 else high)
        if y0 + y1 < 0 and low < x + step < high and abs(step) * omega[1] < SERIES and i % BISECT != 0:
            x += step
            q, r = turn_little(step, omega, q, r)
            continue
        if not (y0 + y1 < 0 and low < x + step < high and i % BISECT != 0):
            step = 0.5 * (low + high) - x
        x += step
        q, r = modal(t + x, omega, a, b)
    return x, q, r


@inlined
def envelope_time(lag, c, t, omega, a, b, radius):
    """Earliest time from t on at which the slow sinusoid of a watched function comes near its fast amplitude.

    Near is within `ENVELOPE_RESERVE` of the sum of both amplitudes. A rate lags 0, a force a quarter turn behind q_j.
    """
    slow, fast = abs(c[0]) * radius[0], abs(c[1]) * radius[1]
    fast += ENVELOPE_RESERVE * (slow + fast)
    if slow <= fast:
        return t
    # the slow part is slow * cos(omega t - phase)
    phase = atan2(b[0], a[0]) - lag + (pi if c[0] < 0 else 0.0)
    now = (omega[0] * t - phase) % (2 * pi)
    now = now - 2 * pi if now > pi else now
    limit = acos(fast / slow)
    return t if abs(now) >= limit else t + (limit - now) / omega[0]


@inlined
def positive_between(start, end, h, C):
    """Certify f > 0 inside an interval of length h, given (f, f', f'') at its ends and its sixth derivative's bound.

    C is that bound divided by 28800. The end may be a zero, and is taken for one where rounding makes it negative.
    """
    # One comparison, for branches that cannot be foretold cost more than all of this.
    reserve = C * (h * h * h) * (h * h * h)
    last = max(end[0], 0.0)
    step0, step1 = 0.2 * h * start[1], -0.2 * h * end[1]
    bend = 0.05 * h * h
    ends = min(min(start[0], start[0] + step0), last + step1)
    middle = min(start[0] + 2 * step0 + bend * start[2], last + 2 * step1 + bend * end[2])
    return (ends >= 0) & (middle > reserve)


@inlined
def time_above_zero(start, B, w1):
    """How long a function is positive that leaves zero with start[1] > 0, or with start[1] = 0 and start[2] > 0.

    With abs(f'') <= B it is so up to t = 2 f'/B. Where its slope vanishes (contact 2 when the collision begins) its
    third derivative does as well, and with a fourth one within B w1^2 it is positive up to t^2 = 12 f''/(B w1^2).
    """
    return 0.99 * (2 * start[1] / B if start[1] > 0 else sqrt(12 * start[2] / B) / w1)


@inlined
def leaves_zero(h, start, B, w1):
    """Whether h is below `time_above_zero`, without its division."""
    return (B * h < 1.98 * start[1]) | ((start[1] == 0) & (B * (w1 * h) * (w1 * h) < 11.7 * start[2]))
