"""The impact law: the effect of an event on one contact of two balls on a table.

`Contact` is one contact during a collision, `Pair` are two balls and both contacts during a collision. The functions
return the contact after an event.

**Energetic restitution with stiffening** (docs/theory.md, section 2). At an end of compression E <- e^2 E and
k <- k/e^2, so that the force F = sqrt(2 k E) is continuous. A restart of compression keeps the stiffness. A contact
that ends restitution keeps its stiffness too; if it returns, it begins in compression with E = 0.

**The law of Liu, Zhao and Brogliato** (Proc. R. Soc. A 464:3193, 2008) differs in repeated compressions only: each
repeated compression runs at the original stiffness. In their law F = sqrt(2 k E) holds at all times, with dE = V dP in
compression and dE = V dP/e^2 in restitution. In the terms of this module, a restart of compression reverses the end of
compression, E <- E/e^2 and k <- e^2 k, and a return begins at the original k.

Units as in `pair.motion`. Used by `pair.kernel`; `model.chain` shares the phases.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from impact_xval.model.compiled import force_inlined


class Phase(IntEnum):
    """Phase of a contact; SLACK and HELD occur in chains only (`chain.laws`)."""

    INACTIVE = 0  # the contact carries no force
    COMPRESSION = 1
    RESTITUTION = 2
    SLACK = 3  # the bodies overlap without force
    HELD = 4  # inactive with frozen positions; only a row of `chain.laws.WATCHED`, never stored


class Contact(NamedTuple):
    """One contact during a collision."""

    phase: Phase
    #: Running stiffness, strain energy, and force sqrt(2 k E). The force is up to date in S1 only.
    k: float
    E: float
    F: float
    #: Coefficient of restitution.
    e: float
    #: Stiffness before the first end of compression.
    original: float


class Pair(NamedTuple):
    """Two balls on a table during a collision."""

    #: Compression rate v2 - v1 of contact 1, and v2, which is minus the compression rate of contact 2.
    d1: float
    v2: float
    contact1: Contact
    contact2: Contact
    #: Energy lost so far.
    loss: float


@force_inlined
def with_energy(c, E):
    """Return the contact with another strain energy."""
    return Contact(c.phase, c.k, E, c.F, c.e, c.original)


@force_inlined
def end_of_compression(c, loss):
    """Return the contact after its end of compression, and `loss` plus the energy that is lost there."""
    e2 = c.e * c.e
    return Contact(Phase.RESTITUTION, c.k / e2, e2 * c.E, c.F, c.e, c.original), loss + (1 - e2) * c.E


@force_inlined
def restart(stiffens, c, loss):
    """Return the contact after a restart of compression, and all the energy lost so far.

    Under a law that does not stiffen, the restart gives back the energy that the end of compression took.
    """
    if stiffens:
        return Contact(Phase.COMPRESSION, c.k, c.E, c.F, c.e, c.original), loss
    e2 = c.e * c.e
    return Contact(Phase.COMPRESSION, c.original, c.E / e2, c.F, c.e, c.original), loss - (1 / e2 - 1) * c.E


@force_inlined
def reactivate(stiffens, c):
    """Return an inactive contact after its return: in compression, with E = 0."""
    return Contact(Phase.COMPRESSION, c.k if stiffens else c.original, 0.0, 0.0, c.e, c.original)


@force_inlined
def end_of_restitution(c):
    """Return the contact after its end of restitution: inactive, at the same stiffness."""
    return Contact(Phase.INACTIVE, c.k, 0.0, 0.0, c.e, c.original)


@force_inlined
def after_event(stiffens, c, F, rate_is_zero, force_is_zero, loss):
    """Return an active contact after an event, and all the energy lost so far.

    At the event the contact has the force F, and its compression rate, its force, or both are zero. A plastic contact
    has no restitution: it becomes inactive when its compression ends.
    """
    c = Contact(c.phase, c.k, 0.5 * F * F / c.k, F, c.e, c.original)
    compression_ends = rate_is_zero and c.phase == Phase.COMPRESSION
    if compression_ends:
        c, loss = end_of_compression(c, loss)
    elif rate_is_zero:
        c, loss = restart(stiffens, c, loss)
    if force_is_zero or (compression_ends and c.e == 0):
        c = end_of_restitution(c)
    return c, loss
