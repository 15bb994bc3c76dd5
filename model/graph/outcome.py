"""The results of graphs: `GraphOutcome` of one graph, `GraphOutcomes` of many as arrays.

Returned by `graph.solving`; `graph.collision` adds velocities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, cast, overload

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Booleans, Floats, Integers, Records
from impact_xval.model.graph.record import EventKind
from impact_xval.model.marks import GRAZING
from impact_xval.model.states import name_of_set
from impact_xval.model.status import IS_RESULT, STATUSES, Status

#: Events count as simultaneous if their times differ by less than this share of the duration. In a symmetric graph
#: rounding alone separates simultaneous events.
SAME_INSTANT = 1e-12

#: Kinds of events in words, by `EventKind`.
EventWord = Literal[
    "start", "end of compression", "restart", "end of restitution", "return", "loaded", "collapse"
]
EVENT_WORDS: Mapping[EventKind, EventWord] = {
    EventKind.START: "start",
    EventKind.END_OF_COMPRESSION: "end of compression",
    EventKind.RESTART: "restart",
    EventKind.END_OF_RESTITUTION: "end of restitution",
    EventKind.RETURN: "return",
    EventKind.LOADED: "loaded",
    EventKind.COLLAPSE: "collapse",
}


class ContactEvent(NamedTuple):
    """One event of a graph."""

    #: Since first touch, in s.
    time: float
    kind: EventWord
    #: Number of the contact, from 1; 0 where no single contact has the event.
    contact: int
    #: Numbers of the contacts that are active from here on, from 1; empty while further events follow at this instant.
    active: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class GraphOutcome:
    """Result of one graph by the model.

    Attributes
    ----------
    impulses : tuple of float, one per contact
        Total impulses along the normals, in N s; NaN only with a status that explains it. Where W is singular,
        velocities do not determine the impulses; the model's stiffnesses do.
    rates : tuple of float, one per contact
        Rates of compression when the collision is over, in m/s: zero or negative.
    states : tuple of str
        The sets of active contacts, in the order of time, such as ``("1+2", "2", "-")``.
    times : tuple of float
        Time at which each of these sets begins, in s since first touch, computed with frozen positions.
    status : str
        As in `Outcome`: ``"ok"``, ``"closed-form"``, or a status that says why there is no result.
    reason : str
        One sentence; not empty where there is no result.
    grazing_margin : float
        As in `Outcome`; infinite if no rate had a turning point next to zero.
    mark : str
        One sentence if the grazing margin is small, else empty.
    n_events : int
        Number of events of single contacts, and of collapses.
    events : tuple of ContactEvent
        All events in the order of time; the first of them is the first touch.
    diagnostics : mapping of str to float
        ``energy_residual``: residual of the energy balance over the energy of impact. ``impulse_residual``: largest
        difference of `rates` from w - W I, over the largest rate at first touch.
    velocities, angular_velocities : tuple
        Velocities of each body when the collision is over, in m/s and rad/s; empty where only W is known.
    """

    impulses: tuple[float, ...]
    rates: tuple[float, ...]
    states: tuple[str, ...]
    times: tuple[float, ...]
    status: Status
    reason: str
    grazing_margin: float
    mark: str
    n_events: int
    events: tuple[ContactEvent, ...]
    diagnostics: Mapping[str, float] = field(default_factory=dict[str, float])
    velocities: tuple[tuple[float, ...], ...] = ()
    angular_velocities: tuple[tuple[float, ...], ...] = ()

    @property
    def has_result(self) -> bool:
        """True where the numbers are a result."""
        return bool(IS_RESULT[STATUSES.index(self.status)])


@dataclass(frozen=True, slots=True, eq=False)
class GraphOutcomes(Sequence[GraphOutcome]):
    """Results of n graphs of C contacts as arrays; `[i]` is a `GraphOutcome`.

    Attributes
    ----------
    impulses, rates : ndarray, shape (n, C)
        In N s and m/s; NaN where there is no result.
    status, reason : ndarray of int, shape (n,)
        Indices into `STATUSES` and `reason_texts`.
    marked : ndarray of bool, shape (n,)
        True where the grazing margin is below the threshold.
    grazing_margin, duration : ndarray, shape (n,)
        Margins, and times of the end in s.
    n_events, n_windows : ndarray of int, shape (n,)
    events : recarray of `graph.record.EVENT` or None
        All events, one graph after another, times in s; None where they were not recorded. Graph i has the rows from
        offsets[i] to offsets[i + 1].
    offsets : ndarray of int, shape (n + 1,)
    diagnostics : dict of str to ndarray, shape (n,)
    """

    impulses: Floats
    rates: Floats
    status: NDArray[np.uint8]
    reason: NDArray[np.int32]
    reason_texts: tuple[str, ...]
    marked: Booleans
    grazing_margin: Floats
    duration: Floats
    n_events: Integers
    n_windows: Integers
    events: Records | None
    offsets: Integers
    diagnostics: dict[str, Floats]

    @property
    def statuses(self) -> NDArray[np.str_]:
        """Statuses as texts."""
        return np.array(STATUSES)[self.status]

    @property
    def reasons(self) -> NDArray[np.object_]:
        """Sentences on statuses."""
        return np.array(self.reason_texts, dtype=object)[self.reason]

    @property
    def has_result(self) -> Booleans:
        """True where the numbers are a result."""
        return IS_RESULT[self.status]

    def __len__(self) -> int:
        return len(self.rates)

    @overload
    def __getitem__(self, index: int) -> GraphOutcome: ...
    @overload
    def __getitem__(self, index: slice) -> list[GraphOutcome]: ...
    def __getitem__(self, index: int | slice) -> GraphOutcome | list[GraphOutcome]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        i = range(len(self))[index]
        events = self._events_of(i)
        sets = _sets_in_time(events)
        return GraphOutcome(
            impulses=tuple(self.impulses[i].tolist()),
            rates=tuple(self.rates[i].tolist()),
            states=tuple(state for _, state in sets),
            times=tuple(time for time, _ in sets),
            status=cast("Status", STATUSES[int(self.status[i])]),
            reason=self.reason_texts[int(self.reason[i])],
            grazing_margin=float(self.grazing_margin[i]),
            mark=GRAZING if self.marked[i] else "",
            n_events=int(self.n_events[i]),
            events=events,
            diagnostics={name: float(values[i]) for name, values in self.diagnostics.items()},
        )

    def _events_of(self, i: int) -> tuple[ContactEvent, ...]:
        """Return the events of one graph."""
        if self.events is None:
            return ()
        rows = self.events[self.offsets[i] : self.offsets[i + 1]]
        return tuple(
            ContactEvent(time, EVENT_WORDS[EventKind(kind)], contact + 1, _contacts_of(active))
            for time, kind, contact, active in rows.tolist()
        )


def _contacts_of(bits: int) -> tuple[int, ...]:
    """Return the numbers of the contacts of a set of bits, from 1."""
    return tuple(i + 1 for i in range(bits.bit_length()) if bits >> i & 1)


def _sets_in_time(events: Sequence[ContactEvent]) -> list[tuple[float, str]]:
    """Return the sets of active contacts that last longer than an instant, each with the time at which it begins."""
    sets: list[tuple[float, str]] = []
    if not events:
        return sets
    instant = SAME_INSTANT * events[-1].time
    for event, following in zip(events, [*events[1:], None], strict=True):
        if following is not None and following.time - event.time <= instant:
            continue
        name = name_of_set(sum(1 << contact - 1 for contact in event.active), False)
        if not sets or sets[-1][1] != name:
            sets.append((event.time, name))
    return sets
