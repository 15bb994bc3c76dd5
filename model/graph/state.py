"""The state of a graph during a collision, its energies, and the scratch space of the kernel.

The motion is computed from the Delassus matrix W, and for each contact i from its stiffness k_i, its restitution e_i,
its rate of compression w_i and its force F_i:

    w' = -W F        F_i' = k_i w_i while contact i is active

All w and F are continuous at every event. An event changes only the stiffness and the phase of its own contact
(`graph.law`). The strain energy of contact i is E_i = F_i^2/(2 k_i).

Used by all modules of `graph` that compute motion, and by `graph.solving`, which allocates the records.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Records, zero_records
from impact_xval.model.chain.series import ORDER
from impact_xval.model.compiled import kernel_helper

#: Largest energy of a contact that is taken for rounding, as a share of the largest energy of it and its neighbours. It
#: is the square of 2^-48: a rate is a sum over many contacts, so its relative rounding is larger than 2^-53.
ROUNDING_ENERGY = 2.0**-96

#: Energies below this share of the energy of impact are taken as zero. In a long row of balls the forces far ahead of
#: the wave are so small that they underflow.
UNDERFLOW = 1e-150


class GraphPhase(IntEnum):
    """Phase of a contact of a graph."""

    INACTIVE = 0  # the contact carries no force
    COMPRESSION = 1
    RESTITUTION = 2
    RIGID = 3  # infinitely stiff: the contact carries the force that keeps its rate of compression at 0


#: Record of one contact during a collision. The fields from `undecided` on are scratch space: they are overwritten in
#: each window, the time over which one power series is summed.
GRAPH_CONTACT = np.dtype(
    [
        ("k", "f8"),  # running stiffness: each end of compression divides it by e^2
        ("e", "f8"),  # coefficient of restitution of the contact
        ("w", "f8"),  # rate of compression
        ("F", "f8"),  # contact force
        ("impulse", "f8"),  # impulse since first touch
        ("phase", "i8"),  # one of `GraphPhase`
        ("is_rigid", "?"),  # whether the contact has become rigid; its phase is then RIGID or INACTIVE
        ("reach", "f8"),  # largest `oscillation` so far of this contact and its neighbours
        ("undecided", "?"),  # at rest without force: the start rule may make the contact active
        ("has_pivot", "?"),  # whether `graph.rigid.eliminate` has eliminated the contact from W
        ("total", "f8"),  # intermediate result: a sum in `graph.motion.expand`, or the value of `oscillation`
        (
            "rates",
            "f8",
            ORDER + 1,
        ),  # coefficients of w in powers of x = t/h, where h is the length of the window
        ("forces", "f8", ORDER + 1),  # coefficients of F in powers of x
        ("turns", "f8", ORDER + 1),  # coefficients of dw/dx, in which `graph.grazing` finds turning points
    ],
    align=True,
)


class Matrices(NamedTuple):
    """Matrices of one graph during a collision, each of shape (C, C)."""

    #: Delassus matrix.
    full: NDArray[np.float64]
    #: Delassus matrix from which the rigid contacts are eliminated (`graph.rigid`).
    W: NDArray[np.float64]
    #: Row r gives the force of the rigid contact r from the forces of all other contacts.
    pivots: NDArray[np.float64]
    #: Scratch space of `graph.grazing`: the matrix A = sqrt(K) W sqrt(K), and its eigenvectors.
    A: NDArray[np.float64]
    vectors: NDArray[np.float64]


def new_contacts(contacts: int) -> Records:
    """Return records of `GRAPH_CONTACT`, all zeros, for the kernel to fill in."""
    return zero_records(contacts, GRAPH_CONTACT)


def new_matrices(contacts: int) -> Matrices:
    """Return matrices of zeros for the kernel to fill in."""
    return Matrices(*np.zeros((5, contacts, contacts)))


@kernel_helper
def is_compliant(phase):
    """Return whether a contact in this phase is a loaded spring: it is active and not rigid."""
    return (phase == GraphPhase.COMPRESSION) | (phase == GraphPhase.RESTITUTION)


@kernel_helper
def strain_energy(contact):
    """Return the strain energy F^2/(2 k) of a contact; 0 for an inactive or a rigid contact."""
    return 0.5 * contact.F * contact.F / contact.k if is_compliant(contact.phase) else 0.0


@kernel_helper
def oscillation(c, W, i):
    """Return twice the energy that contact i has if no other contact acts: 2 E_i + w_i^2/W_ii.

    E_i is the strain energy of the contact, and W_ii is the inverse of its reduced mass. The result is 0 for a rigid
    contact.
    """
    contact = c[i]
    if contact.phase == GraphPhase.RIGID or W[i, i] <= 0:
        return 0.0
    return 2 * strain_energy(contact) + contact.w * contact.w / W[i, i]


@kernel_helper
def rounding_energy(contact, energy):
    """Return an upper bound of twice the energy that rounding alone can give to a contact.

    `energy` is the energy of impact.
    """
    return ROUNDING_ENERGY * contact.reach + UNDERFLOW * energy


@kernel_helper
def still_rounding(c, W, energy):
    """Set rates and forces to 0 where they are only rounding.

    Contacts in restitution and rigid contacts keep their values. In a symmetric graph the exact rate of a contact may
    be 0 at all times. Without this function the rounding of such a rate would begin and end compressions for ever.
    """
    for i in range(c.size):
        c[i].total = oscillation(c, W, i)
    for i in range(c.size):
        contact = c[i]
        for j in range(c.size):
            if (i == j or W[i, j] != 0) and c[j].total > contact.reach:
                contact.reach = c[j].total
        is_loaded = contact.phase == GraphPhase.RESTITUTION or contact.phase == GraphPhase.RIGID
        if not is_loaded and contact.total <= rounding_energy(contact, energy):
            contact.w, contact.F = 0.0, 0.0
