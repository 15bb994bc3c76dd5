"""Types that the compiled kernel of graphs shares with Python: endings, inputs, and the records of events and results.

Used by `graph.kernel`, which fills in the records, and by `graph.solving`, which reads them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class GraphEnding(IntEnum):
    """Ways in which the kernel's computation of a graph can end.

    The values differ from all values of `chain.record.ChainEnding` and `pair.record.PairEnding`. So an ending of one
    kernel cannot be taken for an ending of another.
    """

    UNFINISHED = 200  # given up: the collision is not over after the largest number of windows
    FREE = 201  # the collision is over: no contact is active, and no bodies approach
    GAINED_ENERGY = 202  # the collision is over, but rounding has made energy
    SEARCH_FAILED = 203  # given up: the search for the next event failed
    RIGID_UNDECIDED = 204  # given up: the search for the rigid contacts that press their bodies did not end


class EventKind(IntEnum):
    """Kind of an event of a collision; the table in `graph.law` defines the events of a contact."""

    START = 0  # first touch of the bodies
    END_OF_COMPRESSION = 1
    RESTART = 2
    END_OF_RESTITUTION = 3
    RETURN = 4
    LOADED = 5  # a contact at rest begins to carry force, or a rigid contact begins or ceases to carry force
    COLLAPSE = 6  # all active contacts come to rest together, because hardly any energy is left


class Graphs(NamedTuple):
    """Input of the kernel: n graphs with C contacts each, scaled so that all values are about 1."""

    #: Delassus matrices, shape (n, C, C).
    delassus: NDArray[np.float64]
    #: Stiffnesses, coefficients of restitution, and rates of compression at first touch; each of shape (n, C).
    stiffnesses: NDArray[np.float64]
    restitutions: NDArray[np.float64]
    rates: NDArray[np.float64]
    #: Energies of impact, shape (n,): the kinetic energy w W^+ w/2 that the contacts can take up. w are the rates of
    #: compression at first touch, and W^+ is the pseudoinverse of the Delassus matrix.
    energies: NDArray[np.float64]

    def take(self, rows: slice) -> Graphs:
        """Return the graphs in the given rows of all arrays."""
        return Graphs(*(values[rows] for values in self))


class GraphEnds(NamedTuple):
    """Results that the kernel fills in, one row per graph, in the scaled units of `Graphs`."""

    #: Total impulses, and rates of compression at the end of the collision; each of shape (n, C).
    impulses: NDArray[np.float64]
    rates: NDArray[np.float64]
    #: Records of `GRAPH_RESULT`, shape (n,).
    results: NDArray[np.void]


#: Record of one event in the log of events. The first record of a graph is its first touch. Several records may have
#: the same time.
EVENT = np.dtype(
    [
        ("time", "f8"),  # time since first touch, in the scaled units of `Graphs`
        ("kind", "i8"),  # one of `EventKind`
        (
            "contact",
            "i8",
        ),  # number of the contact, counted from 0; -1 if the event belongs to no single contact
        ("active", "u8"),  # set of contacts that are active after the event; bit i stands for contact i
    ],
    align=True,
)

#: Largest number of contacts of a graph. A set of contacts is stored in 64 bits, with one bit for each contact.
MOST_CONTACTS = 60

#: Record of the result of one graph, in the scaled units of `Graphs`. `energy_residual` checks the result. It is the
#: kinetic energy that went into contacts, minus the strain energy that was lost there, divided by the energy of impact.
#: Only rounding makes it differ from 0.
GRAPH_RESULT = np.dtype(
    [
        ("ending", "i8"),  # one of `GraphEnding`
        (
            "plastic",
            "?",
        ),  # whether a contact with restitution 0 ended compression, and a closed form was used for it
        (
            "runaway",
            "?",
        ),  # whether a contact became rigid: its stiffness would grow without bound in a finite time
        ("collapse", "?"),  # whether bodies came to rest together, as the limit of infinitely many events
        ("n_events", "i8"),  # number of events of single contacts, plus the number of collapses
        ("n_windows", "i8"),  # number of windows, the times over which a power series was summed
        ("n_rows", "i8"),  # number of records in the log of events
        (
            "margin",
            "f8",
        ),  # grazing margin: how near the collision is to a jump of its outcome (`graph.grazing`)
        ("energy_residual", "f8"),  # residual of the energy balance of contacts, over the energy of impact
        ("time", "f8"),  # duration of the collision, from first touch to its end
    ],
    align=True,
)
