"""The state of a graph during a collision, its energies, and the scratch space of the kernel.

The law sees the Delassus matrix W, stiffnesses k, restitutions e, rates of compression w and forces F:

    w' = -W F        F_i' = k_i w_i while contact i is active

All w and F are continuous through every event, so an event changes k_i and the phase of its own contact alone
(`graph.law`). Strain energies are E_i = F_i^2/(2 k_i).

Used by the other modules of `graph`, from the motion to the kernel.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Records, zero_records
from impact_xval.model.chain.series import ORDER
from impact_xval.model.compiled import kernel_helper

#: Share of a neighbour's energy that is rounding: the square of 2^-48, because a rate is a sum over many contacts.
ROUNDING_ENERGY = 2.0**-96

#: Loads below this share of the energy of impact count as zero: far ahead of a wave, loads underflow.
UNDERFLOW = 1e-150


class GraphPhase(IntEnum):
    """Phase of a contact of a graph."""

    INACTIVE = 0  # the contact carries no force
    COMPRESSION = 1
    RESTITUTION = 2
    RIGID = 3  # infinitely stiff: its force keeps its rate at 0


#: A contact during a collision, with its scratch space: the fields from `undecided` on, which each window overwrites.
GRAPH_CONTACT = np.dtype(
    [
        ("k", "f8"),  # running stiffness
        ("e", "f8"),  # coefficient of restitution
        ("w", "f8"),  # rate of compression
        ("F", "f8"),  # force
        ("impulse", "f8"),  # impulse so far
        ("phase", "i8"),  # one of `GraphPhase`
        ("is_rigid", "?"),  # whether the contact is rigid for good: its phase is RIGID or INACTIVE
        ("reach", "f8"),  # twice the largest energy so far of this contact and its neighbours (`oscillation`)
        ("undecided", "?"),  # whether the contact is at rest without force, so that the start rule decides
        ("has_pivot", "?"),  # whether the contact is eliminated from W (`graph.rigid`)
        ("total", "f8"),  # intermediate sum of a coefficient (`graph.motion`), or `oscillation`
        ("rates", "f8", ORDER + 1),  # coefficients of w in x = t/h
        ("forces", "f8", ORDER + 1),  # coefficients of F
        ("turns", "f8", ORDER + 1),  # coefficients of w'; `graph.grazing` shifts them
    ],
    align=True,
)


class Matrices(NamedTuple):
    """Matrices of one graph during a collision, each of shape (C, C)."""

    #: Delassus matrix.
    full: NDArray[np.float64]
    #: Delassus matrix without the rigid contacts, and the rows of their elimination (`graph.rigid`).
    W: NDArray[np.float64]
    pivots: NDArray[np.float64]
    #: Scratch space: A of `graph.motion`, and its eigenvectors.
    A: NDArray[np.float64]
    vectors: NDArray[np.float64]


def new_contacts(contacts: int) -> Records:
    """Return contacts for the kernel to fill in."""
    return zero_records(contacts, GRAPH_CONTACT)


def new_matrices(contacts: int) -> Matrices:
    """Return matrices for the kernel to fill in."""
    return Matrices(*np.zeros((5, contacts, contacts)))


@kernel_helper
def is_compliant(phase):
    """Return whether a contact of this phase carries the force of a spring."""
    return (phase == GraphPhase.COMPRESSION) | (phase == GraphPhase.RESTITUTION)


@kernel_helper
def strain_energy(contact):
    """Return the strain energy of a contact; 0 if it is inactive or rigid."""
    return 0.5 * contact.F * contact.F / contact.k if is_compliant(contact.phase) else 0.0


@kernel_helper
def oscillation(c, W, i):
    """Return twice the energy of the oscillation of contact i alone, against the inverse mass W_ii."""
    contact = c[i]
    if contact.phase == GraphPhase.RIGID or W[i, i] <= 0:
        return 0.0
    return 2 * strain_energy(contact) + contact.w * contact.w / W[i, i]


@kernel_helper
def rounding_energy(contact, energy):
    """Return twice the energy that rounding alone can give a contact, where the energy of impact is `energy`."""
    return ROUNDING_ENERGY * contact.reach + UNDERFLOW * energy


@kernel_helper
def still_rounding(c, W, energy):
    """Bring to rest the contacts without load whose energy is only rounding.

    In a symmetric graph the exact rate of a contact may be 0 at all times. The rounding of this rate would otherwise
    begin and end compressions for ever.
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
