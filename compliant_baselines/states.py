"""State sequences of engines and exact solvers, filtered so that they can be compared.

A state is the set of contacts that carry force; bit i stands for contact i + 1. For two balls on a table S1 is both
contacts, S2 only ball-table, S3 only ball-ball, and S4 none. An engine shows a state only if the state lasts for a
step. An exact solver shows every state, however short it is. So before paths are compared, the states of every solver
are filtered by the same three rules:

1. A contact that is closed at the start is taken to be active from the start on, not only from its first force on. In
  the
   model all contacts are active from the start, without any force yet. In an engine a contact carries visible force
   only after its penetration has grown.
2. A state that lasts less than a given time is replaced by the state before it. Equal neighbours then become one state.
   This is done once, in the order of time.
3. The sequence ends with the empty set, which stands for the end of the collision. It ends so even if B2 rests on the
   table by its weight. The empty set can also occur earlier: all contacts are open, but some will close again.

**The time** of rule 2 is a fraction of the shorter contact period (`engines.scene.periods`), whatever the step is. The
default fraction, `SHORTEST_STATE`, is two and a half of the default steps. So a state of three steps is kept, and a
state of two steps is not; rounding does not matter. If the step is longer than the time of rule 2, an engine misses
states that would be kept, and no filter can detect this.

**Closed forms.** If a contact is rigid, the time of rule 2 is 0, and no state is replaced. A segment that takes no time
in a closed form is treated as a short state. A segment that never ends is treated as a long state, and so is every
segment after it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.path import Paths
from impact_xval.model.states import States, name_of_set

#: Times, either as numbers of steps or in seconds.
Times = NDArray[np.int64 | np.float64]

#: Default of the shortest duration with which a state is kept, as a fraction of the shorter contact period.
SHORTEST_STATE = 2.5e-3

#: Fraction by which the duration of a state may be below the shortest duration with which a state is kept. It covers
#: rounding where this shortest duration is a whole number of steps.
_ROUNDING = 1e-9

#: Sets of contacts of two balls on a table, as bits: both contacts, and each contact alone.
_BOTH_CONTACTS, _EACH_CONTACT = 0b11, 1 << np.arange(2)


class Runs(NamedTuple):
    """A sequence of states with their times, in steps or in s. A state together with its duration is called a run."""

    #: Time at which each state begins; 0 for the first state.
    start: Times
    #: Each state: a set of contacts, as bits.
    state: NDArray[np.int64]
    #: Time at which the last state ends.
    end: float

    def names(self, paper: bool) -> tuple[str, ...]:
        """Return the names of the states for an outcome, with the empty set at the end (rule 3).

        The names are those of the paper, S1 to S4, if `paper` is true; otherwise they list the contacts.
        """
        sets: list[int] = self.state.tolist()
        if not sets or sets[-1] != 0:
            sets.append(0)
        return tuple(name_of_set(contacts, paper) for contacts in sets)


class ManyRuns(NamedTuple):
    """The states of many sequences, one sequence after the other; arrays with one element for each state."""

    #: Index of the sequence to which a state belongs, ascending.
    sequence: NDArray[np.intp]
    #: Time at which each state begins, and the state itself: a set of contacts, as bits.
    start: Times
    state: NDArray[np.int64]

    def take(self, kept: NDArray[np.bool_]) -> ManyRuns:
        """Return only the states where the mask is true."""
        return ManyRuns(self.sequence[kept], self.start[kept], self.state[kept])

    def is_first(self) -> NDArray[np.bool_]:
        """Return the mask of states that are the first of their sequence."""
        return np.diff(self.sequence, prepend=-1) != 0

    def join_equal(self) -> ManyRuns:
        """Return the sequences with equal neighbouring states joined."""
        return self.take(self.is_first() | (np.diff(self.state, prepend=-1) != 0))

    def held_for(self, ends: Times) -> Times:
        """Return the duration of each state; `ends` are the times at which the sequences end."""
        until = np.append(self.start[1:], 0)
        is_last = np.diff(self.sequence, append=len(ends)) != 0
        until[is_last] = ends[self.sequence[is_last]]
        with np.errstate(invalid="ignore"):  # infinity minus infinity is NaN: a long state
            return until - self.start


def merge_runs(raw: Runs, shortest: float, closed: int) -> Runs:
    """Return the states that remain under rules 1 and 2 of the module's docstring.

    A state is kept if it lasts at least for the time `shortest`, in the unit of the runs. `closed` are the contacts
    that are closed at the start, as bits.
    """
    sequence = np.zeros(len(raw.start), np.intp)
    merged = merge_many(
        ManyRuns(sequence, raw.start, raw.state), np.array([raw.end]), np.array([shortest]), closed
    )
    return Runs(merged.start, merged.state, raw.end)


def merge_many(raw: ManyRuns, ends: Times, shortest: NDArray[np.float64], closed: int) -> ManyRuns:
    """Return the states of many sequences that remain under rules 1 and 2 of the module's docstring.

    For each sequence, `ends` is the time at which its last state ends, and `shortest` is the shortest duration with
    which a state is kept; both have shape (n,). `closed` are the contacts that are closed at the start, as bits.
    """
    # States without duration are dropped, and equal neighbours are joined. So the result does not depend on the way in
    # which a path is stored.
    runs = raw.take((raw.held_for(ends) != 0) | raw.is_first())
    runs = _count_closed_contacts(runs, len(ends), closed)
    # States that rule 1 has made equal are joined before rule 2 looks at their durations.
    runs = runs.join_equal()
    long_enough = ~(runs.held_for(ends) < shortest[runs.sequence] * (1 - _ROUNDING))
    runs = runs.take(long_enough)
    # The contacts that are closed at the start are the first state, even if none of them ever carries force.
    sequences = np.arange(len(ends))
    first = np.searchsorted(runs.sequence, sequences)
    return ManyRuns(
        np.insert(runs.sequence, first, sequences),
        np.insert(runs.start, first, 0),
        np.insert(runs.state, first, closed),
    ).join_equal()


def _count_closed_contacts(runs: ManyRuns, sequences: int, closed: int) -> ManyRuns:
    """Add each contact that is closed at the start to the states before its first force (rule 1).

    A contact that never has force is not added.
    """
    sequence, state = runs.sequence, runs.state.copy()
    position, first = np.arange(len(sequence)), np.searchsorted(sequence, np.arange(sequences))
    for contact in range(int(closed).bit_length()):
        bit = 1 << contact
        if not closed & bit:
            continue
        active = state & bit != 0
        last_active = np.maximum.accumulate(np.where(active, position, -1))
        has_been_active = last_active >= first[sequence]
        is_ever_active = (np.bincount(sequence[active], minlength=sequences) > 0)[sequence]
        state[~has_been_active & is_ever_active] |= bit
    return runs._replace(state=state)


def comparable_states(paths: Paths, shortest: NDArray[np.float64]) -> list[str]:
    """Return the filtered state sequences of paths of two balls on a table, as texts that can be compared.

    A state is kept if it lasts at least for the time `shortest` in s, shape (n,). Without a path the text is empty.
    """
    states, n_points = paths.active @ _EACH_CONTACT, np.diff(paths.offsets)
    path = np.repeat(np.arange(len(paths)), n_points)
    raw = ManyRuns(path, paths.time, states).join_equal()
    ends, has_path = np.zeros(len(paths)), n_points > 0
    ends[has_path] = paths.time[paths.offsets[1:][has_path] - 1]
    merged = merge_many(raw, ends, shortest, _BOTH_CONTACTS)
    lengths = np.bincount(merged.sequence, minlength=len(paths))
    after = np.cumsum(lengths)
    unclosed = merged.state[after - 1] != 0  # sequences to which rule 3 adds the empty set
    closed = np.insert(merged.state, after[unclosed], 0).astype(np.uint64)
    texts = States.of(lengths + unclosed, closed[:, np.newaxis]).texts()
    return [text if exists else "" for text, exists in zip(texts, has_path, strict=True)]
