"""The certified first event of a window: its contact, its watched function, and its time.

Over a window each watched function is a polynomial in x = t/h, whose remainder is below rounding (`in_time.motion`).
Its first root is certified as in `graph.event`, by `chain.roots.first_root`. Contacts are searched in their order, each
up to the earliest root so far. Of equal roots, the root of the first contact counts (`in_time.law` explains ties).

Used by `in_time.kernel`.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from impact_xval.model.chain.laws import Watched
from impact_xval.model.chain.roots import first_root
from impact_xval.model.chain.series import ORDER
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.in_time.law import watched_sign
from impact_xval.model.pair.law import Phase


class TimedEvent(NamedTuple):
    """First event of a window."""

    #: Contact, -1 for none, and the watched function that is zero at the event, one of `chain.laws.Watched`.
    contact: int
    watched: int
    #: Time of the event over the length of the window; infinite without an event, -1 where the search was given up.
    x: float


@kernel_helper
def first_zero(contact, watched, sign, latest):
    """Return x = t/h of the first zero of a watched function before x = `latest`.

    Infinity, 0 and -1 mean the same as in `chain.roots.first_root`.
    """
    table = contact.rates
    if watched == Watched.GAP:
        table = contact.deltas
    elif watched == Watched.FORCE:
        table = contact.forces
        if contact.phase == Phase.SLACK:
            table = contact.watched
            for order in range(ORDER + 1):
                table[order] = contact.k * contact.deltas[order] + contact.b * contact.rates[order]
    is_zero = watched == Watched.FORCE and contact.force_is_zero
    return first_root(table, sign, 0.0 if is_zero else sign * table[0], ORDER, latest)


@kernel_helper
def first_event(c):
    """Return the first event of a window whose series the contacts hold."""
    first_contact, first_watched, first_x = -1, 0, inf
    for i in range(c.size):
        if c[i].is_rigid:
            continue
        for watched in range(3):
            sign = watched_sign(c[i], watched)
            if sign == 0:
                continue
            x = first_zero(c[i], watched, sign, min(first_x, 1.0))
            if x < first_x:
                first_contact, first_watched, first_x = i, watched, x
    return TimedEvent(first_contact, first_watched, first_x)
