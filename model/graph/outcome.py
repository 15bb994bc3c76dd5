"""The model's results for contact graphs: `GraphOutcome` of one graph, and `GraphOutcomes` of many graphs as arrays.

`graph.solving` returns these results, and `graph.collision` adds the velocities of bodies to them.
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

#: Events are listed as simultaneous if their times differ by at most this share of the duration of the collision. In a
#: symmetric graph simultaneous events get slightly different times by rounding.
SAME_INSTANT = 1e-12

#: Words that name the kinds of events.
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
    """One event of a collision of a graph."""

    #: Time since first touch, in s.
    time: float
    kind: EventWord
    #: Number of the contact, counted from 1; 0 if the event belongs to no single contact.
    contact: int
    #: Numbers, counted from 1, of the contacts that are active after the event. Empty if another event follows at the
    #: same time.
    active: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class GraphOutcome:
    """Result of one graph by the model.

    Attributes
    ----------
    impulses : tuple of float, one per contact
        Total impulses along the normals, in N s; NaN if there is no result, for which `status` gives the reason. If the
        Delassus matrix is singular, the final velocities alone would allow different impulses. The stiffnesses then
        determine which impulses the model gives.
    rates : tuple of float, one per contact
        Rates of compression when the collision is over, in m/s: zero or negative.
    states : tuple of str
        The sets of active contacts, in the order of time, such as ``("1+2", "2", "-")``; ``"-"`` is the empty set.
    times : tuple of float
        Time at which each of these sets begins, in s since first touch. The model computes it with the positions of
        first touch throughout.
    status : str
        ``"ok"``, ``"closed-form"`` where a closed form of the model was used, or a status that says why there is no
        result.
    reason : str
        One sentence that explains the status; never empty if there is no result.
    grazing_margin : float
        How near the collision is to a jump of its outcome: the smallest relative size of a rate of compression at a
        turning point. Infinite if no rate had a turning point near zero.
    mark : str
        One sentence that warns of the outcome if the grazing margin is below the threshold, else empty.
    n_events : int
        Number of events of single contacts, plus the number of times at which all active contacts came to rest.
    events : tuple of ContactEvent
        All events in the order of time. The first event is the first touch.
    diagnostics : mapping of str to float
        ``energy_residual``: residual of the energy balance, divided by the energy of impact. ``impulse_residual``:
        largest difference between `rates` and w - W I, with the rates w at first touch, the Delassus matrix W and the
        impulses I; divided by the largest rate at first touch.
    velocities, angular_velocities : tuple
        Velocities of each body when the collision is over, in m/s and rad/s. Empty if only the Delassus matrix was
        given, and not the bodies.
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
        """Whether the impulses and rates are a result of the model."""
        return bool(IS_RESULT[STATUSES.index(self.status)])


@dataclass(frozen=True, slots=True, eq=False)
class GraphOutcomes(Sequence[GraphOutcome]):
    """The model's results for n graphs with C contacts each, as arrays. Item `[i]` is the `GraphOutcome` of graph i.

    Attributes
    ----------
    impulses, rates : ndarray, shape (n, C)
        Total impulses in N s, and final rates of compression in m/s; NaN where there is no result.
    status, reason : ndarray of int, shape (n,)
        Indices: `status` into the tuple `STATUSES`, `reason` into `reason_texts`.
    marked : ndarray of bool, shape (n,)
        True where the grazing margin is below the threshold.
    grazing_margin, duration : ndarray, shape (n,)
        Grazing margins, and durations of the collisions in s.
    n_events, n_windows : ndarray of int, shape (n,)
        Numbers of events, and numbers of windows, the times over which a power series was used.
    events : recarray of `graph.record.EVENT` or None
        All events, one graph after another, with times in s; None if events were not recorded. The events of graph i
        are `events[offsets[i] : offsets[i + 1]]`.
    offsets : ndarray of int, shape (n + 1,)
        Indices into `events` at which the events of each graph begin and end.
    diagnostics : dict of str to ndarray, shape (n,)
        Residuals of the solution, by the names that `GraphOutcome` explains.
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
        """Status of each graph as a text, such as 'ok'; shape (n,)."""
        return np.array(STATUSES)[self.status]

    @property
    def reasons(self) -> NDArray[np.object_]:
        """Sentence that explains the status of each graph, or an empty text; shape (n,)."""
        return np.array(self.reason_texts, dtype=object)[self.reason]

    @property
    def has_result(self) -> Booleans:
        """True for each graph whose impulses and rates are a result of the model; shape (n,)."""
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
        """Return the events of graph i; empty if events were not recorded."""
        if self.events is None:
            return ()
        rows = self.events[self.offsets[i] : self.offsets[i + 1]]
        return tuple(
            ContactEvent(time, EVENT_WORDS[EventKind(kind)], contact + 1, _contacts_of(active))
            for time, kind, contact, active in rows.tolist()
        )


def _contacts_of(bits: int) -> tuple[int, ...]:
    """Return the numbers, counted from 1, of the contacts whose bits are set."""
    return tuple(i + 1 for i in range(bits.bit_length()) if bits >> i & 1)


def _sets_in_time(events: Sequence[ContactEvent]) -> list[tuple[float, str]]:
    """Return the successive sets of active contacts, each as its time of beginning and its name.

    Sets between simultaneous events are left out.
    """
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
