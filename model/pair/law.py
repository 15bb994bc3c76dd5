"""The impact law for two balls on a table: the effect of an event on one contact.

`Contact` is one contact during a collision. `Pair` is the state of both balls and both contacts. The functions return
the contact after an event.

**Energetic restitution with stiffening** (docs/theory.md, section 2). At an end of compression E <- e^2 E and k <-
k/e^2, which keeps the force F = sqrt(2 k E) continuous. A restart of compression keeps the stiffness. A contact that
ends restitution keeps its stiffness, too. If it becomes active again, it begins in compression with E = 0.

**The law of Liu, Zhao and Brogliato** (Proc. R. Soc. A 464:3193, 2008) differs only in repeated compressions: each of
them begins with the original stiffness. In their notation F = sqrt(2 k E) at all times, with dE = V dP in compression
and dE = V dP/e^2 in restitution. In the notation of this module, a restart of compression reverses the end of
compression: E <- E/e^2 and k <- e^2 k. A contact that becomes active again begins with the original k.

Units as in `pair.motion`.

Used by `pair.kernel`. `model.chain` uses the same phases.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from impact_xval.model.compiled import force_inlined


class Phase(IntEnum):
    """Phase of a contact. SLACK and HELD occur only in chains and contact graphs (`chain.laws`)."""

    INACTIVE = 0  # the contact carries no force
    COMPRESSION = 1
    RESTITUTION = 2
    SLACK = 3  # a dashpot has ended the force, and the bodies still overlap
    HELD = 4  # inactive, with its gap ignored; used only as an index of `chain.laws.WATCHED`


class Contact(NamedTuple):
    """One contact during a collision."""

    phase: Phase
    #: Running stiffness.
    k: float
    #: Strain energy.
    E: float
    #: Force sqrt(2 k E). The value is valid only in S1, where both contacts are active.
    F: float
    #: Coefficient of restitution.
    e: float
    #: Stiffness before the first end of compression.
    original: float


class Pair(NamedTuple):
    """Two balls on a table during a collision."""

    #: Rate of compression v2 - v1 of contact 1.
    d1: float
    #: Velocity of ball 2, which is minus the rate of compression of contact 2.
    v2: float
    contact1: Contact
    contact2: Contact
    #: Energy lost so far.
    loss: float


@force_inlined
def with_energy(c, E):
    """Return a contact with its strain energy replaced by E; its force is not updated."""
    return Contact(c.phase, c.k, E, c.F, c.e, c.original)


@force_inlined
def end_of_compression(c, loss):
    """Return the contact after its end of compression, and `loss` plus the energy that this event loses."""
    e2 = c.e * c.e
    return Contact(Phase.RESTITUTION, c.k / e2, e2 * c.E, c.F, c.e, c.original), loss + (1 - e2) * c.E


@force_inlined
def restart(stiffens, c, loss):
    """Return the contact after a restart of compression, and all the energy that the collision has lost so far.

    If `stiffens` is false, the law is that of Liu, Zhao and Brogliato. The restart then gives back the energy that the
    end of compression took.
    """
    if stiffens:
        return Contact(Phase.COMPRESSION, c.k, c.E, c.F, c.e, c.original), loss
    e2 = c.e * c.e
    return Contact(Phase.COMPRESSION, c.original, c.E / e2, c.F, c.e, c.original), loss - (1 / e2 - 1) * c.E


@force_inlined
def reactivate(stiffens, c):
    """Return an inactive contact after it has become active again: in compression, with strain energy 0."""
    return Contact(Phase.COMPRESSION, c.k if stiffens else c.original, 0.0, 0.0, c.e, c.original)


@force_inlined
def end_of_restitution(c):
    """Return the contact after its end of restitution: inactive, with the same stiffness."""
    return Contact(Phase.INACTIVE, c.k, 0.0, 0.0, c.e, c.original)


@force_inlined
def after_event(stiffens, c, F, rate_is_zero, force_is_zero, loss):
    """Return an active contact after an event, and all the energy that the collision has lost so far.

    At the event the contact has the force F. Its rate of compression, its force, or both may be zero. A contact with
    e = 0 has no restitution: it becomes inactive when its compression ends.
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
