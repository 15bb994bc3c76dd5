"""The certified first root of a polynomial in an interval (0, last].

From f(x) > 0 no root lies before x + s, where f + f' s - B s^2/2 = 0 and abs(f'') <= B on [0, last]. Steps by that s
approach the first root from the left, quadratically, and cannot skip a pair of close roots (docs/theory.md, section 3).
"""

from __future__ import annotations

from math import inf, sqrt

from impact_xval.model.compiled import compiled

EPSILON = 2.0**-52

#: Rounding of a polynomial's value, relative to the sum of its coefficients' magnitudes.
NOISE = 2 * EPSILON

#: Steps after which the point reached is taken for the root: a tangency, resolved to rounding.
STEPS = 500


@compiled
def first_root(c, degree, sign, last):
    """First root in (0, last] of a polynomial that is not negative at 0; infinity if there is none.

    Parameters
    ----------
    c : ndarray, shape (degree + 1,) or more
        Coefficients, lowest first. Those that vanish at the beginning are a root at 0 that does not count.
    degree : int
    sign : float
        By which the coefficients are multiplied: 1 or -1.
    last : float
        At most 1.

    Returns
    -------
    float
        0 if the polynomial is negative right of 0.
    """
    low = 0
    while low <= degree and c[low] == 0:
        low += 1
    if low > degree:
        return inf
    if sign * c[low] < 0:
        return 0.0
    size, bend = abs(c[low]), 0.0
    for j in range(low + 1, degree + 1):
        n = j - low
        size += abs(c[j])
        bend += n * (n - 1) * abs(c[j])
    x = 0.0
    for _ in range(STEPS):
        f, df = 0.0, 0.0
        for j in range(degree, low - 1, -1):
            df = df * x + f
            f = f * x + sign * c[j]
        if f <= NOISE * size and df < 0:
            return x
        root = sqrt(df * df + 2 * bend * max(f, 0.0))
        step = 2 * f / (root - df) if df < 0 else (df + root) / bend
        x += step
        if x > last:
            return inf
        if step <= EPSILON * x:
            return x
    return x
