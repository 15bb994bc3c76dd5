"""The state of a graph in time during a collision, its energies, and the scratch space of the kernel.

Needs `chain.laws`, whose functions read the fields of a contact by name. Used by all modules of `graph.in_time` that
follow.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Records, zero_records
from impact_xval.model.chain.laws import Law, deactivate, force, is_active
from impact_xval.model.chain.series import ORDER
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.state import oscillation, rounding_energy
from impact_xval.model.pair.law import Phase

#: A contact during a collision, with its scratch space: the fields from `undecided` on, which each window overwrites.
TIMED_CONTACT = np.dtype(
    [
        # The fields that `chain.laws` reads. The exponent p is 1. Gravity g is 0, so `a` is not used.
        ("k", "f8"),  # running stiffness
        ("original", "f8"),  # stiffness at first touch
        ("e", "f8"),  # coefficient of restitution
        ("b", "f8"),  # damping
        ("w", "f8"),  # rate of compression
        ("delta", "f8"),  # depth; a gap if it is negative
        ("phase", "i8"),  # one of `Phase`
        ("law", "i8"),  # one of `Law`
        ("frozen", "?"),  # whether positions are frozen
        ("p", "f8"),
        ("g", "f8"),
        ("a", "f8"),
        ("F", "f8"),  # force
        ("impulse", "f8"),  # impulse so far
        (
            "reach",
            "f8",
        ),  # twice the largest energy so far of this contact and its neighbours (`graph.state.oscillation`)
        ("is_rigid", "?"),  # whether the contact is rigid for good; its phase is INACTIVE then
        ("eliminated", "i8"),  # in record n: the contact that became rigid as number n
        ("force_is_zero", "?"),  # whether an event at this instant has made the force zero
        ("undecided", "?"),  # whether the contact is at rest without depth, so that the start rule decides
        ("total", "f8"),  # intermediate sum of a coefficient, or the contact's oscillation
        ("rates", "f8", ORDER + 1),  # coefficients of w in x = t/h
        ("deltas", "f8", ORDER + 1),  # coefficients of delta
        ("forces", "f8", ORDER + 1),  # coefficients of F
        ("watched", "f8", ORDER + 1),  # coefficients of k delta + b w of a slack contact
    ],
    align=True,
)


class TimedMatrices(NamedTuple):
    """Matrices of one graph during a collision, each of shape (C, C)."""

    #: Delassus matrix.
    full: NDArray[np.float64]
    #: Delassus matrix without the rigid contacts, and the rows of their elimination (`in_time.rigid`).
    W: NDArray[np.float64]
    pivots: NDArray[np.float64]


def new_timed_contacts(contacts: int, law: Law, frozen: bool) -> Records:
    """Return contacts for the kernel to fill in."""
    c = zero_records(contacts, TIMED_CONTACT)
    c.law, c.frozen, c.p = law, frozen, 1.0
    return c


def new_timed_matrices(contacts: int) -> TimedMatrices:
    """Return matrices for the kernel to fill in."""
    return TimedMatrices(*np.zeros((3, contacts, contacts)))


@kernel_helper
def spring_energy(contact):
    """Return the strain energy of the spring of a contact; 0 if it is not active."""
    return 0.5 * contact.k * contact.delta * contact.delta if is_active(contact) else 0.0


@kernel_helper
def write_forces(c):
    """Write the forces of all contacts that are not rigid."""
    for i in range(c.size):
        if not c[i].is_rigid:
            c[i].F = force(c[i])


@kernel_helper
def is_moving(contact):
    """Return whether a contact is active, and has a depth or a rate."""
    return is_active(contact) and (contact.delta > 0 or contact.w != 0)


@kernel_helper
def may_still_act(contact):
    """Return whether a contact is active, or its bodies approach."""
    return is_moving(contact) or contact.w > 0


@kernel_helper
def still_rounding(c, W, energy):
    """Bring to rest the contacts of bistiffness without load whose energy is only rounding.

    In a symmetric graph a contact may be at rest at all times. Its rounding would otherwise end compressions, and each
    end would stiffen the contact for good. The depth of an inactive contact may be a gap that is only rounding.
    """
    for i in range(c.size):
        c[i].total = oscillation(c, W, i)
    for i in range(c.size):
        contact = c[i]
        for j in range(c.size):
            if (i == j or W[i, j] != 0) and c[j].total > contact.reach:
                contact.reach = c[j].total
        gap_energy = contact.k * contact.delta * contact.delta if contact.phase == Phase.INACTIVE else 0.0
        is_unloaded = contact.phase <= Phase.COMPRESSION and not contact.is_rigid
        if is_unloaded and contact.total + gap_energy <= rounding_energy(contact, energy):
            contact.w, contact.delta, contact.F = 0.0, 0.0, 0.0


@kernel_helper
def energy_left(c, W):
    """Return the energy of contacts that are active or whose bodies approach."""
    total = 0.0
    for i in range(c.size):
        contact = c[i]
        if W[i, i] > 0 and may_still_act(contact):
            total += 0.5 * contact.w * contact.w / W[i, i] + spring_energy(contact)
    return total


@kernel_helper
def bring_to_rest(c):
    """End all contacts that are active or whose bodies approach.

    Returned are the strain energy that is dropped, and whether one of these contacts has e < 1.
    """
    dropped, is_lossy = 0.0, False
    for i in range(c.size):
        contact = c[i]
        if may_still_act(contact):
            dropped += spring_energy(contact)
            is_lossy |= contact.e < 1
            contact.w = 0.0
            deactivate(contact)
    return dropped, is_lossy
