"""Types that cross the boundary of the kernel of graphs: endings, inputs, and the records of events and results.

Used by `graph.kernel`, which fills in the records, and by `graph.solving`, which reads them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class GraphEnding(IntEnum):
    """End of a graph.

    No number is used in `chain.record.ChainEnding` or `pair.record.PairEnding`, so that the codes of different kernels
    cannot be mixed up.
    """

    UNFINISHED = 200  # given up after too many windows
    FREE = 201  # no contact is active, and no bodies approach
    GAINED_ENERGY = 202  # like FREE, but rounding has made energy
    SEARCH_FAILED = 203  # given up: the first event of a window could not be found
    RIGID_UNDECIDED = 204  # given up: it could not be decided which of several rigid contacts press


class EventKind(IntEnum):
    """Kind of an event; `graph.law` explains the words."""

    START = 0  # first touch
    END_OF_COMPRESSION = 1
    RESTART = 2
    END_OF_RESTITUTION = 3
    RETURN = 4
    LOADED = 5  # a contact at rest is pressed from here on; or a rigid contact begins or ceases to be pressed
    COLLAPSE = 6  # all contacts that are still active come to rest


class Graphs(NamedTuple):
    """Graphs of one number of contacts C, in units of about 1."""

    #: Delassus matrices, shape (n, C, C).
    delassus: NDArray[np.float64]
    #: Arrays of shape (n, C); rates of compression hold at first touch.
    stiffnesses: NDArray[np.float64]
    restitutions: NDArray[np.float64]
    rates: NDArray[np.float64]
    #: Kinetic energies that the contacts can take up: w W^+ w/2 at first touch, with the pseudoinverse W^+; shape (n,).
    energies: NDArray[np.float64]

    def take(self, rows: slice) -> Graphs:
        """Return the graphs of a slice."""
        return Graphs(*(values[rows] for values in self))


class GraphEnds(NamedTuple):
    """Results that the kernel fills in, one row per graph, in the units of `Graphs`."""

    #: Total impulses and final rates of compression, shape (n, C).
    impulses: NDArray[np.float64]
    rates: NDArray[np.float64]
    #: Records of `GRAPH_RESULT`, shape (n,).
    results: NDArray[np.void]


#: An event. The first row of a graph is its first touch. Rows of one instant may follow one another.
EVENT = np.dtype(
    [
        ("time", "f8"),  # time since first touch, in units of the graph
        ("kind", "i8"),  # one of `EventKind`
        ("contact", "i8"),  # number of the contact, from 0; -1 for an event without a single contact
        ("active", "u8"),  # set of contacts that are active from here on; bit i stands for contact i
    ],
    align=True,
)

#: Largest number of contacts of a graph: a set of active contacts has one bit for each contact.
MOST_CONTACTS = 60

#: Result of one graph, in its units. `energy_residual` is the kinetic energy that went into contacts, less the strain
#: energy that was lost there, over the energy of impact; it differs from 0 by rounding only.
GRAPH_RESULT = np.dtype(
    [
        ("ending", "i8"),  # one of `GraphEnding`
        ("plastic", "?"),  # closed form: a contact with e = 0 ended compression
        ("runaway", "?"),  # closed form: a contact whose stiffness runs away became rigid
        ("collapse", "?"),  # closed form: bodies came to rest together after infinitely many events
        ("n_events", "i8"),  # number of events of single contacts, and of collapses
        ("n_windows", "i8"),
        ("n_rows", "i8"),  # number of rows in the log of events
        ("margin", "f8"),  # grazing margin (`graph.grazing`)
        ("energy_residual", "f8"),  # residual of the energy balance of contacts, over the energy of impact
        ("time", "f8"),  # duration from first touch to the end
    ],
    align=True,
)
