"""Exact motion of linear contacts while the set of acting ones stays: its power series in time, to rounding.

delta_i' = w_i and w_i' = a_i F_{i-1} - (a_i + a_{i+1}) F_i + a_{i+1} F_{i+1}, with F_i = k_i delta_i + b_i w_i, have
as many modes as contacts act. Their power series is summed here. In the norm of energy the equations are
y' = (S - B) y, S skew with the norm omega, the highest frequency, and B >= 0 with the norm gamma, the highest rate of
decay: over a time h of `ANGLE`/(omega + gamma) what the series leaves out is below a rounding. It costs O(N) a piece,
where finding the modes costs O(N^3); it loses no digits where stiffnesses differ by many orders or next to critical
damping, where modes are nearly parallel; and a contact at rest that is loaded by its neighbours at a high order
(docs/columns.md, section 1) has exactly zero coefficients below that order.

Hunt-Crossley's force k delta (1 + b delta') is a product of series, a Cauchy product; no bound of what it leaves out is
known beforehand (`trusted`).
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from impact_xval.model.chain.laws import HUNT_CROSSLEY, carries, damping, rest
from impact_xval.model.compiled import merged, uncounted

#: Highest power of the series, and omega + gamma times the time it is used for: 2.8^29/29! is 1e-18.
ORDER = 28
ANGLE = 2.8

#: 1/n.
INVERSE = np.append(0.0, 1 / np.arange(1.0, ORDER + 1))


@uncounted
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
def span(c, n, work):
    """Time over which the series is summed; infinite if no contact acts. Of a product of series, a first guess."""
    if c.law != HUNT_CROSSLEY:
        rate = sqrt(largest(c, n, c.k)) + largest(c, n, c.b)
    else:
        k, b = work.k, work.b
        for i in range(n):
            k[i] = c.k[i] * (1 + c.b[i] * abs(c.w[i]))
            b[i] = c.b[i] * c.k[i] * abs(c.delta[i] + rest(c, n, i))
        rate = sqrt(largest(c, n, k)) + largest(c, n, b)
    return ANGLE / rate if rate > 0 else inf


@uncounted
def expand(c, n, h, work):
    """Write the coefficients of w_i and delta_i in x = t/h, 0 to `ORDER`, to row i."""
    rates, deltas, k, b, moves = work.rates, work.deltas, work.k, work.b, work.moves
    product = c.law == HUNT_CROSSLEY
    for i in range(n):
        acts = carries(c.phase[i])
        rates[i, 0], deltas[i, 0] = c.w[i], c.delta[i]
        k[i], b[i] = (c.k[i], damping(c, i)) if acts else (0.0, 0.0)
        moves[i] = 1.0 if acts or not c.frozen else 0.0
    for order in range(ORDER):
        share = h * INVERSE[order + 1]
        above, own, below = 0.0, 0.0, 0.0
        for i in range(-1, n):
            above, own, below = own, below, 0.0
            if i + 1 < n:
                below = _term(c, n, i + 1, order, product, work)
            if i >= 0:
                rates[i, order + 1] = share * (c.a[i] * (above - own) + c.a[i + 1] * (below - own))
                deltas[i, order + 1] = share * moves[i] * rates[i, order]
        if order == 0 and c.g[0] > 0:
            # Whoever is not held by the table falls: the last body, or those above it.
            falls = n - 2 if k[n - 1] > 0 else n - 1
            if falls >= 0:
                rates[falls, 1] += h * c.g[0]


@merged
def _term(c, n, i, order, product, work):
    """Coefficient of the force of contact i beyond the weight that it holds; a product's is a Cauchy product."""
    rates, deltas, k, b = work.rates, work.deltas, work.k, work.b
    if not product:
        return k[i] * deltas[i, order] + b[i] * rates[i, order]
    if k[i] == 0:
        return 0.0
    total = rest(c, n, i) * rates[i, order]
    for j in range(order + 1):
        total += deltas[i, j] * rates[i, order - j]
    return k[i] * (deltas[i, order] + b[i] * total)


@uncounted
def trusted(n, work):
    """Part of the time of a product's series in which its last two terms stay below rounding, at most 1.

    The usual step of a Taylor integrator (Jorba and Zou, Experimental Mathematics 14:99, 2005): the terms fall
    geometrically, so that what follows the last two is of their size.
    """
    longest = 1.0
    for table in (work.rates, work.deltas):
        size = 0.0
        for i in range(n):
            for j in range(7):  # later ones may grow without bound over a time that is too long
                size = max(size, abs(table[i, j]))
        for i in range(n):
            for j in (ORDER - 1, ORDER):
                term = abs(table[i, j])
                if term > 0:
                    longest = min(longest, (2.0**-54 * size / term) ** (1 / j))
    return longest


@uncounted
def expand_product(c, n, h, work):
    """As `expand`, over as much of a time h as its series holds for, which is returned."""
    expand(c, n, h, work)
    part = trusted(n, work)
    while not part > 0:  # terms beyond double precision
        h *= 1e-3
        expand(c, n, h, work)
        part = trusted(n, work)
    power = 1.0
    for j in range(1, ORDER + 1):
        power *= part
        for i in range(n):
            work.rates[i, j] *= power
            work.deltas[i, j] *= power
    return h * part


@uncounted
def value(coefficients, degree, i, x):
    """Return a polynomial at x."""
    total = coefficients[i, degree]
    for j in range(degree - 1, -1, -1):
        total = total * x + coefficients[i, j]
    return total


@uncounted
def place(c, n, x, work):
    """Put a chain where it is at x of a piece."""
    for i in range(n):
        c.w[i], c.delta[i] = value(work.rates, ORDER, i, x), value(work.deltas, ORDER, i, x)


@uncounted
def slope(coefficients, degree, i, x):
    """Return the derivative of a polynomial at x."""
    total = 0.0
    for j in range(degree, 0, -1):
        total = total * x + j * coefficients[i, j]
    return total
