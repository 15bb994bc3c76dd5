"""Exact motion between events: the power series of w and F in time, to rounding, and the start rule.

Between events w' = -W F and F_i' = k_i w_i for active contacts. With z_i = F_i/sqrt(k_i) and u_i = sqrt(k_i) w_i,

    z' = u        u' = -A z        A = sqrt(K) W sqrt(K), symmetric and positive semidefinite.

The rates lie in the range of W, u in that of A, so the motion is a sum of sinusoids. In the norm of energy it is
y' = S y, y = (A^(1/2) z, u), with a skew S whose norm is omega, the root of the largest eigenvalue of A. Energy
2 E = abs(y)^2 is conserved. So the remainder of the series after the power `ORDER` is at most
(omega t)^29/29! sqrt(2 E) in this norm, and w_i, of an active contact or not, is off by at most sqrt(W_ii) times that
(Cauchy's inequality). Over a window, the time h = `ANGLE`/omega, it is 1e-18 of sqrt(2 E W_ii): below rounding. No sign
of an entry of W is used, and W may be singular.

A series has no modes to find, loses no digits where stiffnesses differ by many orders, and answers the start rule: the
first non-zero derivative of a rate is its first non-zero coefficient. `expand` decides it on the way, order by order. A
contact that becomes active at order n has F_i of order n + 1, so no coefficient that is already written changes.

`window_length` gives h, `expand` writes the coefficients, `place` moves the graph. `ORDER`, `ANGLE`, `value` are those
of `chain.series`, for the same bound holds there. Used by `graph.kernel`, `graph.rigid`.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from impact_xval.model.chain.series import ANGLE, INVERSE, ORDER, value
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.state import GraphPhase, is_compliant

#: Rounding of a sum over contacts, over the sum of the absolute values of its terms; a smaller sum counts as 0 where
#: only its sign matters.
ROUNDING = 2.0**-46

#: 1/(n + 1): the factors of an integral of a power series.
INVERSE_NEXT = 1 / np.arange(1.0, ORDER + 2)


@kernel_helper
def apply_start_rule(c):
    """Make contacts without force active that approach, and leave those at rest undecided."""
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
    """Return the time over which the series is summed; 1 where rigid contacts keep all others at rest.

    The largest eigenvalue of A is bounded by row sums of W K, which is similar to A (Gershgorin), and by the Frobenius
    norm of A; the smaller bound counts. A contact that is undecided may become active, and counts as such.
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

    Returned is the sum over contacts that the coefficient consists of. What may be rounding of it counts as 0, and the
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
    """Write a coefficient of the forces of rigid contacts: those that keep their rates at 0 (`graph.rigid`)."""
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
    """Move a graph to x of its window of length h, and add the impulses of that time."""
    for i in range(c.size):
        contact = c[i]
        contact.w = value(contact.rates, ORDER, x)
        if contact.phase != GraphPhase.INACTIVE:
            contact.F = value(contact.forces, ORDER, x)
            impulse = 0.0
            for order in range(ORDER, -1, -1):
                impulse = impulse * x + contact.forces[order] * INVERSE_NEXT[order]
            contact.impulse += h * x * impulse
