"""Contacts of a graph that become rigid by the law of bistiffness (supplement, 3.4).

Each end of compression makes a contact stiffer, and its stiffness may grow without bound in a finite time. The model's
rule `graph.rigid.ringing_ends` says when such a contact may be treated as rigid. For bistiffness the rule has one more
condition: no gap closes until then.

A rigid contact r keeps its rate of compression w_r = 0. It is eliminated from the Delassus matrix W, as in
`graph.rigid`: W <- W - W_r W_r^T/W_rr, and its force is F_r = -sum_j W_rj F_j/W_rr. From then on it
stays closed. In a chain the neighbours of a rigid contact only press it. In a graph the neighbours may pull it open,
and it would later close again with a blow. Such a graph is given up (`is_pulled_open`).

Used by `in_time.motion` and `in_time.kernel`.
"""

from __future__ import annotations

from math import pi, sqrt

from impact_xval.model.chain.laws import deactivate, is_active
from impact_xval.model.chain.rigid import RIGID
from impact_xval.model.chain.roots import first_root
from impact_xval.model.chain.series import ORDER
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph import rigid
from impact_xval.model.graph.motion import ROUNDING
from impact_xval.model.graph.state import oscillation
from impact_xval.model.pair.law import Phase


@kernel_helper
def ringing_ends(c, W, i):
    """Return whether contact i, which has just ended compression, may be treated as rigid from this time on.

    The conditions are those of the model (`graph.rigid.ringing_ends`), and one more: no gap closes within twice the
    time after which the contact is rigid.
    """
    if not rigid.ringing_ends(c, W, i):
        return False
    time = 4 * pi / sqrt(c[i].k * W[i, i]) / (1 - c[i].e)
    swing = 0.0
    for j in range(c.size):
        if j != i and W[i, j] != 0 and is_active(c[j]):
            swing = max(swing, oscillation(c, W, j))
    return not gap_closes_within(c, W, time, RIGID * swing)


@kernel_helper
def gap_closes_within(c, W, time, least):
    """Return whether the gap of any contact may close within a time.

    Gaps that close with little energy are ignored: `least` is twice the smallest energy of approach that matters.
    """
    for j in range(c.size):
        contact = c[j]
        if contact.frozen or contact.is_rigid or contact.phase != Phase.INACTIVE or W[j, j] <= 0:
            continue
        acceleration = 0.0
        for m in range(c.size):
            acceleration -= W[j, m] * c[m].F
        approach = contact.w + time * max(acceleration, 0.0)
        if -contact.delta < time * approach and approach * approach > least * W[j, j]:
            return True
    return False


@kernel_helper
def make_rigid(c, matrices, i):
    """Make contact i rigid for the rest of the collision, and eliminate it from the Delassus matrix."""
    W, pivots, number = matrices.W, matrices.pivots, 0
    for j in range(c.size):
        number += c[j].is_rigid
    c[number].eliminated = i
    deactivate(c[i])
    c[i].is_rigid, c[i].w, c[i].F = True, 0.0, 0.0
    for j in range(c.size):
        pivots[i, j] = W[i, j] / W[i, i] if j != i else 0.0
    for a in range(c.size):
        if a != i and pivots[i, a] != 0:
            for b in range(c.size):
                W[a, b] -= pivots[i, a] * W[i, b]
                if abs(W[a, b]) <= ROUNDING * sqrt(matrices.full[a, a] * matrices.full[b, b]):
                    W[a, b] = 0.0
    for j in range(c.size):
        W[i, j] = W[j, i] = 0.0


@kernel_helper
def write_rigid_forces(c, pivots, order):
    """Write the coefficient `order` of the forces of rigid contacts. These forces keep the contacts' rates at 0."""
    count = 0
    for i in range(c.size):
        count += c[i].is_rigid
    for number in range(count - 1, -1, -1):
        r = c[number].eliminated
        force = 0.0
        for j in range(c.size):
            force -= pivots[r, j] * c[j].forces[order]
        c[r].forces[order] = force


@kernel_helper
def is_pulled_open(c, pivots, x):
    """Return whether the force of a rigid contact falls below 0 by more than rounding before place x of a window."""
    for r in range(c.size):
        contact = c[r]
        if not contact.is_rigid:
            continue
        load = 0.0
        for j in range(c.size):
            for order in range(ORDER + 1):
                load += abs(pivots[r, j] * c[j].forces[order])
        if load > 0 and first_root(contact.forces, 1.0, contact.forces[0] + ROUNDING * load, ORDER, x) < x:
            return True
    return False
