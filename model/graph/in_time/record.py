"""Types that the compiled kernel of `graph.in_time` shares with Python: endings, and the record of a result.

Used by `in_time.kernel`, which fills in the records, and by `in_time.following`, which reads them.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class TimedEnding(IntEnum):
    """Ways in which the kernel's computation of a graph can end.

    The values differ from the endings of all other kernels.
    """

    UNFINISHED = 300  # given up: the collision is not over after the largest number of windows
    FREE = 301  # the collision is over: no contact carries force, and no gap closes
    GAINED_ENERGY = 302  # the collision is over, but rounding has made energy
    SEARCH_FAILED = 303  # given up: the search for the next event failed
    HELD = 304  # given up: rigid contacts keep the active contacts at rest, so the bodies are jammed
    PULLED_OPEN = 305  # given up: a neighbouring contact pulled a rigid contact open


#: Record of the result of one graph, in the scaled units of `graph.record.Graphs`.
TIMED_RESULT = np.dtype(
    [
        ("ending", "i8"),  # one of `TimedEnding`
        (
            "runaway",
            "?",
        ),  # whether a contact became rigid: its stiffness would grow without bound in a finite time
        ("collapse", "?"),  # whether bodies came to rest together, as the limit of infinitely many events
        ("n_events", "i8"),  # number of events
        (
            "n_windows",
            "i8",
        ),  # number of windows, the times over which a power series was summed, and of flights
        # Check of the result for bistiffness: the kinetic energy that went into contacts, minus the strain energy that
        # was lost there, divided by the energy of impact. Only rounding makes it differ from 0.
        ("energy_residual", "f8"),
        ("time", "f8"),  # duration of the collision, from first touch to its end
    ],
    align=True,
)
