"""Types that cross the boundary of the kernel of two balls: states, endings, ratios, options, logs, and results.

Used by `pair.kernel`, which fills in the results, and by `pair.following` and `model.solving`, which read them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class State(IntEnum):
    """State of the diagram, by the contacts that are active; contact 1 is ball-ball, contact 2 ball-table."""

    S1 = 1  # both contacts
    S2 = 2  # contact 2
    S3 = 3  # contact 1
    S4 = 4  # no contact: the end


class PairEnding(IntEnum):
    """End of a collision in the kernel of two balls.

    No number is used in `chain.record.ChainEnding`, so that the codes of two kernels cannot be mixed up.
    """

    FINISHED = 100  # the collision was followed to S4
    CLOSED_FORM = 101  # finished by the closed form of a limiting case
    PRECISION = 102  # finished like CLOSED_FORM, because the running stiffness ratio left double precision
    COLLAPSED = 103  # the bodies came to rest together after infinitely many events
    TOO_MANY_EVENTS = 104  # given up after too many events
    UNREPRESENTABLE = 105  # not followed: m2/m1 lies beyond `MASS_PRECISION`


class PairRatios(NamedTuple):
    """Ratios that decide a collision of two balls on a table (Theorem 5), dimensionless; arrays of shape (n,)."""

    #: k2/k1, from 0 to infinity.
    kappa: NDArray[np.float64]
    #: m2/m1.
    mu: NDArray[np.float64]
    #: Coefficients of restitution.
    e1: NDArray[np.float64]
    e2: NDArray[np.float64]

    def take(self, rows: NDArray[np.int64] | slice) -> PairRatios:
        """Return the ratios of the collisions in a slice, or in given rows."""
        return PairRatios(self.kappa[rows], self.mu[rows], self.e1[rows], self.e2[rows])


class PairOptions(NamedTuple):
    """Rules and limits of the kernel of two balls."""

    #: Running stiffness ratio above which, and below whose inverse, a contact counts as rigid; `pair.limits.EXACT` for
    #: the outcome without a cut-off.
    cutoff: float
    #: Number of events after which a collision is given up.
    max_events: int
    #: Whether a repeated compression keeps the stiffness that the ends of compression left (`pair.law`).
    stiffens: bool
    #: Points of a path per half period of the fastest oscillation of a segment.
    points: int


class PairLogs(NamedTuple):
    """Logs that the kernel of two balls fills for all collisions, one after another, as far as they fit."""

    #: Points of paths, of type `PATH_POINT`, shape (entries,); without entries, paths are not logged.
    path: NDArray[np.void]
    #: Sets of active contacts, one for each state, shape (entries, 1). The lowest bit is contact 1; the last set is 0.
    sets: NDArray[np.uint64]


#: Point of a path, in units of m1, k1 and abs(v0).
PATH_POINT = np.dtype(
    [
        ("state", "i8"),  # one of `State`
        ("time", "f8"),  # time since first touch
        ("v1", "f8"),
        ("v2", "f8"),
        ("F1", "f8"),
        ("F2", "f8"),
    ]
)

#: Result of one collision, in units of m1, k1 and abs(v0).
RESULT = np.dtype(
    [
        ("ending", "i8"),  # one of `PairEnding`
        ("n_states", "i8"),
        ("n_events", "i8"),
        ("n_points", "i8"),  # number of points in the log of paths
        ("margin", "f8"),  # grazing margin (`pair.grazing`)
        ("energy_residual", "f8"),  # the energy of impact, 1/2, less the lost energy and the remaining energy
    ]
)
