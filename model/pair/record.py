"""Types that the kernel of two balls shares with Python: states, endings, ratios, options, logs, and results.

Used by `pair.kernel`, which fills in the results, and by `pair.following` and `model.solving`, which read them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class State(IntEnum):
    """State of two balls on a table, by the set of active contacts.

    Contact 1 is between the balls, and contact 2 is between ball 2 and the table.
    """

    S1 = 1  # both contacts are active
    S2 = 2  # only contact 2 is active
    S3 = 3  # only contact 1 is active
    S4 = 4  # no contact is active: the collision is over


class PairEnding(IntEnum):
    """Ways in which the kernel's computation of a collision of two balls can end.

    The values differ from all values of `chain.record.ChainEnding`. So an ending of one kernel cannot be taken for an
    ending of the other.
    """

    FINISHED = 100  # the collision was followed to its end, the state S4
    CLOSED_FORM = 101  # the closed form of a limiting case was used
    PRECISION = 102  # the closed form was used, because the ratio of stiffnesses exceeded double precision
    COLLAPSED = 103  # the bodies came to rest together, as the limit of infinitely many events
    TOO_MANY_EVENTS = 104  # given up after too many events
    UNREPRESENTABLE = 105  # not followed: m2/m1 or m1/m2 exceeds `MASS_PRECISION`


class PairRatios(NamedTuple):
    """Ratios on which collisions of two balls on a table depend (Theorem 5); each an array of shape (n,)."""

    #: Stiffness ratio k2/k1, from 0 to infinity.
    kappa: NDArray[np.float64]
    #: Mass ratio m2/m1.
    mu: NDArray[np.float64]
    #: Coefficients of restitution of contacts 1 and 2.
    e1: NDArray[np.float64]
    e2: NDArray[np.float64]

    def take(self, rows: NDArray[np.int64] | slice) -> PairRatios:
        """Return the ratios of the collisions in a slice, or in given rows."""
        return PairRatios(self.kappa[rows], self.mu[rows], self.e1[rows], self.e2[rows])


class PairOptions(NamedTuple):
    """Rules and limits of the kernel of two balls."""

    #: A contact is treated as rigid if its running stiffness exceeds this number times the stiffness of the other
    #: contact. `pair.limits.EXACT` means that there is no cut-off.
    cutoff: float
    #: Largest number of events. A collision that needs more is given up.
    max_events: int
    #: Whether a repeated compression begins with the stiffness to which ends of compression have raised it. If not, it
    #: begins with the original stiffness (`pair.law`).
    stiffens: bool
    #: Number of logged points per half period of the fastest oscillation.
    points: int


class PairLogs(NamedTuple):
    """Logs that the kernel fills in for one collision after another. Rows beyond the size of a log are dropped."""

    #: Points of the motion: records of `PATH_POINT`, shape (entries,). If the log has no entries, nothing is logged.
    path: NDArray[np.void]
    #: Sets of active contacts, one set for each state, shape (entries, 1). The lowest bit stands for contact 1. The
    #: last set of a collision is 0.
    sets: NDArray[np.uint64]


#: Record of one point of the motion, in units of m1, k1 and abs(v0).
PATH_POINT = np.dtype(
    [
        ("state", "i8"),  # one of `State`
        ("time", "f8"),  # time since first touch
        ("v1", "f8"),  # velocity of ball 1
        ("v2", "f8"),  # velocity of ball 2
        ("F1", "f8"),  # force of contact 1
        ("F2", "f8"),  # force of contact 2
    ]
)

#: Record of the result of one collision, in units of m1, k1 and abs(v0).
RESULT = np.dtype(
    [
        ("ending", "i8"),  # one of `PairEnding`
        ("n_states", "i8"),  # number of states in time, including S4
        ("n_events", "i8"),  # number of events
        ("n_points", "i8"),  # number of points in the log of the motion
        (
            "margin",
            "f8",
        ),  # grazing margin: how near the collision is to a jump of its outcome (`pair.grazing`)
        ("energy_residual", "f8"),  # energy of impact, which is 1/2, minus the lost and the remaining energy
    ]
)
