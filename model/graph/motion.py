"""Exact motion of a graph between events: power series in time of rates w and forces F, and the start rule.

Between events w' = -W F, with the Delassus matrix W, and F_i' = k_i w_i for active contacts. Let K be the diagonal
matrix of stiffnesses. With z_i = F_i/sqrt(k_i) and u_i = sqrt(k_i) w_i,

    z' = u        u' = -A z        A = sqrt(K) W sqrt(K), symmetric and positive semidefinite.

The rates lie in the range of W, and u lies in the range of A, so the motion is a sum of sinusoids. Let
y = (A^(1/2) z, u), whose squared norm abs(y)^2 = 2 E is twice the energy. The motion then reads y' = S y. The matrix S
is skew, so the energy is conserved. The norm of S is omega, the root of the largest eigenvalue of A.

**Remainder.** The series of y is cut after the power `ORDER`. The norm of its remainder is at most
(omega t)^29/29! sqrt(2 E). By Cauchy's inequality the error of w_i is at most sqrt(W_ii) times as large, for active and
inactive contacts. A window is the time h = `ANGLE`/omega over which the series is used. Over a window the error is
1e-18 of sqrt(2 E W_ii), which is below rounding. The proof does not depend on the signs of the entries of W, and W may
be singular.

**Why a series.** Natural modes need not be found, and no digits are lost where stiffnesses differ by many orders.

**Start rule.** A contact at rest becomes active if the first non-zero derivative of its rate is positive (`graph.law`).
This derivative belongs to the first non-zero coefficient of the series, so `expand` tests this order by order. If a
contact becomes active at order n, its force begins with order n + 1. So all coefficients that are already written stay
valid.

`window_length` returns h, `expand` writes the coefficients, and `place` moves the graph to a later time. `ORDER`,
`ANGLE` and `value` come from `chain.series`.

Used by `graph.kernel` and `graph.rigid`.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from impact_xval.model.chain.series import ANGLE, INVERSE, ORDER, value
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.state import GraphPhase, is_compliant

#: Largest rounding error of a sum over contacts, as a share of the sum of the absolute values of its terms. Where only
#: the sign of a sum matters, a sum below this share is taken as 0.
ROUNDING = 2.0**-46

#: Factors 1/(n + 1), with which the coefficients n of a power series give its integral.
INVERSE_NEXT = 1 / np.arange(1.0, ORDER + 2)


@kernel_helper
def apply_start_rule(c):
    """Apply the start rule to each contact without force, as far as only its rate of compression is needed.

    If the rate is positive, the contact becomes active. If the rate is 0, the contact gets the flag `undecided`, and
    `decide` later tests derivatives of the rate.
    """
    for i in range(c.size):
        contact = c[i]
        is_idle = contact.F == 0 and not contact.is_rigid and contact.phase != GraphPhase.RESTITUTION
        if is_idle and contact.w > 0:
            contact.phase = GraphPhase.COMPRESSION
        elif is_idle and contact.w == 0:
            contact.phase = GraphPhase.INACTIVE
        contact.undecided = is_idle and contact.w == 0


@kernel_helper
def window_length(c, W):
    """Return the length h of a window, over which the power series is valid.

    h is `ANGLE` over the root of an upper bound of the largest eigenvalue of A = sqrt(K) W sqrt(K). The bound is the
    smaller one of two: the largest sum of a row of W K, which is similar to A (Gershgorin), and the Frobenius norm of
    A. Contacts with the flag `undecided` are included, because they may become active. If the bound is 0, because rigid
    contacts keep all other contacts at rest, the length is 1.
    """
    largest_row, squares = 0.0, 0.0
    for i in range(c.size):
        if not (is_compliant(c[i].phase) or c[i].undecided):
            continue
        row = 0.0
        for j in range(c.size):
            if is_compliant(c[j].phase) or c[j].undecided:
                entry = abs(W[i, j]) * c[j].k
                row += entry
                squares += entry * abs(W[i, j]) * c[i].k
        largest_row = max(largest_row, row)
    largest = min(largest_row, sqrt(squares))
    return ANGLE / sqrt(largest) if largest > 0 else 1.0


@kernel_helper
def decide(c, W, i, order):
    """Apply the start rule to contact i at one order: test the derivative of its rate that belongs to `order`.

    The contact must have the flag `undecided`. The derivative is a sum over contacts, `total` of the contact. If it is
    positive the contact becomes active, and if it is negative the contact stays inactive. If it may be rounding only,
    the flag stays for the next order. The function returns the sum, or 0 if it may be rounding only.
    """
    contact, size = c[i], 0.0
    for j in range(c.size):
        size += abs(W[i, j] * c[j].forces[order])
    if abs(contact.total) <= ROUNDING * size:
        return 0.0
    contact.undecided = False
    if contact.total > 0:
        contact.phase = GraphPhase.COMPRESSION
    return contact.total


@kernel_helper
def write_rigid_forces(c, pivots, order):
    """Write the coefficient `order` of the forces of rigid contacts. These forces keep the contacts' rates at 0."""
    for r in range(c.size - 1, -1, -1):
        if c[r].has_pivot:
            force = 0.0
            for j in range(c.size):
                force -= pivots[r, j] * c[j].forces[order]
            c[r].forces[order] = force


@kernel_helper
def expand(c, matrices, h):
    """Write the power series of all rates w_i and forces F_i in x = t/h, and make contacts active by the start rule.

    The series have the powers 0 to `ORDER`. h is the length of the window. The start rule is applied to contacts with
    the flag `undecided`, which are at rest without force.
    """
    W, any_pivot = matrices.W, False
    for i in range(c.size):
        contact = c[i]
        contact.rates[0] = contact.w
        contact.forces[0] = contact.F if is_compliant(contact.phase) else 0.0
        any_pivot |= contact.has_pivot
    for order in range(ORDER):
        share = h * INVERSE[order + 1]
        for i in range(c.size):
            c[i].total = 0.0
        for j in range(c.size):
            force = c[j].forces[order]
            if force != 0 and not c[j].has_pivot:
                for i in range(c.size):
                    c[i].total -= W[j, i] * force
        for i in range(c.size):
            contact = c[i]
            change = decide(c, W, i, order) if contact.undecided else contact.total
            contact.rates[order + 1] = share * change
            contact.forces[order + 1] = 0.0
            if is_compliant(contact.phase):
                contact.forces[order + 1] = share * contact.k * contact.rates[order]
        if any_pivot:
            write_rigid_forces(c, matrices.pivots, order)
    if any_pivot:
        write_rigid_forces(c, matrices.pivots, ORDER)


@kernel_helper
def place(c, x, h):
    """Move a graph by the time x h, where x is from 0 to 1, and add the impulses of its forces over this time."""
    for i in range(c.size):
        contact = c[i]
        contact.w = value(contact.rates, ORDER, x)
        if contact.phase != GraphPhase.INACTIVE:
            contact.F = value(contact.forces, ORDER, x)
            impulse = 0.0
            for order in range(ORDER, -1, -1):
                impulse = impulse * x + contact.forces[order] * INVERSE_NEXT[order]
            contact.impulse += h * x * impulse
