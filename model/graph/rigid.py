"""Rigid contacts of a graph: when a contact becomes rigid, the forces of rigid contacts, and which of them press.

**When.** At e = 0 an end of compression makes a contact rigid. For e > 0 its running stiffness may run away
(`ringing_ends`; supplement, 3.4), as in chains.

**Forces.** A rigid contact keeps w_r = 0, so (W F)_r = 0. `eliminate` removes these rows one after another. Each
elimination gives W <- W - W_r W_r^T/W_rr for all other contacts, and F_r = -sum_j W_rj F_j/W_rr. In a chain this is the
same as one body in place of two. A rigid contact that other rigid contacts already keep at rest has no pivot, and
carries no force.

**Which contacts press.** A rigid contact only pushes: F_r >= 0 and w_r <= 0, and one of the two is 0. In a chain the
neighbours only press, so a rigid contact stays closed. In a graph neighbours may also pull it open. As in the start
rule, first non-zero coefficients decide. The force of a contact that presses must not begin below 0, and the rate of a
contact that does not press must not begin above 0. `exchange` changes the first contact that breaks this rule, and
`expand_with_rigid` writes the series anew until no contact breaks it.

This is the least-index rule of Murty (Opsearch 11, 1974) for a complementarity problem. The rule is valid over every
ordered field, so also for power series, and it ends if W of the rigid contacts is regular. If the exchanges go on for
too long, the graph is given up.

Used by `graph.kernel`.
"""

from __future__ import annotations

from math import pi, sqrt

from impact_xval.model.chain.rigid import RIGID, SMALL
from impact_xval.model.chain.series import ORDER
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.motion import ROUNDING, apply_start_rule, expand, window_length
from impact_xval.model.graph.state import GraphPhase, is_compliant, oscillation

#: Pivots below this share of W_ii are rounding: other rigid contacts keep the contact at rest.
NO_PIVOT = 1e-12

#: Exchanges per contact, by `exchange`, after which a graph is given up.
MOST_EXCHANGES = 8


@kernel_helper
def eliminate(c, matrices):
    """Write W without the contacts whose phase is RIGID, and the rows that give the forces of these contacts."""
    full, W, pivots = matrices.full, matrices.W, matrices.pivots
    for i in range(c.size):
        c[i].has_pivot = False
        for j in range(c.size):
            W[i, j] = full[i, j]
    for r in range(c.size):
        pivot = W[r, r]
        if c[r].phase != GraphPhase.RIGID or pivot <= NO_PIVOT * full[r, r]:
            continue
        c[r].has_pivot = True
        for j in range(c.size):
            pivots[r, j] = W[r, j] / pivot if j != r else 0.0
        for i in range(c.size):
            if i == r or pivots[r, i] == 0:
                continue
            for j in range(c.size):
                W[i, j] -= pivots[r, i] * W[r, j]
                if abs(W[i, j]) <= ROUNDING * sqrt(full[i, i] * full[j, j]):
                    W[i, j] = 0.0
        for j in range(c.size):
            W[r, j] = W[j, r] = 0.0
    for r in range(c.size):
        if c[r].phase == GraphPhase.RIGID:  # also a contact without a pivot: others keep it at rest
            for j in range(c.size):
                W[r, j] = W[j, r] = 0.0


@kernel_helper
def leading_sign(coefficients, scale):
    """Return the sign of the first coefficient that is not rounding, or 0; earlier coefficients are set to 0."""
    for order in range(ORDER + 1):
        if abs(coefficients[order]) > ROUNDING * scale:
            return 1 if coefficients[order] > 0 else -1
        coefficients[order] = 0.0
    return 0


@kernel_helper
def expand_with_rigid(c, matrices):
    """Decide which rigid contacts press, and write the series of the next window.

    Returned is the length of the window; -1 if the decision was given up.
    """
    any_rigid = False
    for i in range(c.size):
        any_rigid |= c[i].is_rigid
    exchanges = MOST_EXCHANGES * c.size if any_rigid else 0
    for _ in range(exchanges + 1):
        if any_rigid:
            eliminate(c, matrices)
        apply_start_rule(c)
        h = window_length(c, matrices.W)
        expand(c, matrices, h)
        if not any_rigid or not exchange(c, matrices.full, h):
            return h
    return -1.0


@kernel_helper
def exchange(c, full, h):
    """Change the phase of the first rigid contact whose phase is wrong, and return whether there was one.

    The phase is wrong if the contact would pull, or if its bodies would approach.
    """
    for r in range(c.size):
        contact = c[r]
        if not contact.is_rigid or contact.w != 0:
            continue
        load = 0.0
        for j in range(c.size):
            for order in range(ORDER + 1):
                load = max(load, abs(full[r, j] * c[j].forces[order]))
        if contact.phase == GraphPhase.RIGID:
            if leading_sign(contact.forces, load / full[r, r]) < 0:
                contact.phase, contact.F = GraphPhase.INACTIVE, 0.0
                return True
        elif leading_sign(contact.rates, load * h) > 0:
            contact.phase = GraphPhase.RIGID
            return True
    return False


@kernel_helper
def make_rigid(contact):
    """Make a contact rigid for good."""
    contact.phase, contact.is_rigid = GraphPhase.RIGID, True
    contact.w, contact.F = 0.0, 0.0


@kernel_helper
def ringing_ends(c, W, i):
    """Return whether contact i, which has just ended compression, may count as rigid from here on.

    The contact rings about its static load, the force that keeps its rate constant. Each end of compression makes the
    contact stiffer by 1/e^2 at the same force, and its periods shorter by e. So the contact becomes rigid after a
    finite time tau (supplement, 3.4). It counts as rigid at once if three conditions hold up to then: its energy is
    negligible beside its neighbours' energy; the neighbours keep pressing it; and its ringing cannot carry a
    neighbour's rate through zero, which would be an event. Chains have the same rule (`chain.rigid`).
    """
    contact, inverse = c[i], W[i, i]
    if inverse <= 0:
        return False
    static, change, swing = 0.0, 0.0, 0.0
    for j in range(c.size):
        if j != i and W[i, j] != 0 and is_compliant(c[j].phase):
            static -= W[i, j] / inverse * c[j].F
            change -= W[i, j] / inverse * c[j].k * c[j].w
            swing = max(swing, oscillation(c, W, j))
    tau = 2 * pi / sqrt(contact.k * inverse) / (1 - contact.e)
    load = max(contact.F, static)
    may_unload = abs(change) * tau >= 0.5 * static
    has_energy = load * load / (contact.k * (1 - contact.e)) > RIGID * swing
    if may_unload or has_energy:
        return False
    wiggle = abs(contact.F - static) / sqrt(inverse * contact.k)
    for j in range(c.size):
        if j != i and W[i, j] != 0 and has_events(c, W, j, SMALL * swing):
            acceleration = 0.0
            for m in range(c.size):
                if is_compliant(c[m].phase):
                    acceleration -= W[j, m] * c[m].F
            if abs(c[j].w) < 4 * abs(W[i, j]) * wiggle + 2 * abs(acceleration) * tau:
                return False
    return True


@kernel_helper
def has_events(c, W, j, least):
    """Return whether contact j may have an event while a neighbour rings.

    A contact with less energy than `least` only rings itself, and is disregarded.
    """
    if is_compliant(c[j].phase):
        return oscillation(c, W, j) > least
    return c[j].phase == GraphPhase.INACTIVE and c[j].w < 0
