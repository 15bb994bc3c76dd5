"""State sequences of engines and exact solvers, made comparable by a filter in time.

A state is the set of active contacts; bit i stands for contact i + 1. For two balls on a table, S1 is both contacts, S2
ball-table only, S3 ball-ball only, S4 none. An engine sees a state only if the state lasts for a step; an exact solver
sees every state, however short. So whenever paths are compared, the states of every solver go through the same three
rules:

1. A contact that is closed at the start counts as active from the start on, not only from its first force on. In the
   model all contacts are active from the start, with no force; in an engine a contact becomes visible only after its
   penetration has grown.
2. A state that is held for less than a stated time is replaced by the state before it; equal neighbours then join.
   There is one pass, in the order of time.
3. The sequence ends in the empty set, the state of a collision that is over. It ends so even if B2 rests on the table
   by its weight. The empty set can also occur earlier: all contacts are open, but some will close again.

**The time** of rule 2 is a fraction of the shorter contact period (`engines.scene.periods`), whatever the step. The
default fraction, `SHORTEST_STATE`, is two and a half of the default steps. So a state of three steps counts and a state
of two does not, and rounding decides nothing. If the step is longer than this time, an engine misses states that count,
and no filter can detect this.

**Closed forms.** If a contact is rigid, the time of rule 2 is 0, and nothing is merged. A segment that takes no time in
a closed form counts as short. A segment without end counts as held, and so does every segment after it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.path import Paths
from impact_xval.model.states import States, name_of_set

#: Times, as numbers of steps or in seconds.
Times = NDArray[np.int64 | np.float64]

#: Default fraction of the shorter contact period for which a state must be held to count; see the module.
SHORTEST_STATE = 2.5e-3

#: Fraction of the time of rule 2 by which a state may fall short and still count: rounding, if steps divide this time
#: exactly.
_ROUNDING = 1e-9

#: Sets of contacts of two balls on a table: both contacts, and each contact alone.
_BOTH_CONTACTS, _EACH_CONTACT = 0b11, 1 << np.arange(2)


class Runs(NamedTuple):
    """A sequence of runs; a run is a state with the time for which it is held. Times are in steps or in s."""

    #: Time at which each run begins; 0 for the first run.
    start: Times
    #: State of each run: a set of contacts, as bits.
    state: NDArray[np.int64]
    #: Time at which the last run ends.
    end: float

    def names(self, paper: bool) -> tuple[str, ...]:
        """Return the names of states for an outcome, ended by rule 3: the paper's names, or sets of contacts."""
        sets: list[int] = self.state.tolist()
        if not sets or sets[-1] != 0:
            sets.append(0)
        return tuple(name_of_set(contacts, paper) for contacts in sets)


class ManyRuns(NamedTuple):
    """The runs of many sequences, one sequence after the other; arrays with one element for each run."""

    #: Index of the sequence to which a run belongs, ascending.
    sequence: NDArray[np.intp]
    #: Time at which each run begins, and its state: a set of contacts, as bits.
    start: Times
    state: NDArray[np.int64]

    def take(self, kept: NDArray[np.bool_]) -> ManyRuns:
        """Return the runs that are kept."""
        return ManyRuns(self.sequence[kept], self.start[kept], self.state[kept])

    def is_first(self) -> NDArray[np.bool_]:
        """Return the mask of runs that are the first of their sequence."""
        return np.diff(self.sequence, prepend=-1) != 0

    def join_equal(self) -> ManyRuns:
        """Join equal neighbours of one sequence."""
        return self.take(self.is_first() | (np.diff(self.state, prepend=-1) != 0))

    def held_for(self, ends: Times) -> Times:
        """Return the time for which each run is held; `ends` are the times at which the sequences end."""
        until = np.append(self.start[1:], 0)
        is_last = np.diff(self.sequence, append=len(ends)) != 0
        until[is_last] = ends[self.sequence[is_last]]
        with np.errstate(invalid="ignore"):  # infinity minus infinity: such a run counts as held
            return until - self.start


def merge_runs(raw: Runs, shortest: float, closed: int) -> Runs:
    """Return the runs that remain of raw runs under rules 1 and 2 of the module.

    A state must be held for the time `shortest` to count, in the unit of the runs. `closed` are the contacts that are
    closed at the start, as bits.
    """
    sequence = np.zeros(len(raw.start), np.intp)
    merged = merge_many(
        ManyRuns(sequence, raw.start, raw.state), np.array([raw.end]), np.array([shortest]), closed
    )
    return Runs(merged.start, merged.state, raw.end)


def merge_many(raw: ManyRuns, ends: Times, shortest: NDArray[np.float64], closed: int) -> ManyRuns:
    """Return the runs that remain of the raw runs of many sequences under rules 1 and 2 of the module.

    For each sequence, `ends` is the time at which its last run ends, and `shortest` is the time for which a state must
    be held to count; both have shape (n,). `closed` are the contacts that are closed at the start, as bits.
    """
    # Runs of no length are dropped, and their neighbours are joined if equal. So the result does not depend on the way
    # in which a path is stored.
    runs = raw.take((raw.held_for(ends) != 0) | raw.is_first())
    runs = _count_closed_contacts(runs, len(ends), closed)
    # Runs that rule 1 has made equal join before rule 2 looks at their lengths.
    runs = runs.join_equal()
    long_enough = ~(runs.held_for(ends) < shortest[runs.sequence] * (1 - _ROUNDING))
    runs = runs.take(long_enough)
    # The closed contacts are the first state, even if no contact ever carries force.
    sequences = np.arange(len(ends))
    first = np.searchsorted(runs.sequence, sequences)
    return ManyRuns(
        np.insert(runs.sequence, first, sequences),
        np.insert(runs.start, first, 0),
        np.insert(runs.state, first, closed),
    ).join_equal()


def _count_closed_contacts(runs: ManyRuns, sequences: int, closed: int) -> ManyRuns:
    """Add each closed contact to the states before it first carries force, if it ever does (rule 1)."""
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
    """Return the state sequences of two balls on a table as texts, comparable with the texts of other solvers.

    A state must be held for the time `shortest` in s to count, shape (n,). Without a path the text is empty.
    """
    states, n_points = paths.active @ _EACH_CONTACT, np.diff(paths.offsets)
    path = np.repeat(np.arange(len(paths)), n_points)
    raw = ManyRuns(path, paths.time, states).join_equal()
    ends, has_path = np.zeros(len(paths)), n_points > 0
    ends[has_path] = paths.time[paths.offsets[1:][has_path] - 1]
    merged = merge_many(raw, ends, shortest, _BOTH_CONTACTS)
    lengths = np.bincount(merged.sequence, minlength=len(paths))
    after = np.cumsum(lengths)
    unclosed = merged.state[after - 1] != 0  # by rule 3
    closed = np.insert(merged.state, after[unclosed], 0).astype(np.uint64)
    texts = States.of(lengths + unclosed, closed[:, np.newaxis]).texts()
    return [text if exists else "" for text, exists in zip(texts, has_path, strict=True)]
