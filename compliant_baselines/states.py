"""State sequences of solvers, engines and exact ones alike, made comparable: one filter, in time.

A state is the set of contacts that carry force, bit i for contact i + 1: of two balls on a table S1 both, S2 ball-table
only, S3 ball-ball only, S4 none. An engine sees a state only if it lasts for a step, an exact solver however short it
is. So whenever paths are compared, every solver's goes through the same three rules:

1. Until a contact that is closed at the start has first carried force it counts as if it did: in the model all are
   active from the start, with no force, while in an engine a contact shows only once its penetration has grown.
2. A state held for less than a stated time takes the state of the run before it; equal neighbours then join. One
   pass, in the order of time.
3. The sequence ends in the empty set, the state of a collision that is over, also where B2 rests on the table by its
   weight.

The empty set can occur on the way as well: all contacts open, the balls not yet apart for good.

**The time** of rule 2 is a share of the shorter contact period (`engines.scene.periods`),
whatever the step. At a step h a state held for a time L shows in the whole number of steps below or above L/h. The
default share, `SHORTEST_STATE`, is two and a half of the default steps: three steps count and two do not, rounding
decides nothing, and only a state held for two to three steps can count in one solver and not in another that agrees
with it. Of short states in a row, one below the step may not show at all, and its neighbours then pass for one that
counts. At a step above that time an engine misses states that count, which is its discretisation: no filter can tell.

**Limits.** A rigid contact has no period: the time is then 0, and nothing is merged. A contact without stiffness has
an infinite one, so that the other's is the shorter. A segment that takes no time in a closed form is short; one that
has no end, or begins after one that had none, counts as held.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.collision import Outcome, name_of_set

#: Default share of the shorter contact period for which a state must be held to count; see the module.
SHORTEST_STATE = 2.5e-3

#: Share of the time of rule 2 by which a run may fall short of it: rounding, where a step divides it exactly.
_ROUNDING = 1e-9


class Runs(NamedTuple):
    """A sequence of states held for some time each.

    Attributes
    ----------
    start : ndarray
        When each run begins: the number of its first step, or s. The first is 0.
    state : ndarray of int
        Sets of contacts, as bits.
    end : int or float
        When the last one ends.
    """

    start: NDArray[Any]
    state: NDArray[np.int64]
    end: float

    def names(self, paper: bool) -> tuple[str, ...]:
        """Name the sequence as an outcome lists it, by the paper's names or as sets of contacts; closed by rule 3."""
        sets = self.state.tolist()
        return tuple(name_of_set(each, paper) for each in (sets if sets and sets[-1] == 0 else [*sets, 0]))


def merge_runs(raw: Runs, shortest: float, closed: int) -> Runs:
    """Read the state sequence off raw runs, by rules 1 and 2 of the module.

    Parameters
    ----------
    raw : Runs
        As they were seen.
    shortest : float
        Time for which a state must be held to count, in the unit of `raw`.
    closed : int
        The contacts that are closed at the start, as bits.
    """
    # A run without a length is none, and what it parts is one: how a path is written down decides nothing.
    ends = np.append(raw.start[1:], raw.end)[: len(raw.start)]
    held = (ends != raw.start) | ~np.isfinite(raw.start)
    held[:1] = True
    start, state = raw.start[held], raw.state[held]
    yet_to_act = closed & np.bitwise_or.reduce(state) & ~np.bitwise_or.accumulate(state)
    state = state | yet_to_act
    # Runs made equal by rule 1 join before their length is judged.
    first = _changes(state)
    start, state = start[first], state[first]
    with np.errstate(invalid="ignore"):  # infinity less infinity: a run without a length counts as held
        short = np.append(start[1:], raw.end)[: len(start)] - start < shortest * (1 - _ROUNDING)
    # The contacts that are closed stand at the start, whatever became of a collision without any force.
    start = np.concatenate([np.zeros(1, start.dtype), start[~short]])
    state = np.concatenate([np.full(1, closed), state[~short]])
    first = _changes(state)
    return Runs(start[first], state[first], raw.end)


def _changes(state: NDArray[np.int64]) -> NDArray[np.intp]:
    """Positions of the states that differ from the one before, the first among them."""
    return np.flatnonzero(np.diff(state, prepend=-1))


def compared_states(outcome: Outcome, shortest: float) -> tuple[str, ...]:
    """Give the state sequence of two balls on a table as it is compared with another's.

    Parameters
    ----------
    outcome : Outcome
        Of any solver. Without a path, on which alone the times are, its states stay as they are.
    shortest : float
        Time for which a state must be held to count, in s.
    """
    path = outcome.path
    if path is None or not len(path.time):
        return outcome.states
    sets = path.acting @ (1 << np.arange(path.acting.shape[1]))
    first = _changes(sets)
    return merge_runs(Runs(path.time[first], sets[first], float(path.time[-1])), shortest, 0b11).names(True)
