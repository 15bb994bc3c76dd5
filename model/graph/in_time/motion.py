"""Exact motion between events, for contact laws over time: power series of rates w, depths delta and forces F.

Between events w' = -W F, with the Delassus matrix W. An active contact has the force F = k delta + b w, with the
stiffness k and the damping b. Let v be the velocities of bodies with the mass matrix M, let w = -J v, and let
z = sqrt(k) delta. Then the pair y = (sqrt(M) v, z) obeys

    y' = (S - B) y

The matrix S is skew. Its norm omega is the root of the largest eigenvalue of sqrt(K) W sqrt(K), where K is the diagonal
matrix of stiffnesses. The matrix B is symmetric without negative eigenvalues, and its norm gamma is the norm of
sqrt(b) W sqrt(b). So abs(y)^2, which is twice the energy, does not grow.

**Remainder.** The series of y is cut after the power `ORDER`. The norm of its remainder after a time h is at most
((omega + gamma) h)^29/29! abs(y). The remainder of w_i is at most sqrt(W_ii) times as large. A window has the length
h = `ANGLE`/(omega + gamma). Over a window the remainder is 1e-18 of abs(y), which is below rounding. The proof does not
depend on the signs of the entries of W, and W may be singular. `graph.motion` has the same proof without dashpots.

`window_length` returns h, `expand` writes the coefficients, and `place` moves the graph to a later time.

Used by `in_time.kernel`.
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
    """Return an upper bound of the largest eigenvalue of sqrt(K) W sqrt(K), with stiffnesses K or dampings.

    Dampings replace the stiffnesses if `of_dampings` is true. The matrix has only the contacts that are active or may
    become active. The result is the smaller one of two bounds: the largest sum of a row of W K (Gershgorin), and the
    Frobenius norm of the matrix.
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
    """Return the length of a window, over which the power series is valid; infinite if no active contact can move."""
    rate = sqrt(largest_eigenvalue(c, W, False)) + largest_eigenvalue(c, W, True)
    return ANGLE / rate if rate > 0 else inf


@kernel_helper
def start_window(c):
    """Apply the start rule to all contacts: a contact becomes active if its bodies touch and approach."""
    for i in range(c.size):
        begin_touching(c[i])


@kernel_helper
def force_coefficient(contact, order):
    """Return the coefficient `order` of the power series of a contact's force; 0 if the contact is not active."""
    if not is_active(contact):
        return 0.0
    return contact.k * contact.deltas[order] + damping(contact) * contact.rates[order]


@kernel_helper
def expand(c, matrices, h):
    """Write the power series of all rates, depths and forces in x = t/h, and make contacts active by the start rule.

    The series have the powers 0 to `ORDER`. h is the length of the window. The start rule is applied to contacts that
    are flagged as `undecided`: they touch at the rate 0. The coefficients are computed order by order. If a contact
    becomes active at order n, its force begins with the power n. So all coefficients that are already written stay
    valid.
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
    """Move a graph by the time x h, where x is from 0 to 1, and add the impulses of its forces over this time."""
    for i in range(c.size):
        contact = c[i]
        contact.w, contact.delta = value(contact.rates, ORDER, x), value(contact.deltas, ORDER, x)
        if is_active(contact) or contact.is_rigid:
            impulse = 0.0
            for order in range(ORDER, -1, -1):
                impulse = impulse * x + contact.forces[order] * INVERSE_NEXT[order]
            contact.impulse += h * x * impulse
