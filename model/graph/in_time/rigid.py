"""Rigid contacts under bistiffness: contacts whose running stiffness has run away (supplement, 3.4).

The model's rule, `graph.rigid.ringing_ends`, holds with one more condition: no gap closes up to the time at which the
contact is rigid.

A rigid contact keeps w_r = 0, and its row is eliminated as in `graph.rigid`: W <- W - W_r W_r^T/W_rr, and
F_r = -sum_j W_rj F_j/W_rr. A rigid contact stays closed for good. In a chain its neighbours only press it. In a graph
they may pull it open, and with positions it would later close again with a blow. Such a graph is given up
(`is_pulled_open`).

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
    """Return whether contact i, which has just ended compression, may count as rigid from here on."""
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
    """Return whether a gap may close within a time.

    `least` is twice the smallest energy of approach that matters.
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
    """Make contact i rigid for good, and eliminate it from W."""
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
    """Write a coefficient of the forces of rigid contacts, which keep their rates at 0."""
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
    """Return whether the force of a rigid contact falls below 0, beyond rounding, in the first part x of a window."""
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
