"""Types that the compiled kernel of chains shares with Python: endings, inputs, logs, and the record of a result.

Used by `chain.kernel`, which fills in the results, by `chain.following`, which reads them, and by
`compliant_baselines.references`, which reads how drops ended.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class ChainEnding(IntEnum):
    """Ways in which the kernel's computation of a chain can end.

    `following.Problem.outcomes` translates the endings without a result into a status and a sentence. Its callers do
    this for `UNFINISHED`. The values differ from all values of `pair.record.PairEnding`. So an ending of one kernel
    cannot be taken for an ending of the other.
    """

    UNFINISHED = 0  # not over yet; or given up after too many windows, or because an event could not be found
    FREE = 1  # no bodies touch or approach; in a drop, both balls have left the table
    LOWER_SETTLED = 2  # end of a drop: B1 has left B2, and B2 rests on the table
    BOTH_SETTLED = 3  # end of a drop: B1 rests on B2, and B2 on the table
    GAINED_ENERGY = 4  # the collision is over, but rounding has made energy
    SKIPPED = 5  # the chain was not followed: it was excluded from the computation


class Chains(NamedTuple):
    """Input of the kernel: n chains with N balls each, scaled so that all values are about 1.

    The number C of contacts is N - 1, or N on a table.
    """

    #: Masses, shape (n, N). NaN as the first mass of a chain tells the kernel not to follow this chain.
    masses: NDArray[np.float64]
    #: Stiffnesses, coefficients of restitution, dampings, and the rates of compression and gaps at first touch; each of
    #: shape (n, C).
    stiffnesses: NDArray[np.float64]
    restitutions: NDArray[np.float64]
    dampings: NDArray[np.float64]
    rates: NDArray[np.float64]
    gaps: NDArray[np.float64]
    #: Velocity of the centre of mass, shape (n,); 0 on a table.
    drifts: NDArray[np.float64]
    #: Gravity, shape (n,); above 0 only for drops of two balls.
    gravities: NDArray[np.float64]
    #: Number of points to log in each window, shape (n,).
    points: NDArray[np.int64]

    def take(self, rows: slice) -> Chains:
        """Return the chains in the given rows of all arrays."""
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
    """Accuracy of the kernel of chains, and limit of its work."""

    #: Largest error of a step of integration, for laws whose motion is integrated in steps.
    tolerance: float
    #: Largest number of windows of a chain; a chain that needs more is given up. `kernel.MOST_WORK` is a further limit.
    max_windows: int


class ChainLogs(NamedTuple):
    """Logs that the kernel fills in for one chain after another. Rows beyond the size of a log are dropped."""

    #: Motion in time, shape (rows, 1 + 2 N + C). A row holds the time, the velocities of the balls, their
    #: accelerations, and for each contact 1 if it is active, else 0.
    path: NDArray[np.float64]
    #: Sets of active contacts, shape (entries, words); bit i % 64 of word i//64 stands for contact i. All bits are 0
    #: before the call. The first set of a chain is the set at first touch. The last set is empty, unless the chain was
    #: given up. Sets of no duration are left out.
    sets: NDArray[np.uint64]


class Setup(NamedTuple):
    """Constants of the collision of one chain."""

    #: Energy of impact: kinetic energy at first touch, relative to the centre of mass or the table.
    energy: float
    drift: float
    gravity: float
    points: int


#: Record of the result of one chain, in the scaled units of `Chains`. Energies are relative to the centre of mass or
#: the table. `energy_share` checks the result: without gravity, and with laws without dashpots, only rounding makes it
#: differ from 1.
RESULT = np.dtype(
    [
        ("ending", "i8"),  # one of `ChainEnding`
        (
            "plastic",
            "?",
        ),  # whether a contact with restitution 0 ended compression, and a closed form was used for it
        (
            "runaway",
            "?",
        ),  # whether a contact became rigid: its stiffness would grow without bound in a finite time
        ("collapse", "?"),  # whether bodies came to rest together, as the limit of infinitely many events
        ("n_events", "i8"),  # number of events
        ("n_windows", "i8"),  # number of windows, in each of which the first event was searched
        ("n_points", "i8"),  # number of rows in the log of the motion
        ("n_states", "i8"),  # number of entries in the log of sets of active contacts
        ("margin", "f8"),  # grazing margin (`chain.grazing`); infinite under laws with dashpots
        ("energy_share", "f8"),  # sum of lost and remaining energy, divided by the energy of impact
        ("time", "f8"),  # duration of the collision, from first touch to its end
        ("fall", "f8"),  # time at which the first flight of a drop begins; equal to `time` without a flight
    ],
    align=True,
)
