"""What (f, f', f'') at both ends of a window tell of a function inside it.

Each watched function of `model.events` is a sum of two sinusoids with known amplitudes, so that its second and its
sixth derivative are bounded by known numbers. Let H be the quintic that takes the values, slopes and second derivatives
of f at both ends of an interval of length h, and C the bound of the sixth derivative. Then
f(x h) >= H(x h) - C h^6 x^3 (1 - x)^3/720, and since x^3 (1 - x)^3 <= (B2 + B3)/40 in Bernstein polynomials of degree
five, f is positive inside the interval if the Bernstein coefficients of H satisfy b0, b1, b4, b5 >= 0 and
b2, b3 > C h^6/28800 (`positive_between`). The ends themselves may be zeros: the event that began the stretch, and the
root that will end it.
"""

from __future__ import annotations

from math import inf, sqrt

from impact_xval.model.compiled import inlined


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


@inlined
def near_miss(h, start, end):
    """Magnitude of an extremum inside a window, by a parabola; infinite if there is none."""
    spread = start[1] - end[1]
    value = abs(start[0] + 0.5 * h * start[1] * start[1] / spread)
    return value if start[1] * end[1] < 0 else inf


@inlined
def two_extrema(h, start, end):
    """Whether a function may turn twice inside a window: seen from either end, its slope tends to zero and beyond."""
    here, there = start[1] * (start[1] + h * start[2]), end[1] * (end[1] - h * end[2])
    return (start[1] * end[1] > 0) & (here < 0) & (there < 0)
