"""Types that cross the boundary of the kernel of graphs in time: endings, and the record of a result.

Used by `in_time.kernel`, which fills in the records, and by `in_time.following`, which reads them.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class TimedEnding(IntEnum):
    """End of a graph in time; the numbers differ from the numbers of all other kernels."""

    UNFINISHED = 300  # given up after too many windows
    FREE = 301  # no contact carries force, and no gap closes
    GAINED_ENERGY = 302  # like FREE, but rounding has made energy
    SEARCH_FAILED = 303  # given up: the first event of a window could not be found
    HELD = 304  # given up: rigid contacts hold the active contacts at rest
    PULLED_OPEN = 305  # given up: a rigid contact was pulled open


#: Result of one graph, in its units.
TIMED_RESULT = np.dtype(
    [
        ("ending", "i8"),  # one of `TimedEnding`
        ("runaway", "?"),  # closed form: a contact whose stiffness runs away became rigid
        ("collapse", "?"),  # closed form: bodies came to rest together after infinitely many events
        ("n_events", "i8"),
        ("n_windows", "i8"),
        # Under bistiffness: kinetic energy that went into contacts, less the strain energy that was lost there, over
        # the energy of impact. It differs from 0 by rounding only.
        ("energy_residual", "f8"),
        ("time", "f8"),  # duration from first touch to the end
    ],
    align=True,
)
