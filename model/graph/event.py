"""Search for the first event of a window. No event can be missed.

**Why no event is missed.** An event is a zero of a watched function: of the force F_i or the rate of compression w_i of
a contact (`graph.law`). Over a window of length h the function is a polynomial in x = t/h, its power series, whose
remainder is below rounding (`graph.motion` has the proof). `chain.roots.first_root` finds the first root of the
polynomial on [0, 1], and describes the method. It steps over no root, and over no pair of close roots. The event that
has just happened must not be found again. Therefore a function that is 0 when the window begins is first divided by
the power of x with which it begins.

**Which event is first.** The event is the earliest root of all watched functions. The contacts are searched one after
another, each only up to the earliest root so far. If two roots are equal, the event belongs to the contact with the
lower number.

Used by `graph.kernel`.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from impact_xval.model.chain.roots import first_root
from impact_xval.model.chain.series import ORDER
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.law import WATCHED, GraphWatched


class GraphEvent(NamedTuple):
    """First event of a window, or no event.

    A window is a time over which one power series gives the motion.
    """

    #: Number of the contact, from 0; -1 if the window has no event.
    contact: int
    #: The function that is zero at the event, one of `GraphWatched`.
    watched: int
    #: Time of the event, divided by the length of the window. Infinite if the window has no event; -1 if the search was
    #: given up.
    x: float


@kernel_helper
def first_event(c):
    """Return the first event of a window. The records `c` of the contacts hold the power series of the window."""
    first_contact, first_watched, first_x = -1, 0, inf
    for i in range(c.size):
        contact = c[i]
        for watched in range(2):
            sign = WATCHED[contact.phase, watched]
            if sign == 0:
                continue
            series = contact.forces if watched == GraphWatched.FORCE else contact.rates
            x = first_root(series, sign, sign * series[0], ORDER, min(first_x, 1.0))
            if x < first_x:
                first_contact, first_watched, first_x = i, watched, x
    return GraphEvent(first_contact, first_watched, first_x)
