"""Exact motion of linear contacts while the set of acting ones stays: its power series in time, to rounding.

delta_i' = w_i and w_i' = a_i F_{i-1} - (a_i + a_{i+1}) F_i + a_{i+1} F_{i+1}, with F_i = k_i delta_i + b_i w_i, have
as many modes as contacts act. Their power series is summed here. In the norm of energy the equations are
y' = (S - B) y, S skew with the norm omega, the highest frequency, and B >= 0 with the norm gamma, the highest rate of
decay: over a time h of `ANGLE`/(omega + gamma) what the series leaves out is below a rounding. It costs O(N) a piece,
where finding the modes costs O(N^3); it loses no digits where stiffnesses differ by many orders or next to critical
damping, where modes are nearly parallel; and a contact at rest that is loaded by its neighbours at a high order
(docs/columns.md, section 1) has exactly zero coefficients below that order.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from impact_xval.model.chain.laws import carries
from impact_xval.model.compiled import inlined_uncounted, uncounted

#: Highest power of the series, and omega + gamma times the time it is used for: 2.8^29/29! is 1e-18.
ORDER = 28
ANGLE = 2.8

#: 1/n.
INVERSE = np.append(0.0, 1 / np.arange(1.0, ORDER + 1))


@inlined_uncounted
def largest(c, n, k):
    """Bound the largest eigenvalue of the contacts that act, with these stiffnesses, by row sums (Gershgorin)."""
    most = 0.0
    for i in range(n):
        if not carries(c.phase[i]):
            continue
        row = (c.a[i] + c.a[i + 1]) * k[i]
        if i > 0 and carries(c.phase[i - 1]):
            row += c.a[i] * k[i - 1]
        if i + 1 < n and carries(c.phase[i + 1]):
            row += c.a[i + 1] * k[i + 1]
        most = max(most, row)
    return most


@uncounted
def expand(c, n, work):
    """Write the coefficients of w_i and delta_i in x = t/h, 0 to `ORDER`, to row i; the time h."""
    h = ANGLE / (sqrt(largest(c, n, c.k)) + largest(c, n, c.b))
    rates, deltas, k, b, moves = work.rates, work.deltas, work.k, work.b, work.moves
    for i in range(n):
        acts = carries(c.phase[i])
        rates[i, 0], deltas[i, 0] = c.w[i], c.delta[i]
        k[i], b[i] = (c.k[i], c.b[i]) if acts else (0.0, 0.0)
        moves[i] = 1.0 if acts or not c.frozen else 0.0
    for order in range(ORDER):
        share = h * INVERSE[order + 1]
        above, own, below = 0.0, 0.0, k[0] * deltas[0, order] + b[0] * rates[0, order]
        for i in range(n):
            above, own, below = own, below, 0.0
            if i + 1 < n:
                below = k[i + 1] * deltas[i + 1, order] + b[i + 1] * rates[i + 1, order]
            rates[i, order + 1] = share * (c.a[i] * (above - own) + c.a[i + 1] * (below - own))
            deltas[i, order + 1] = share * moves[i] * rates[i, order]
    return h


@uncounted
def evaluate(coefficients, degree, n, x, out):
    """Values of n polynomials, one a row, at x."""
    for i in range(n):
        value = coefficients[i, degree]
        for j in range(degree - 1, -1, -1):
            value = value * x + coefficients[i, j]
        out[i] = value


@inlined_uncounted
def slope(coefficients, degree, i, x):
    """Return the derivative of a polynomial at x."""
    value = 0.0
    for j in range(degree, 0, -1):
        value = value * x + j * coefficients[i, j]
    return value
