"""The first root of a polynomial on the unit interval, found with certainty: `first_root`.

The method divides the interval into parts, and proves for each part before the root that the polynomial f is positive
there. So it steps over no root, and over no pair of close roots. There are two proofs.

**By a cubic.** Let a_n be the coefficients of f, and C = sum n (n-1) (n-2) (n-3) abs(a_n). Then abs(f'''') <= C on [0,
1]. Let H be the cubic that has the values and the slopes of f at both ends of an interval of length w, and let x run
from 0 to 1 over the interval. Then f differs from H by at most C w^4 x^2 (1 - x)^2/24. In Bernstein polynomials B1 and
B2 of degree three, x^2 (1 - x)^2 <= (B1 + B2)/12. Hence f > 0 inside the interval if the two outer Bernstein
coefficients of H are >= 0 and the two inner coefficients exceed C w^4/288.

**By signs.** A polynomial may start near zero and grow with a high power, such as the force of a contact far ahead of a
wave. The cubic would prove it positive on tiny intervals only. Therefore the sum P of the positive terms is compared
with the sum N of the magnitudes of the negative terms. Both sums increase, so f > 0 on [x, y] if P(x) > N(y).

If f changes its sign in an interval, the root is computed, and the part before the root has to be proven positive. An
interval for which no proof succeeds is halved.

**Start at zero.** A polynomial that is zero at 0 is first divided by the power of x with which it begins. So this zero
is not found again. (The force of contact 2 of a pair starts with a zero of third order.)

Used by `chain.event` and `chain.grazing`.
"""

from __future__ import annotations

from math import inf, sqrt

from impact_xval.model.compiled import kernel_helper

#: Length, as a share of the window, below which an interval is not divided any further: within it the polynomial
#: touches zero to rounding.
SHORTEST = 1e-10

#: Largest number of intervals. A search that needs more is given up. If numbers overflow it would otherwise never end.
MOST_INTERVALS = 500


@kernel_helper
def value_and_slope(f, sign, f0, first, degree, x):
    """Return the value and the slope at x of the quotient of `sign` times a polynomial f and x^first.

    The value of the quotient at 0 is f0.
    """
    value, slope = f[degree], 0.0
    for n in range(degree - 1, first, -1):
        slope = slope * x + value
        value = value * x + f[n]
    if first < degree:
        slope = slope * x + value
        value = sign * value * x + f0
    else:
        value = f0
    return value, sign * slope


@kernel_helper
def is_positive(f0, df0, f1, df1, w, C):
    """Return whether f > 0 is proven inside an interval of length w.

    f0, df0, f1 and df1 are the values and slopes of f at both ends, and C bounds its fourth derivative.
    """
    reserve = C * (w * w) * (w * w) / 288
    return f1 >= 0 and f0 + w * df0 / 3 > reserve and f1 - w * df1 / 3 > reserve


@kernel_helper
def signed_sums(f, sign, start, first, degree, x):
    """Return the sum of the positive terms of a polynomial at x, and the sum of the magnitudes of the negative terms.

    The polynomial is the quotient of `sign` times f and x^first. Its value at 0 is `start`.
    """
    positive, negative = 0.0, 0.0
    for n in range(degree, first, -1):
        term = sign * f[n]
        positive = positive * x + max(term, 0.0)
        negative = negative * x + max(-term, 0.0)
    return positive * x + start, negative * x


@kernel_helper
def refine(f, sign, start, first, degree, low, high, f0, f1, df1):
    """Return a root in (low, high] of a function that is positive at `low` and not positive at `high`, and its slope.

    The method is Newton's, inside the bracket. It starts from the root of a parabola. Its steps shrink as s, s^2, s^4,
    ... It stops when the next step would be less than rounding.
    """
    w = high - low
    bend = (f0 - f1 + w * df1) / (w * w)
    discriminant = df1 * df1 - 4 * bend * f1
    x = low + w * f0 / (f0 - f1)
    if discriminant > 0 and df1 < 0:
        x = high + 2 * f1 / (-df1 + sqrt(discriminant))
    if not low < x <= high:
        x = 0.5 * (low + high)
    slope, before = df1, 0.0
    for _ in range(100):
        value, slope = value_and_slope(f, sign, start, first, degree, x)
        if value > 0:
            low = x
        else:
            high = x
        after = x - value / slope if slope < 0 else low
        is_newton = low < after < high
        if not is_newton:
            after = 0.5 * (low + high)
        move = abs(after - x)
        x = after
        next_step_is_lost = is_newton and move * move * move <= 2.0**-53 * x * before * before
        if move <= 2.0**-52 * x or next_step_is_lost:
            break
        before = move if is_newton else 0.0
    return x, slope


@kernel_helper
def first_root(f, sign, start, degree, limit):
    """Return the first root in (0, limit), limit <= 1, of a polynomial that is positive, or zero and rising, at 0.

    The polynomial has the coefficients f, from the power 0 to the power `degree`, times `sign`. Only its value at 0 is
    replaced by `start`. If `start` is exactly 0, the zero at 0 is not a root. The result is infinite if there is no
    root, 0 if the polynomial is negative from the start, and -1 if the search was given up. The result is also infinity
    if `limit` is below 0: then an earlier search was given up.
    """
    if limit < 0:
        return inf
    first = 0
    while start == 0 and first < degree:
        first += 1
        start = sign * f[first]
    if start == 0:
        return inf
    if start < 0:
        return 0.0
    df0 = sign * f[first + 1] if first < degree else 0.0
    f1, df1, C = 0.0, 0.0, 0.0
    for n in range(first + 1, degree + 1):
        a, m = f[n], float(n - first)
        f1 += a
        df1 += m * a
        C += (m * (m - 1)) * ((m - 2) * (m - 3)) * abs(a)
    f1, df1 = start + sign * f1, sign * df1
    if limit < 1:
        f1, df1 = value_and_slope(f, sign, start, first, degree, limit)
    low, high, f0 = 0.0, limit, start
    for _ in range(MOST_INTERVALS):
        w = high - low
        certain = is_positive(f0, df0, f1, df1, w, C)
        if not certain and f1 > 0:
            rising, _ = signed_sums(f, sign, start, first, degree, low)
            _, falling = signed_sums(f, sign, start, first, degree, high)
            certain = rising > falling
        if certain or (w < SHORTEST and not f1 <= 0):
            if high >= limit:
                return inf
            low, f0, df0 = high, f1, df1
            high = min(low + 2 * w, limit)
        elif f1 <= 0:
            x, slope = refine(f, sign, start, first, degree, low, high, f0, f1, df1)
            if w < SHORTEST or is_positive(f0, df0, 0.0, slope, x - low, C):
                return x
            high = low + 0.5 * w
        else:
            high = low + 0.5 * w
        f1, df1 = value_and_slope(f, sign, start, first, degree, high)
    return -1.0
