"""Search for the first event of a window of a graph in time. No event can be missed.

An event is a zero of a watched function: of the rate of compression, the depth or the force of a contact. Over a window
of length h each watched function is a polynomial in x = t/h, whose remainder is below rounding (`in_time.motion`).
`chain.roots.first_root` finds its first root, and steps over no root. The contacts are searched one after another, each
only up to the earliest root so far. If two roots are equal, the event belongs to the contact with the lower number.

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
    """First event of a window, or no event.

    A window is a time over which one power series gives the motion.
    """

    #: Number of the contact, from 0; -1 if the window has no event.
    contact: int
    #: The function that is zero at the event, one of `chain.laws.Watched`.
    watched: int
    #: Time of the event, divided by the length of the window. Infinite if the window has no event; -1 if the search was
    #: given up.
    x: float


@kernel_helper
def first_zero(contact, watched, sign, latest):
    """Return the place x = t/h of the first zero of a watched function of a contact, if it is before `latest`.

    `sign` is the sign that the function has before its zero. The result is infinite if there is no zero, 0 if the
    function leaves this sign at once, and -1 if the search was given up.
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
    """Return the first event of a window. The records `c` of the contacts hold the power series of the window."""
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
