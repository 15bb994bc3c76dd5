"""Exact motion of linear contacts while the set of acting ones stays: its power series in time, to rounding.

delta_i' = w_i and w_i' = a_i F_{i-1} - (a_i + a_{i+1}) F_i + a_{i+1} F_{i+1} with F_i = k_i delta_i are solved by as
many sinusoids as contacts act. Their power series is summed here, over a time h of `ANGLE` over the largest frequency:
what the series leaves out is then below a rounding. It costs O(N) a piece, where finding the modes costs O(N^3); it
loses no digits where stiffnesses differ by many orders; and a contact at rest that is loaded by its neighbours at a
high order (docs/columns.md, section 1) has exactly zero coefficients below that order.
"""

from __future__ import annotations

from math import inf, sqrt

from impact_xval.model.columns.chain import Chain
from impact_xval.model.compiled import Floats, compiled, inlined
from impact_xval.model.law import INACTIVE

#: Highest power of the series, and the largest frequency times the time it is used for: 2.8^29/29! is 1e-18.
ORDER = 28
ANGLE = 2.8


@inlined
def largest(c: Chain, n: int, k: Floats) -> float:
    """Bound the largest eigenvalue of the contacts that act, with these stiffnesses, by row sums (Gershgorin)."""
    most = 0.0
    for i in range(n):
        if c.phase[i] == INACTIVE:
            continue
        row = (c.a[i] + c.a[i + 1]) * k[i]
        if i > 0 and c.phase[i - 1] != INACTIVE:
            row += c.a[i] * k[i - 1]
        if i + 1 < n and c.phase[i + 1] != INACTIVE:
            row += c.a[i + 1] * k[i + 1]
        most = max(most, row)
    return most


@compiled
def horizon(c: Chain, n: int) -> float:
    """Time over which the series is summed."""
    most = largest(c, n, c.k)
    return ANGLE / sqrt(most) if most > 0 else inf


@compiled
def expand(c: Chain, n: int, h: float, rates: Floats, deltas: Floats) -> None:
    """Write the coefficients of w_i and delta_i in x = t/h to the rows 0 to `ORDER` of `rates` and `deltas`."""
    for i in range(n):
        rates[0, i], deltas[0, i] = c.w[i], c.delta[i]
    for order in range(ORDER):
        share = h / (order + 1)
        # Forces of the contact above, of this one and of the one below.
        above, own = 0.0, 0.0
        below = c.k[0] * deltas[order, 0]
        for i in range(n):
            above, own = own, below
            below = c.k[i + 1] * deltas[order, i + 1] if i + 1 < n else 0.0
            rates[order + 1, i] = share * (c.a[i] * (above - own) + c.a[i + 1] * (below - own))
            deltas[order + 1, i] = share * rates[order, i] if c.phase[i] != INACTIVE else 0.0


@compiled
def evaluate(coefficients: Floats, order: int, n: int, x: float, out: Floats) -> None:
    """Values of n polynomials, one a column, at x."""
    for i in range(n):
        out[i] = coefficients[order, i]
    for j in range(order - 1, -1, -1):
        for i in range(n):
            out[i] = out[i] * x + coefficients[j, i]
