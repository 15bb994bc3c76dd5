"""Roots and bounds of a sum of two sinusoids.

`root_before` finds a root, which need not be the first root; the caller proves that it is. `positive_between` proves
that an interval has no root. `envelope_time` steps over a time that cannot have a root.

The function f is a rate or a force of a contact in S1. With the modal coordinates q_j of `pair.motion`, a rate is the
sum of c_j q_j over both modes j, and a force is the sum of c_j r_j with r_j = q_j'/omega_j. The amplitudes of f are
known, so its second and sixth derivatives have known bounds. Let H be the quintic with the values, slopes and second
derivatives of f at both ends of an interval of length h. Let C be the bound of the sixth derivative, and let x run from
0 to 1 over the interval. Then f(x h) >= H(x h) - C h^6 x^3 (1 - x)^3/720, and x^3 (1 - x)^3 <= (B2 + B3)/40 in
Bernstein polynomials of degree five. Hence f is positive inside the interval if the Bernstein coefficients of H satisfy
b0, b1, b4, b5 >= 0 and b2, b3 > C h^6/28800. The function may be zero at the ends: at the event that began the segment,
and at the root that ends it.

Used by `pair.events` and `pair.grazing`.
"""

from __future__ import annotations

from math import acos, atan2, pi, sqrt
from typing import NamedTuple

from impact_xval.model.compiled import force_inlined
from impact_xval.model.pair.motion import modal_coordinates, rotate_briefly

EPSILON = 2.0**-52

#: While `envelope_time` steps over a time, the function keeps at least this distance from zero, as a share of the sum
#: of its amplitudes. The number must not be below `pair.grazing.NEAR`: no turning point near zero may be stepped over.
ENVELOPE_RESERVE = 0.05

#: `root_before` halves its bracket once after each series of this many steps.
BISECT = 6

#: Longest step, in radians of the fast mode, after which the motion is computed by the short series of
#: `pair.motion.rotate_briefly`. The Taylor polynomial of degree seven is then exact to 1e-15 of an amplitude.
SERIES = 0.05


class Jet(NamedTuple):
    """Value, slope and second derivative of a function of time, at one time."""

    value: float
    slope: float
    bend: float


@force_inlined
def predict_root(h, start, end):
    """Return an estimate in (0, h) of the root of a function that is negative at h.

    `start` and `end` are the value, the slope and the second derivative at 0 and at h. The estimate is one step of
    Halley's method from h. A second step, on the polynomial of degree 5 with these values, corrects it.
    """
    f0, f1, slope, bend = start.value, end.value, h * end.slope, h * h * end.bend
    # In x = t/h the quintic is a0 + x (a1 + x (a2 + x (a3 + x (a4 + x a5)))).
    a1, a2 = h * start.slope, 0.5 * h * h * start.bend
    r0, r1, r2 = f1 - f0 - a1 - a2, slope - a1 - 2 * a2, 0.5 * bend - a2
    a3, a4, a5 = 10 * r0 - 4 * r1 + r2, -15 * r0 + 7 * r1 - 2 * r2, 6 * r0 - 3 * r1 + r2
    x = 1 - 2 * f1 * slope / (2 * slope * slope - f1 * bend)
    x = x if (x > 0) & (x < 1) else 0.5
    x2 = x * x
    f = (f0 + x * a1) + x2 * ((a2 + x * a3) + x2 * (a4 + x * a5))
    df = (a1 + x * 2 * a2) + x2 * ((3 * a3 + x * 4 * a4) + x2 * (5 * a5))
    ddf = (2 * a2 + x * 6 * a3) + x2 * (12 * a4 + x * 20 * a5)
    y = x - 2 * f * df / (2 * df * df - f * ddf)
    return h * (y if (y > 0) & (y < 1) else x)


@force_inlined
def step_to_root(x0, x1, y0, y1, w0, w1):
    """Return the step to a nearby root of f = x_0 + x_1, where f' = y_0 + y_1 and x_j'' = w_j x_j.

    The step is a Householder step of third order. A step of Newton's method on the Taylor polynomial of degree seven
    corrects it.
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


@force_inlined
def root_before(c, t, h, low, start, end, noise, omega, a, b):
    """Return a root, counted from t, of a function in (t + low, t + h), and the modal coordinates q and r at the root.

    The function is the sum of c_j q_j over both modes j. It is negative at t + h. `start` and `end` are its value,
    slope and second derivative at t and t + h, and `noise` is its rounding. `step_to_root` gives each next time that is
    tried. All times stay inside a bracket, which is halved regularly.
    """
    w0, w1 = -omega[0] * omega[0], -omega[1] * omega[1]
    g0, g1 = c[0] * omega[0], c[1] * omega[1]
    high, x, step = h, predict_root(h, start, end), h
    x = x if x > low else 0.5 * (low + h)
    q, r = modal_coordinates(t + x, omega, a, b)
    for i in range(1, 200):
        x0, x1, y0, y1 = c[0] * q[0], c[1] * q[1], g0 * r[0], g1 * r[1]
        f = x0 + x1
        if abs(f) <= noise or abs(step) <= EPSILON * (t + x):
            break
        step = step_to_root(x0, x1, y0, y1, w0, w1)
        low, high = max(low, x if f > 0 else low), min(high, x if f < 0 else high)
        falls = y0 + y1 < 0
        if falls and low < x + step < high and abs(step) * omega[1] < SERIES and i % BISECT != 0:
            x += step
            q, r = rotate_briefly(step, omega, q, r)
            continue
        if not (falls and low < x + step < high and i % BISECT != 0):
            step = 0.5 * (low + high) - x
        x += step
        q, r = modal_coordinates(t + x, omega, a, b)
    return x, q, r


@force_inlined
def envelope_time(lag, c, t, omega, a, b, radius):
    """Return the first time, not before t, at which a function may be near zero.

    The function is the sum of a slow and a fast sinusoid. It cannot be near zero while its slow sinusoid exceeds the
    amplitude of the fast sinusoid by more than `ENVELOPE_RESERVE` times the sum of both amplitudes. `lag` is 0 for a
    rate, and a quarter turn for a force, because a force is a sum of r_j. `radius` holds the amplitudes of both modal
    coordinates.
    """
    slow, fast = abs(c[0]) * radius[0], abs(c[1]) * radius[1]
    fast += ENVELOPE_RESERVE * (slow + fast)
    if slow <= fast:
        return t
    # The slow sinusoid is slow * cos(omega t - phase).
    phase = atan2(b[0], a[0]) - lag + (pi if c[0] < 0 else 0.0)
    angle = (omega[0] * t - phase) % (2 * pi)
    angle = angle - 2 * pi if angle > pi else angle
    least = acos(fast / slow)
    return t if abs(angle) >= least else t + (least - angle) / omega[0]


@force_inlined
def positive_between(start, end, h, C):
    """Return whether it is proven that a function is positive inside an interval of length h.

    `start` and `end` are its value, slope and second derivative at both ends. C is the bound of the sixth derivative,
    divided by 28800. The value at the end may be zero. If rounding makes it negative, it is taken as zero.
    """
    # The two comparisons are made without a branch. An unpredictable branch would cost more than this computation.
    reserve = C * (h * h * h) * (h * h * h)
    last = max(end.value, 0.0)
    step0, step1 = 0.2 * h * start.slope, -0.2 * h * end.slope
    bend = 0.05 * h * h
    outer = min(min(start.value, start.value + step0), last + step1)
    inner = min(start.value + 2 * step0 + bend * start.bend, last + 2 * step1 + bend * end.bend)
    return (outer >= 0) & (inner > reserve)


@force_inlined
def time_above_zero(start, B, w1):
    """Return a time for which a function f stays positive after it leaves zero.

    `start` holds its value 0, its slope, which is positive or 0, and its second derivative, which is positive if the
    slope is 0. With abs(f'') <= B the function is positive until t = 2 f'/B. If the slope is 0, which is so for contact
    2 at the start of a collision, the third derivative is 0, too. The fourth derivative is at most B w1^2, so the
    function is positive until t^2 = 12 f''/(B w1^2).
    """
    return 0.99 * (2 * start.slope / B if start.slope > 0 else sqrt(12 * start.bend / B) / w1)


@force_inlined
def leaves_zero(h, start, B, w1):
    """Return whether a function stays positive for a time h after it leaves zero: whether h < `time_above_zero`."""
    return (B * h < 1.98 * start.slope) | ((start.slope == 0) & (B * (w1 * h) * (w1 * h) < 11.7 * start.bend))
