"""The status of an outcome, and the endings from which it follows.

`STATUSES` are all statuses, and `RESULT_STATUSES` are the statuses of outcomes with a result. `Ending` is a way in
which collisions may end. `first_endings` returns for each collision the first ending whose condition is true.

Used by `Outcome`, `Outcomes` and solvers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Booleans

Status = Literal["ok", "closed-form", "unconverged", "timeout", "unrepresentable", "unavailable", "crashed"]
STATUSES: tuple[str, ...] = get_args(Status)

#: Statuses of outcomes with a result. An ``unconverged`` outcome may have numbers, but they are no result.
RESULT_STATUSES: tuple[Status, ...] = ("ok", "closed-form")

#: Whether an outcome has a result, by the index of its status.
IS_RESULT = np.array([status in RESULT_STATUSES for status in STATUSES])


class Ending(NamedTuple):
    """A way in which collisions may end, with the status and the sentence that belong to it."""

    #: True for collisions that end in this way; shape (n,) or ().
    condition: Booleans | np.bool_ | bool
    status: Status
    #: One sentence that explains the status.
    reason: str


def first_endings(endings: Sequence[Ending], n: int) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """Return the status and the reason of n collisions, as indices into `STATUSES` and into `reason_texts_of(endings)`.

    A collision gets the status and the reason of the first ending whose condition is true for it. If no condition is
    true, the status is ``ok`` and the reason is empty.
    """
    reason = np.zeros(n, np.int32)
    for index in range(len(endings), 0, -1):
        reason[np.broadcast_to(endings[index - 1].condition, n)] = index
    statuses = [STATUSES.index(status) for status in ("ok", *(ending.status for ending in endings))]
    return np.array(statuses, np.uint8)[reason], reason


def reason_texts_of(endings: Sequence[Ending]) -> tuple[str, ...]:
    """Return the sentences to which the indices of reasons from `first_endings` refer."""
    return ("", *(ending.reason for ending in endings))
