"""The impact law: what an event does to one contact.

Energetic restitution with stiffening (docs/theory.md, section 2). At an end of compression E <- e^2 E and k <- k/e^2,
so that the force F = sqrt(2 k E) is continuous; a restart of compression keeps the stiffness; a contact that ends
restitution keeps it for its return, which begins in compression with E = 0.

The law of Liu, Zhao and Brogliato (Proc. R. Soc. A 464:3193, 2008) differs in repeated compressions only: each runs at
the original stiffness. Their F = sqrt(2 k E) holds at all times, with dE = V dP in compression and V dP/e^2 in
restitution; in the terms used here a restart of compression takes back what the end of compression did, E <- E/e^2 and
k <- e^2 k, and a return begins at the original k.

Units as in `pair.motion`.
"""

from __future__ import annotations

from typing import NamedTuple

from impact_xval.model.compiled import inlined

#: Phases of a contact.
INACTIVE, COMPRESSION, RESTITUTION = 0, 1, 2


class Contact(NamedTuple):
    """One contact under way."""

    phase: int
    #: Running stiffness, strain energy, and force sqrt(2 k E), which is kept in S1 only.
    k: float
    E: float
    F: float
    #: Coefficient of restitution, and the stiffness before any end of compression.
    e: float
    original: float


@inlined
def with_energy(c, E):
    """Return the contact with another strain energy."""
    return Contact(c.phase, c.k, E, c.F, c.e, c.original)


@inlined
def end_of_compression(c, loss):
    """End compression; the energy lost is added to `loss`."""
    e2 = c.e * c.e
    return Contact(RESTITUTION, c.k / e2, e2 * c.E, c.F, c.e, c.original), loss + (1 - e2) * c.E


@inlined
def restart(stiffens, c, loss):
    """Restart compression during restitution; `loss` less what a law that takes back the end gives back."""
    if stiffens:
        return Contact(COMPRESSION, c.k, c.E, c.F, c.e, c.original), loss
    e2 = c.e * c.e
    return Contact(COMPRESSION, c.original, c.E / e2, c.F, c.e, c.original), loss - (1 / e2 - 1) * c.E


@inlined
def returned(stiffens, c):
    """Return an inactive contact, in compression from E = 0."""
    return Contact(COMPRESSION, c.k if stiffens else c.original, 0.0, 0.0, c.e, c.original)


@inlined
def spent(c):
    """End restitution: the contact becomes inactive and keeps its stiffness."""
    return Contact(INACTIVE, c.k, 0.0, 0.0, c.e, c.original)


@inlined
def after_event(stiffens, c, F, rate_is_zero, force_is_zero, loss):
    """Apply the law to a contact that acts, at force F, where its compression rate or its force is zero, or both.

    A plastic contact has no restitution: it is spent as its compression ends.
    """
    c = Contact(c.phase, c.k, 0.5 * F * F / c.k, F, c.e, c.original)
    ends = rate_is_zero and c.phase == COMPRESSION
    if ends:
        c, loss = end_of_compression(c, loss)
    elif rate_is_zero:
        c, loss = restart(stiffens, c, loss)
    if force_is_zero or (ends and c.e == 0):
        c = spent(c)
    return c, loss
