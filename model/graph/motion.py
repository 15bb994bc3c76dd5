"""Exact motion between events: the power series of w and F in time, to rounding, and the start rule.

Between events w' = -W F and F_i' = k_i w_i for active contacts. With z_i = F_i/sqrt(k_i) and u_i = sqrt(k_i) w_i,

    z' = u        u' = -A z        A = sqrt(K) W sqrt(K), symmetric and positive semidefinite.

The rates lie in the range of W, and u lies in the range of A, so the motion is a sum of sinusoids. In the norm of
energy it reads y' = S y with y = (A^(1/2) z, u). S is skew, and its norm is omega, the root of the largest eigenvalue
of A. The energy 2 E = abs(y)^2 is conserved.

**Remainder.** In this norm the remainder of the series after the power `ORDER` is at most (omega t)^29/29! sqrt(2 E).
By Cauchy's inequality the error of w_i, for active and inactive contacts, is at most sqrt(W_ii) times as large. A
window has the length h = `ANGLE`/omega; over this time the error is 1e-18 of sqrt(2 E W_ii), which is below rounding.
The proof uses no sign of an entry of W, and W may be singular.

**Start rule.** Natural modes need not be found, and the series loses no digits where stiffnesses differ by many orders.
The series also answers the start rule: the first non-zero derivative of a rate is its first non-zero coefficient.
`expand` decides this order by order. A contact that becomes active at order n has a force F_i of order n + 1, so no
coefficient that is already written changes.

`window_length` gives h, `expand` writes the coefficients, `place` moves the graph. `ORDER`, `ANGLE` and `value` come
from `chain.series`, where the same bound holds. Used by `graph.kernel`, `graph.rigid`.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from impact_xval.model.chain.series import ANGLE, INVERSE, ORDER, value
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.state import GraphPhase, is_compliant

#: Rounding of a sum over contacts, as a share of the sum of the absolute values of its terms. A sum below this share
#: counts as 0 where only its sign matters.
ROUNDING = 2.0**-46

#: 1/(n + 1): the factors of an integral of a power series.
INVERSE_NEXT = 1 / np.arange(1.0, ORDER + 2)


@kernel_helper
def apply_start_rule(c):
    """Make contacts without force active whose bodies approach, and leave contacts at rest undecided."""
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
    """Return the time over which the series is summed; 1 if rigid contacts keep all other contacts at rest.

    Two bounds of the largest eigenvalue of A are computed, and the smaller one counts: sums of rows of W K, which is
    similar to A (Gershgorin), and the Frobenius norm of A. An undecided contact may become active, and counts as active
    here.
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
    """Decide whether the undecided contact i is pressed, by the next coefficient of its rate.

    The coefficient is a sum over contacts, and this sum is returned. A sum that may be rounding counts as 0; then the
    next order decides.
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
    """Write a coefficient of the forces of rigid contacts, which keep their rates at 0 (`graph.rigid`)."""
    for r in range(c.size - 1, -1, -1):
        if c[r].has_pivot:
            force = 0.0
            for j in range(c.size):
                force -= pivots[r, j] * c[j].forces[order]
            c[r].forces[order] = force


@kernel_helper
def expand(c, matrices, h):
    """Write the coefficients of w_i and F_i in x = t/h, from power 0 to `ORDER`, and decide undecided contacts."""
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
    """Move a graph to the place x of its window of length h, and add the impulses of that time."""
    for i in range(c.size):
        contact = c[i]
        contact.w = value(contact.rates, ORDER, x)
        if contact.phase != GraphPhase.INACTIVE:
            contact.F = value(contact.forces, ORDER, x)
            impulse = 0.0
            for order in range(ORDER, -1, -1):
                impulse = impulse * x + contact.forces[order] * INVERSE_NEXT[order]
            contact.impulse += h * x * impulse
