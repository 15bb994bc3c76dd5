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
from impact_xval.model.compiled import uncounted

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
        if not carries(c[i]):
            continue
        row = (c[i].a + c[i + 1].a) * k[i]
        if carries(c[i - 1]):
            row += c[i].a * k[i - 1]
        if carries(c[i + 1]):
            row += c[i + 1].a * k[i + 1]
        most = max(most, row)
    return most


@uncounted
def span(c, n, work):
    """Time over which the series is summed; infinite if no contact acts. Of a product of series, a first guess."""
    for i in range(n):
        one, own = c[i], work[i]
        own.k, own.b = one.k, one.b
        if one.law == HUNT_CROSSLEY:
            own.k = one.k * (1 + one.b * abs(one.w))
            own.b = one.b * one.k * abs(one.delta + rest(one))
    rate = sqrt(largest(c, n, work.k)) + largest(c, n, work.b)
    return ANGLE / rate if rate > 0 else inf


@uncounted
def expand(c, n, h, work):
    """Write the coefficients of w_i and delta_i in x = t/h, 0 to `ORDER`."""
    for i in range(n):
        one, own = c[i], work[i]
        acts = carries(one)
        own.rates[0], own.deltas[0] = one.w, one.delta
        own.k, own.b = (one.k, damping(one)) if acts else (0.0, 0.0)
        own.moves = 1.0 if acts or not one.frozen else 0.0
    product, last = c[0].law == HUNT_CROSSLEY, n - 1
    for order in range(ORDER):
        share = h * INVERSE[order + 1]
        above, middle, below = 0.0, 0.0, 0.0
        for i in range(-1, n):
            above, middle, below = middle, below, 0.0
            if i < last:
                below = _term(c[i + 1], work[i + 1], order, product)
            if i >= 0:
                own = work[i]
                own.rates[order + 1] = share * (c[i].a * (above - middle) + c[i + 1].a * (below - middle))
                own.deltas[order + 1] = share * own.moves * own.rates[order]
        if order == 0:
            # Whoever is not held by the table falls: the last body, or those above it.
            falls = last - 1 if work[last].k > 0 else last
            if falls >= 0:
                work[falls].rates[1] += h * c[last].g


@uncounted
def _term(one, own, order, product):
    """Coefficient of the force of a contact beyond the weight that it holds; a product's is a Cauchy product."""
    if not product:
        return own.k * own.deltas[order] + own.b * own.rates[order]
    if own.k == 0:
        return 0.0
    total = rest(one) * own.rates[order]
    for j in range(order + 1):
        total += own.deltas[j] * own.rates[order - j]
    return own.k * (own.deltas[order] + own.b * total)


@uncounted
def trusted(n, work):
    """Part of the time of a product's series in which its last two terms stay below rounding, at most 1.

    The usual step of a Taylor integrator (Jorba and Zou, Experimental Mathematics 14:99, 2005): the terms fall
    geometrically, so that what follows the last two is of their size.
    """
    longest = 1.0
    for deltas in range(2):
        size = 0.0
        for i in range(n):
            table = work[i].deltas if deltas else work[i].rates
            for j in range(7):  # later ones may grow without bound over a time that is too long
                size = max(size, abs(table[j]))
        for i in range(n):
            table = work[i].deltas if deltas else work[i].rates
            for j in range(ORDER - 1, ORDER + 1):
                term = abs(table[j])
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
            work[i].rates[j] *= power
            work[i].deltas[j] *= power
    return h * part


@uncounted
def value(coefficients, degree, x):
    """Return a polynomial at x."""
    total = coefficients[degree]
    for j in range(degree - 1, -1, -1):
        total = total * x + coefficients[j]
    return total


@uncounted
def place(c, n, x, work):
    """Put a chain where it is at x of a piece."""
    for i in range(n):
        c[i].w, c[i].delta = value(work[i].rates, ORDER, x), value(work[i].deltas, ORDER, x)


@uncounted
def slope(coefficients, degree, x):
    """Return the derivative of a polynomial at x."""
    total = 0.0
    for j in range(degree, 0, -1):
        total = total * x + j * coefficients[j]
    return total
