"""The certified first root of a polynomial in an interval (0, last].

Two bounds advance from the left and cannot skip a pair of close roots. Let P and N be the sums of the positive terms
and of the magnitudes of the negative ones, both increasing: f > 0 on [x, y] if P(x) > N(y), which crosses whole windows
at once. Where that fails, from f(x) > 0 no root lies before x + s, where f + f' s - B s^2/2 = 0 and abs(f'') <= B in
the window: steps by that s approach the root quadratically.
"""

from __future__ import annotations

from math import inf, sqrt

from impact_xval.model.compiled import Floats, Pair, compiled, inlined

EPSILON = 2.0**-52

#: Rounding of a polynomial's value, relative to the sum of its terms' magnitudes.
NOISE = 2 * EPSILON

#: End of a window per its beginning.
WINDOW = 1.25

#: Halvings of the first window.
HALVINGS = 40

#: Steps in a window after which the point reached is taken for the root: a tangency, resolved to rounding.
STEPS = 500


@inlined
def parts(c: Floats, low: int, degree: int, sign: float, x: float) -> Pair:
    """P(x) and N(x), of the polynomial without its first `low` coefficients."""
    positive, negative = 0.0, 0.0
    for j in range(degree, low - 1, -1):
        term = sign * c[j]
        positive = positive * x + max(term, 0.0)
        negative = negative * x + max(-term, 0.0)
    return positive, negative


@compiled
def root_in_window(c: Floats, low: int, degree: int, sign: float, x: float, end: float) -> float:
    """First root in [x, end] of a polynomial without its first `low` coefficients, positive at x; else infinity."""
    bend, size = 0.0, 0.0
    for j in range(degree, low - 1, -1):
        n = j - low
        size = size * end + abs(c[j])
        if n > 1:
            bend = bend * end + n * (n - 1) * abs(c[j])
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
        if x > end:
            return inf
        if step <= EPSILON * x:
            return x
    return x


@compiled
def first_root(c: Floats, degree: int, sign: float, last: float) -> float:
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
    x, end = 0.0, last
    for _ in range(HALVINGS):
        if sign * c[low] > parts(c, low, degree, sign, end)[1]:
            x = end
            break
        end *= 0.5
    positive = parts(c, low, degree, sign, x)[0]
    while x < last:
        end = min(last, max(WINDOW * x, end))
        beyond, negative = parts(c, low, degree, sign, end)
        if positive <= negative:
            root = root_in_window(c, low, degree, sign, x, end)
            if root < inf:
                return root
        x, positive = end, beyond
    return inf
