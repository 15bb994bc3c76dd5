"""The state of a graph during a collision whose contact law is integrated over time.

The module also has the energies of contacts, and the scratch space of the kernel.

Needs `chain.laws`, whose functions read the fields of a contact by name. Used by `in_time.following`, which allocates
the records, and by `in_time.kernel`.
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

#: Record of one contact during a collision. The fields from `undecided` on are scratch space: they are overwritten in
#: each window, the time over which one power series is summed.
TIMED_CONTACT = np.dtype(
    [
        # The fields up to `a` are read by functions of `chain.laws`. The exponent p of the force is 1. Gravity g is 0,
        # so the acceleration `a` is not used.
        ("k", "f8"),  # running stiffness: each end of compression divides it by e^2
        ("original", "f8"),  # stiffness at first touch
        ("e", "f8"),  # coefficient of restitution
        ("b", "f8"),  # damping of the dashpot; 0 without a dashpot
        ("w", "f8"),  # rate of compression
        ("delta", "f8"),  # depth of the contact; a negative depth is a gap
        ("phase", "i8"),  # one of `Phase`
        ("law", "i8"),  # one of `Law`
        ("frozen", "?"),  # whether gaps are ignored, so that the depth of an inactive contact stays 0
        ("p", "f8"),
        ("g", "f8"),
        ("a", "f8"),
        ("F", "f8"),  # contact force
        ("impulse", "f8"),  # impulse since first touch
        (
            "reach",
            "f8",
        ),  # largest `graph.state.oscillation` so far of this contact and its neighbours
        ("is_rigid", "?"),  # whether the contact has become rigid; its phase is then INACTIVE
        ("eliminated", "i8"),  # field of record n: number of the contact that became rigid after n others
        ("force_is_zero", "?"),  # whether an event at the present time has made the force zero
        ("undecided", "?"),  # at rest without depth: the start rule may make the contact active
        (
            "total",
            "f8",
        ),  # intermediate result: a sum in `in_time.motion.expand`, or the value of `oscillation`
        (
            "rates",
            "f8",
            ORDER + 1,
        ),  # coefficients of w in powers of x = t/h, where h is the length of the window
        ("deltas", "f8", ORDER + 1),  # coefficients of delta in powers of x
        ("forces", "f8", ORDER + 1),  # coefficients of F in powers of x
        ("watched", "f8", ORDER + 1),  # coefficients of k delta + b w of a contact whose phase is SLACK
    ],
    align=True,
)


class TimedMatrices(NamedTuple):
    """Matrices of one graph during a collision, each of shape (C, C)."""

    #: Delassus matrix.
    full: NDArray[np.float64]
    #: Delassus matrix from which the rigid contacts are eliminated (`in_time.rigid`).
    W: NDArray[np.float64]
    #: Row r gives the force of the rigid contact r from the forces of all other contacts.
    pivots: NDArray[np.float64]


def new_timed_contacts(contacts: int, law: Law, frozen: bool) -> Records:
    """Return records of `TIMED_CONTACT` for the kernel to fill in; the law and `frozen` are set."""
    c = zero_records(contacts, TIMED_CONTACT)
    c.law, c.frozen, c.p = law, frozen, 1.0
    return c


def new_timed_matrices(contacts: int) -> TimedMatrices:
    """Return matrices of zeros for the kernel to fill in."""
    return TimedMatrices(*np.zeros((3, contacts, contacts)))


@kernel_helper
def spring_energy(contact):
    """Return the strain energy k delta^2/2 of the spring of a contact; 0 if the contact is not active."""
    return 0.5 * contact.k * contact.delta * contact.delta if is_active(contact) else 0.0


@kernel_helper
def write_forces(c):
    """Compute the force of each contact that is not rigid, and store it in its field `F`."""
    for i in range(c.size):
        if not c[i].is_rigid:
            c[i].F = force(c[i])


@kernel_helper
def is_moving(contact):
    """Return whether a contact is active, and its depth or its rate of compression is not 0."""
    return is_active(contact) and (contact.delta > 0 or contact.w != 0)


@kernel_helper
def may_still_act(contact):
    """Return whether a contact is active and moves, or its bodies approach."""
    return is_moving(contact) or contact.w > 0


@kernel_helper
def still_rounding(c, W, energy):
    """Set rates, depths and forces of bistiffness contacts to 0 where they are only rounding.

    Contacts in restitution and rigid contacts keep their values. In a symmetric graph the exact rate of a contact may
    be 0 at all times. Without this function the rounding of such a rate would end compressions, and each end would make
    the contact stiffer. The gap of an inactive contact may also be only rounding.
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
    """Return the sum of kinetic and strain energies of all contacts that are active or whose bodies approach."""
    total = 0.0
    for i in range(c.size):
        contact = c[i]
        if W[i, i] > 0 and may_still_act(contact):
            total += 0.5 * contact.w * contact.w / W[i, i] + spring_energy(contact)
    return total


@kernel_helper
def bring_to_rest(c):
    """Make all contacts inactive that are active or whose bodies approach, and set their rates to 0.

    The function returns their strain energy, which is lost, and whether a contact among them has a restitution below 1.
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
