"""Exact motion of a chain of linear contacts between events, as power series in time.

`window_length` returns the length of a window, the time over which one series is used. `expand` and `expand_product`
write the coefficients of the series. `place` moves the chain to a later time. `value` and `slope` evaluate polynomials.

Contact i has the deformation delta_i, the rate of compression w_i, the force F_i, the stiffness k_i and the damping
b_i. a_i is the inverse mass of the body above it. The equations of motion are

    delta_i' = w_i        w_i' = a_i F_{i-1} - (a_i + a_{i+1}) F_i + a_{i+1} F_{i+1}        F_i = k_i delta_i + b_i w_i

In variables y whose squared norm is twice the energy they read y' = (S - B) y. The matrix S is skew, and its norm omega
is the highest frequency. The matrix B is symmetric without negative eigenvalues, and its norm gamma is the highest rate
of decay. A window has the length h = `ANGLE`/(omega + gamma). Over a window the remainder of the series is below
rounding.

The series costs O(N) operations per window; natural modes would cost O(N^3). The series loses no digits if stiffnesses
differ by many orders, or if modes are nearly parallel close to critical damping. A contact at rest may get its load by
a high derivative only (docs/chains.md, section 1). Its coefficients of lower order are then exactly zero.

Under Hunt-Crossley's law the force k delta (1 + b delta') is a product of two series. No bound of its remainder is
known beforehand, so `trusted_share` estimates the remainder afterwards.

Used by `chain.kernel`; `value` and `slope` also by `chain.grazing` and `chain.logs`, `place` by `chain.drop`.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from impact_xval.model.chain.laws import Law, damping, equilibrium_depth, is_active
from impact_xval.model.compiled import kernel_helper

#: `ORDER` is the highest power of the series. `ANGLE` is the length of a window, times (omega + gamma). The remainder
#: is 2.8^29/29! = 1e-18.
ORDER = 28
ANGLE = 2.8

#: Factors 1/n, by n; 0 for n = 0.
INVERSE = np.append(0.0, 1 / np.arange(1.0, ORDER + 1))


@kernel_helper
def largest_eigenvalue(c, n, stiffnesses):
    """Return an upper bound of the largest squared frequency of the active contacts, for given stiffnesses.

    The bound is the largest sum of the magnitudes in a row of the matrix (Gershgorin). With dampings instead of
    stiffnesses it is a bound of the largest rate of decay.
    """
    largest_row = 0.0
    for i in range(n):
        if not is_active(c[i]):
            continue
        row = (c[i].a + c[i + 1].a) * stiffnesses[i]
        if is_active(c[i - 1]):
            row += c[i].a * stiffnesses[i - 1]
        if is_active(c[i + 1]):
            row += c[i + 1].a * stiffnesses[i + 1]
        largest_row = max(largest_row, row)
    return largest_row


@kernel_helper
def window_length(c, n, work):
    """Return the length of a window, over which the power series is valid; infinite if no contact is active.

    For Hunt-Crossley's law the length is only a first guess.
    """
    for i in range(n):
        contact, scratch = c[i], work[i]
        scratch.k, scratch.b = contact.k, contact.b
        if contact.law == Law.HUNT_CROSSLEY:
            scratch.k = contact.k * (1 + contact.b * abs(contact.w))
            scratch.b = contact.b * contact.k * abs(contact.delta + equilibrium_depth(contact))
    rate = sqrt(largest_eigenvalue(c, n, work.k)) + largest_eigenvalue(c, n, work.b)
    return ANGLE / rate if rate > 0 else inf


@kernel_helper
def expand(c, n, h, work):
    """Write the power series of all rates w_i and deformations delta_i in x = t/h, with the powers 0 to `ORDER`."""
    for i in range(n):
        contact, scratch = c[i], work[i]
        active = is_active(contact)
        scratch.rates[0], scratch.deltas[0] = contact.w, contact.delta
        scratch.k = contact.k if active else 0.0
        scratch.b = damping(contact) if active else 0.0
        scratch.moves = 1.0 if active or not contact.frozen else 0.0
    is_product, last = c[0].law == Law.HUNT_CROSSLEY, n - 1
    for order in range(ORDER):
        share = h * INVERSE[order + 1]
        above, middle, below = 0.0, 0.0, 0.0
        for i in range(-1, n):
            above, middle, below = middle, below, 0.0
            if i < last:
                below = force_coefficient(c[i + 1], work[i + 1], order, is_product)
            if i >= 0:
                scratch = work[i]
                scratch.rates[order + 1] = share * (c[i].a * (above - middle) + c[i + 1].a * (below - middle))
                scratch.deltas[order + 1] = share * scratch.moves * scratch.rates[order]
        if order == 0:
            # Gravity accelerates the lowest ball. If the contact of this ball with the table is active, deformations
            # are counted from equilibrium, which contains its weight; then gravity appears only in the contact above.
            falls = last - 1 if work[last].k > 0 else last
            if falls >= 0:
                work[falls].rates[1] += h * c[last].g


@kernel_helper
def force_coefficient(contact, scratch, order, is_product):
    """Return the coefficient `order` of the power series of a contact's force, without the weight that it carries."""
    if not is_product:
        return scratch.k * scratch.deltas[order] + scratch.b * scratch.rates[order]
    if scratch.k == 0:
        return 0.0
    total = equilibrium_depth(contact) * scratch.rates[order]
    for j in range(order + 1):
        total += scratch.deltas[j] * scratch.rates[order - j]
    return scratch.k * (scratch.deltas[order] + scratch.b * total)


@kernel_helper
def trusted_share(n, work):
    """Return the share of a window, at most 1, over which the power series for Hunt-Crossley's law can be trusted.

    Over this share the last two terms of the series are below rounding. The terms decrease geometrically, so the
    remainder is about as large as the last two terms. This is the usual choice of a step in Taylor integrators (Jorba
    and Zou, Experimental Mathematics 14:99, 2005).
    """
    longest = 1.0
    for of_deltas in range(2):
        size = 0.0
        for i in range(n):
            table = work[i].deltas if of_deltas else work[i].rates
            for j in range(7):  # if the window is far too long, later terms grow without bound
                size = max(size, abs(table[j]))
        for i in range(n):
            table = work[i].deltas if of_deltas else work[i].rates
            for j in range(ORDER - 1, ORDER + 1):
                term = abs(table[j])
                if term > 0:
                    longest = min(longest, (2.0**-54 * size / term) ** (1 / j))
    return longest


@kernel_helper
def expand_product(c, n, h, work):
    """Write the power series for Hunt-Crossley's law, and return the time, at most h, over which they are valid."""
    expand(c, n, h, work)
    share = trusted_share(n, work)
    while not share > 0:  # some terms of the series exceed double precision
        h *= 1e-3
        expand(c, n, h, work)
        share = trusted_share(n, work)
    power = 1.0
    for j in range(1, ORDER + 1):
        power *= share
        for i in range(n):
            work[i].rates[j] *= power
            work[i].deltas[j] *= power
    return h * share


@kernel_helper
def value(coefficients, degree, x):
    """Return the value of a polynomial at x."""
    total = coefficients[degree]
    for j in range(degree - 1, -1, -1):
        total = total * x + coefficients[j]
    return total


@kernel_helper
def slope(coefficients, degree, x):
    """Return the derivative of a polynomial at x."""
    total = 0.0
    for j in range(degree, 0, -1):
        total = total * x + j * coefficients[j]
    return total


@kernel_helper
def place(c, n, x, work):
    """Move a chain to the place x of its window, from 0 at its start to 1 at its end."""
    for i in range(n):
        c[i].w, c[i].delta = value(work[i].rates, ORDER, x), value(work[i].deltas, ORDER, x)
