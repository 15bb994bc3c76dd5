"""Types that cross the boundary of the kernel of chains: endings, inputs, logs, and the record of a result.

Used by `chain.kernel`, which fills in the results, by `chain.following`, which reads them, and by
`compliant_baselines.references`, which reads how drops ended.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class ChainEnding(IntEnum):
    """End of a chain.

    `following.Problem.outcomes` writes the status and the reason of a chain without a result; for `UNFINISHED` its
    callers do. No number is used in `pair.record.PairEnding`, so that the codes of two kernels cannot be mixed up.
    """

    UNFINISHED = 0  # not over yet, or given up: after too many windows, or where an event cannot be found
    FREE = 1  # no bodies touch or approach any more; in a drop, both balls have left the table
    LOWER_SETTLED = 2  # end of a drop: B1 left B2, which is settled on the table
    BOTH_SETTLED = 3  # end of a drop: B1 settled on B2
    GAINED_ENERGY = 4  # like FREE, but rounding has made energy
    SKIPPED = 5  # the chain was not followed


class Chains(NamedTuple):
    """Chains of one number of balls, in units of about 1. C is N - 1, or N on a table."""

    #: Shape (n, N); a first mass of NaN marks a chain that is skipped.
    masses: NDArray[np.float64]
    #: Arrays of shape (n, C); rates of compression and gaps hold at first touch.
    stiffnesses: NDArray[np.float64]
    restitutions: NDArray[np.float64]
    dampings: NDArray[np.float64]
    rates: NDArray[np.float64]
    gaps: NDArray[np.float64]
    #: Velocity of the centre of mass, shape (n,); 0 on a table.
    drifts: NDArray[np.float64]
    #: Shape (n,); above 0 for drops of two balls only.
    gravities: NDArray[np.float64]
    #: Points of the path for each window, shape (n,).
    points: NDArray[np.int64]

    def take(self, rows: slice) -> Chains:
        """Return the chains of a slice."""
        return Chains(
            masses=self.masses[rows],
            stiffnesses=self.stiffnesses[rows],
            restitutions=self.restitutions[rows],
            dampings=self.dampings[rows],
            rates=self.rates[rows],
            gaps=self.gaps[rows],
            drifts=self.drifts[rows],
            gravities=self.gravities[rows],
            points=self.points[rows],
        )


class ChainOptions(NamedTuple):
    """Accuracy and limit of the kernel of chains."""

    #: Error of a step, where steps are taken.
    tolerance: float
    #: Windows after which a chain is given up; `kernel.MOST_WORK` is a further limit.
    max_windows: int


class ChainLogs(NamedTuple):
    """Logs that the kernel of chains fills for all chains, one after another, as far as they fit."""

    #: Points of paths, shape (rows, 1 + 2 N + C): time, velocities, accelerations of balls, 1 for each active contact.
    path: NDArray[np.float64]
    #: Sets of active contacts, shape (entries, words); bit i % 64 of word i//64 stands for contact i. All bits are 0
    #: before the call. The first set of a chain holds at first touch; the last set is empty, unless the chain is given
    #: up. Sets that last no time are left out.
    sets: NDArray[np.uint64]


class Setup(NamedTuple):
    """Numbers of one chain that stay the same throughout the collision."""

    #: Energy of impact, relative to the centre of mass or the table.
    energy: float
    drift: float
    gravity: float
    points: int


#: Result of one chain, in units of the chain. Energies are relative to the centre of mass or the table. Under laws
#: without dashpots and without gravity, `energy_share` differs from 1 by rounding only.
RESULT = np.dtype(
    [
        ("ending", "i8"),  # one of `ChainEnding`
        ("plastic", "?"),  # closed form: a contact with e = 0 ended compression
        ("runaway", "?"),  # closed form: a contact whose stiffness runs away became rigid
        ("collapse", "?"),  # closed form: bodies came to rest together after infinitely many events
        ("n_events", "i8"),
        ("n_windows", "i8"),
        ("n_points", "i8"),  # number of rows in the log of paths
        ("n_states", "i8"),  # number of entries in the log of sets
        ("margin", "f8"),  # grazing margin (`chain.grazing`); infinite under laws of dashpots
        ("energy_share", "f8"),  # lost plus remaining energy, over the energy of impact
        ("time", "f8"),  # duration from first touch to the end
        ("fall", "f8"),  # time of the first flight of a drop; equal to `time` without a flight
    ],
    align=True,
)
