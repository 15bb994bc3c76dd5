"""State sequences of solvers, engines and exact ones alike, made comparable: one filter, in time.

A state is the set of contacts that carry force, bit i for contact i + 1: of two balls on a table S1 both, S2 ball-table
only, S3 ball-ball only, S4 none. An engine sees a state only if it lasts for a step, an exact solver however short it
is. So whenever paths are compared, every solver's goes through the same three rules:

1. Until a contact that is closed at the start has first carried force it counts as if it did: in the model all are
   active from the start, with no force, while in an engine a contact shows only once its penetration has grown.
2. A state held for less than a stated time takes the state of the run before it; equal neighbours then join. One
   pass, in the order of time.
3. The sequence ends in the empty set, the state of a collision that is over, also where B2 rests on the table by its
   weight. It can occur on the way as well: all contacts open, the balls not yet apart for good.

**The time** of rule 2 is a share of the shorter contact period (`engines.scene.periods`), whatever the step. The
default share, `SHORTEST_STATE`, is two and a half of the default steps: three steps count and two do not, and rounding
decides nothing. At a step above that time an engine misses states that count: no filter can tell.

**Limits.** The time of a rigid contact is 0, and nothing is merged. A segment that takes no time in a closed form is
short; one that has no end, or begins after one that had none, counts as held.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.path import Paths
from impact_xval.model.states import States, name_of_set

#: Default share of the shorter contact period for which a state must be held to count; see the module.
SHORTEST_STATE = 2.5e-3

#: Share of the time of rule 2 by which a run may fall short of it: rounding, where a step divides it exactly.
_ROUNDING = 1e-9


class Runs(NamedTuple):
    """A sequence of states held for some time each: times are numbers of steps, or in s."""

    #: When each run begins; the first at 0.
    start: NDArray[Any]
    #: Sets of contacts, as bits.
    state: NDArray[np.int64]
    #: When the last one ends.
    end: float

    def names(self, paper: bool) -> tuple[str, ...]:
        """Name the sequence as an outcome lists it, by the paper's names or as sets of contacts; closed by rule 3."""
        sets = self.state.tolist()
        return tuple(name_of_set(each, paper) for each in (sets if sets and sets[-1] == 0 else [*sets, 0]))


def merge_runs(raw: Runs, shortest: float, closed: int) -> Runs:
    """Read the state sequence off raw runs, by rules 1 and 2 of the module.

    The shortest time for which a state must be held to count is in the unit of the runs; the contacts that are closed
    at the start are bits.
    """
    lengths, ends = np.array([len(raw.start)]), np.array([raw.end])
    _, start, state = merge_all(lengths, raw.start, raw.state, ends, np.array([shortest]), closed)
    return Runs(start, state, raw.end)


def merge_all(
    lengths: NDArray[np.int64],
    start: NDArray[Any],
    state: NDArray[np.int64],
    ends: NDArray[Any],
    shortest: NDArray[np.float64],
    closed: int,
) -> tuple[NDArray[np.int64], NDArray[Any], NDArray[np.int64]]:
    """Read many state sequences off raw runs, as `merge_runs` does one.

    Of each sequence there are the number of its runs, when the last one ends, and the shortest time, shape (n,); starts
    and states, as of `Runs`, are those of one sequence after the other. Gives lengths, starts and states.
    """
    n, of = len(lengths), np.repeat(np.arange(len(lengths)), lengths)

    def held_for(start: NDArray[Any], of: NDArray[np.int64]) -> NDArray[Any]:
        """How long each run is held."""
        until, last = np.append(start[1:], 0), np.diff(of, append=n) != 0
        until[last] = ends[of[last]]
        with np.errstate(invalid="ignore"):  # infinity less infinity: a run without a length counts as held
            return until - start

    def joined(*runs: NDArray[Any]) -> list[NDArray[Any]]:
        """Join equal neighbours."""
        of, _, state = runs
        new = (np.diff(of, prepend=-1) != 0) | (np.diff(state, prepend=-1) != 0)
        return [each[new] for each in runs]

    # A run without a length is none, and what it parts is one: how a path is written down decides nothing.
    kept = (held_for(start, of) != 0) | (np.diff(of, prepend=-1) != 0)
    of, start, state = of[kept], start[kept], state[kept].copy()
    place, begins = np.arange(len(of)), np.searchsorted(of, np.arange(n))
    for bit in (1 << i for i in range(int(closed).bit_length()) if closed >> i & 1):
        acts = state & bit != 0
        acted = np.maximum.accumulate(np.where(acts, place, -1)) >= begins[of]
        state[~acted & (np.bincount(of[acts], minlength=n) > 0)[of]] |= bit
    # Runs made equal by rule 1 join before their length is judged.
    of, start, state = joined(of, start, state)
    kept = ~(held_for(start, of) < shortest[of] * (1 - _ROUNDING))
    of, start, state = of[kept], start[kept], state[kept]
    # The contacts that are closed stand at the start, whatever became of a collision without any force.
    at = np.searchsorted(of, np.arange(n))
    of, start, state = joined(
        np.insert(of, at, np.arange(n)), np.insert(start, at, 0), np.insert(state, at, closed)
    )
    return np.bincount(of, minlength=n), start, state


def compared_states(paths: Paths, shortest: NDArray[np.float64]) -> list[str]:
    """Give the state sequences of two balls on a table as they are compared with others', each as a text.

    The shortest time for which a state must be held to count is in s. Without a path the text is empty.
    """
    sets, lengths = paths.acting @ (1 << np.arange(2)), np.diff(paths.offsets)
    of = np.repeat(np.arange(len(paths)), lengths)
    first = (np.diff(of, prepend=-1) != 0) | (np.diff(sets, prepend=-1) != 0)
    ends = np.zeros(len(paths))
    ends[lengths > 0] = paths.time[paths.offsets[1:][lengths > 0] - 1]
    runs = np.bincount(of[first], minlength=len(paths))
    lengths, _, state = merge_all(runs, paths.time[first], sets[first], ends, shortest, 0b11)
    after = np.cumsum(lengths)
    unclosed = state[after - 1] != 0  # by rule 3
    closed = np.insert(state, after[unclosed], 0).astype(np.uint64)
    states = States.of(lengths + unclosed, closed[:, np.newaxis])
    return [text if there else "" for text, there in zip(states.texts(), runs, strict=True)]
