"""Rigid contacts of a graph: when a contact becomes rigid, the forces of rigid contacts, and which of them press.

**When a contact becomes rigid.** With restitution e = 0 a contact becomes rigid at its end of compression. With
0 < e < 1 each end of compression makes it stiffer, and its stiffness may grow without bound in a finite time. Then it
becomes rigid as well (`ringing_ends`; supplement, 3.4).

**Forces.** A rigid contact r keeps its rate of compression w_r = 0. So its force F_r solves (W F)_r = 0, where W is the
Delassus matrix. `eliminate` eliminates the rigid contacts from W one after another, as in Gaussian elimination:
W <- W - W_r W_r^T/W_rr for all other contacts, and F_r = -sum_j W_rj F_j/W_rr. In a chain this has the same effect as
uniting the two bodies of the contact. If earlier rigid contacts already keep the rate of a rigid contact at 0, its
pivot W_rr is 0. This contact is not eliminated, and carries no force.

**Which contacts press.** A rigid contact can only push: F_r >= 0 and w_r <= 0, and one of the two is 0. In a chain the
neighbours of a rigid contact only press it, so it stays closed. In a graph the neighbours may also pull it open. The
first non-zero coefficient of a power series shows whether a contact presses. For a contact that carries force, this
coefficient of its force must not be negative. For a contact without force, this coefficient of its rate must not be
positive. `exchange` changes the phase of the first contact that breaks this rule. `expand_with_rigid` then writes the
series anew, until no contact breaks the rule.

This is the least-index rule of Murty (Opsearch 11, 1974) for a linear complementarity problem. The rule is valid over
every ordered field, so also for power series. It is proven to end if the part of W that belongs to the rigid contacts
is a regular matrix. If it takes too many exchanges, the graph is given up.

Used by `graph.kernel`.
"""

from __future__ import annotations

from math import pi, sqrt

from impact_xval.model.chain.rigid import RIGID, SMALL
from impact_xval.model.chain.series import ORDER
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.motion import ROUNDING, apply_start_rule, expand, window_length
from impact_xval.model.graph.state import GraphPhase, is_compliant, oscillation

#: A pivot below this share of the contact's W_ii is taken as 0: other rigid contacts already keep its rate at 0.
NO_PIVOT = 1e-12

#: Largest number of changes of phase by `exchange`, per contact of the graph. With more changes the graph is given up.
MOST_EXCHANGES = 8


@kernel_helper
def eliminate(c, matrices):
    """Eliminate the contacts whose phase is RIGID from the Delassus matrix.

    The function writes the reduced matrix `W`, and the rows `pivots`, from which the forces of these contacts follow.
    """
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
        if c[r].phase == GraphPhase.RIGID:  # also a contact that others keep at rest
            for j in range(c.size):
                W[r, j] = W[j, r] = 0.0


@kernel_helper
def leading_sign(coefficients, scale):
    """Return the sign of the first coefficient that is more than rounding; 0 if all of them are rounding.

    A coefficient is taken for rounding if its magnitude is at most `ROUNDING` times `scale`. All coefficients before
    the first larger one are set to 0.
    """
    for order in range(ORDER + 1):
        if abs(coefficients[order]) > ROUNDING * scale:
            return 1 if coefficients[order] > 0 else -1
        coefficients[order] = 0.0
    return 0


@kernel_helper
def expand_with_rigid(c, matrices):
    """Decide which rigid contacts carry force, and write the power series of the next window.

    The function returns the length of the window, or -1 if more than `MOST_EXCHANGES` changes of phase per contact were
    needed.
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
    """Correct the phase of the first rigid contact whose phase is wrong, and return whether a phase was wrong.

    The phase RIGID is wrong if the contact would pull. The phase INACTIVE is wrong if its bodies would approach.
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
    """Make a contact rigid: from now on its phase is RIGID or INACTIVE."""
    contact.phase, contact.is_rigid = GraphPhase.RIGID, True
    contact.w, contact.F = 0.0, 0.0


@kernel_helper
def ringing_ends(c, W, i):
    """Return whether contact i, which has just ended compression, may be treated as rigid from here on.

    The force of the contact oscillates about its static load, the force that keeps its rate constant. Each end of
    compression divides the stiffness by e^2 and multiplies the period by e. So the contact becomes rigid after a finite
    time tau (supplement, 3.4). It is treated as rigid at once if three conditions are true until then:

    - its energy is negligible beside the energy of its neighbours;
    - the neighbours keep pressing it;
    - its oscillation cannot carry a neighbour's rate through zero, which would be an event.

    Chains have the same rule (`chain.rigid`).
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
    """Return whether contact j may have an event because a neighbouring contact oscillates.

    `least` is twice the smallest energy that matters. A contact with less energy only oscillates itself, and is
    disregarded.
    """
    if is_compliant(c[j].phase):
        return oscillation(c, W, j) > least
    return c[j].phase == GraphPhase.INACTIVE and c[j].w < 0
