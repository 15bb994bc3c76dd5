"""Exact motion between events: the power series of w, delta and F in time, to rounding, and the start rule.

Between events w' = -W F; active contacts have the force F = k delta + b w. Let v be the velocities of bodies with the
masses M, w = -J v, and z = sqrt(k) delta. Then the pair y = (sqrt(M) v, z) obeys

    y' = (S - B) y

S is skew, and its norm omega is the root of the largest eigenvalue of sqrt(K) W sqrt(K). B >= 0 is symmetric, and its
norm gamma is the norm of sqrt(b) W sqrt(b). So abs(y)^2, twice the energy, does not grow.

In this norm the remainder of the series after the power `ORDER` is at most ((omega + gamma) h)^29/29! abs(y). The
remainder of w_i is at most sqrt(W_ii) times as large. A window has the length h = `ANGLE`/(omega + gamma); over this
time the remainder is 1e-18 of abs(y), which is below rounding. The proof uses no sign of an entry of W, and W may be
singular. (`graph.motion` has the same proof without dashpots, `chain.series` the proof for chains.)

`window_length` gives h, `expand` writes the coefficients, `place` moves the graph. Used by `in_time.kernel`.
"""

from __future__ import annotations

from math import inf, sqrt

from impact_xval.model.chain.laws import damping, is_active
from impact_xval.model.chain.series import ANGLE, INVERSE, ORDER, value
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.in_time.law import begin_touching
from impact_xval.model.graph.in_time.rigid import write_rigid_forces
from impact_xval.model.graph.motion import INVERSE_NEXT, decide


@kernel_helper
def largest_eigenvalue(c, W, of_dampings):
    """Bound the largest eigenvalue of sqrt(K) W sqrt(K), or of sqrt(b) W sqrt(b).

    Contacts count that are active or may become active. The result is the smaller one of two bounds: the largest sum of
    a row of W K (Gershgorin), and the Frobenius norm.
    """
    largest_row, squares = 0.0, 0.0
    for i in range(c.size):
        if not (is_active(c[i]) or c[i].undecided):
            continue
        row, weight = 0.0, c[i].b if of_dampings else c[i].k
        for j in range(c.size):
            if is_active(c[j]) or c[j].undecided:
                entry = abs(W[i, j]) * (c[j].b if of_dampings else c[j].k)
                row += entry
                squares += entry * abs(W[i, j]) * weight
        largest_row = max(largest_row, row)
    return min(largest_row, sqrt(squares))


@kernel_helper
def window_length(c, W):
    """Return the time over which the series is summed; infinite if no active contact moves."""
    rate = sqrt(largest_eigenvalue(c, W, False)) + largest_eigenvalue(c, W, True)
    return ANGLE / rate if rate > 0 else inf


@kernel_helper
def start_window(c):
    """Apply the start rule to touching contacts; contacts at rest stay undecided (`in_time.law`)."""
    for i in range(c.size):
        begin_touching(c[i])


@kernel_helper
def force_coefficient(contact, order):
    """Return a coefficient of the force of a contact; 0 if it is not active."""
    if not is_active(contact):
        return 0.0
    return contact.k * contact.deltas[order] + damping(contact) * contact.rates[order]


@kernel_helper
def expand(c, matrices, h):
    """Write the coefficients of w_i, delta_i and F_i in x = t/h, from power 0 to `ORDER`; decide undecided contacts.

    A contact that becomes active at order n has no force of a lower order. So no coefficient that is already written
    changes.
    """
    W = matrices.W
    for i in range(c.size):
        contact = c[i]
        contact.rates[0], contact.deltas[0] = contact.w, contact.delta
        contact.forces[0] = force_coefficient(contact, 0)
    for order in range(ORDER):
        share = h * INVERSE[order + 1]
        for i in range(c.size):
            c[i].total = 0.0
        for j in range(c.size):
            force = c[j].forces[order]
            if force != 0 and not c[j].is_rigid:
                for i in range(c.size):
                    c[i].total -= W[j, i] * force
        for i in range(c.size):
            contact = c[i]
            change = decide(c, W, i, order) if contact.undecided else contact.total
            contact.rates[order + 1] = share * change
            moves = is_active(contact) or not (contact.frozen or contact.is_rigid)
            contact.deltas[order + 1] = share * contact.rates[order] if moves else 0.0
            contact.forces[order + 1] = force_coefficient(contact, order + 1)
        write_rigid_forces(c, matrices.pivots, order)
    write_rigid_forces(c, matrices.pivots, ORDER)


@kernel_helper
def place(c, x, h):
    """Move a graph to the place x of its window of length h, and add the impulses of that time."""
    for i in range(c.size):
        contact = c[i]
        contact.w, contact.delta = value(contact.rates, ORDER, x), value(contact.deltas, ORDER, x)
        if is_active(contact) or contact.is_rigid:
            impulse = 0.0
            for order in range(ORDER, -1, -1):
                impulse = impulse * x + contact.forces[order] * INVERSE_NEXT[order]
            contact.impulse += h * x * impulse
