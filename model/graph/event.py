"""The certified first event of a window: its contact, its watched function, and its time.

**Certificate.** A watched function is a force F_i or a rate w_i. Over a window it is a polynomial in x = t/h: its power
series up to `ORDER`, whose remainder is below rounding. (`graph.motion` has the proof, which needs no sign of W.)
`chain.roots.first_root` finds the first root of the polynomial on [0, 1], and describes the method. No root, and no
pair of close roots, is stepped over. A function that is 0 when the window begins is first divided by the power of x
with which it begins, so that the event that has just happened is not found again.

**First.** Contacts are searched in their order, each up to the earliest root so far. The event is the earliest root. Of
equal roots, the root of the first contact counts (`graph.law` explains ties).

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
    """First event of a window."""

    #: Contact, -1 for none, and the watched function that is zero at the event, one of `GraphWatched`.
    contact: int
    watched: int
    #: Time of the event over the length of the window; infinite without an event, -1 where the search was given up.
    x: float


@kernel_helper
def first_event(c):
    """Return the first event of a window whose series the contacts hold."""
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
