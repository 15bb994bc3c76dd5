"""What each body is given, so that what an engine combines at each contact is what was asked for.

Engines take coefficients per body and combine those of the two bodies of a contact. In a line that is a chain of
equations, one a contact, with one more unknown than equations: the value of the first body is free, the others follow.
Alternately it bounds them from above and from below. In the middle of what is left of its range, two balls on a table
share a mean so that the lower ball has the smaller of both values; for products the smallest value of the first body is
taken, which leaves 1 to the second: e_1 on the upper ball, 1 on the lower one, e_2 on the table.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby

#: Relative width by which rounding may close the range of the first body.
CLOSED = 1e-12


def means(wanted: Sequence[float], largest: float = math.inf) -> tuple[float, ...] | None:
    """Values from 0 to a largest one, of which those of neighbours have the means that are wanted; None without any.

    Parameters
    ----------
    wanted : sequence of float, one a contact
    largest : float
        Largest legal value of a body.

    Returns
    -------
    tuple of float, one more than contacts
    """
    offsets = [0.0]  # body i has offsets[i] + (-1)^i first
    for mean in wanted:
        offsets.append(2 * mean - offsets[-1])
    bounds = [
        (-offset, largest - offset) if i % 2 == 0 else (offset - largest, offset)
        for i, offset in enumerate(offsets)
    ]
    low, high = max(b[0] for b in bounds), min(b[1] for b in bounds)
    if low > high + CLOSED * max(wanted, default=0.0):
        return None
    first = 0.5 * (low + high)
    return tuple(max(0.0, o + first if i % 2 == 0 else o - first) for i, o in enumerate(offsets))


def factors(wanted: Sequence[float]) -> tuple[float, ...] | None:
    """Values from 0 to 1, of which those of neighbours have the products that are wanted; None without any.

    A body all of whose contacts are perfectly plastic is given 0; one that has another contact cannot be.
    """
    plastic = [all(w == 0 for w in wanted[max(0, i - 1) : i + 1]) for i in range(len(wanted) + 1)]
    found: list[float] = []
    for zero, run in groupby(range(len(plastic)), key=plastic.__getitem__):
        bodies = list(run)
        some = [0.0] * len(bodies) if zero else _positive_factors(wanted[bodies[0] : bodies[-1]])
        if some is None:
            return None
        found += some
    return tuple(found)


def _positive_factors(wanted: Sequence[float]) -> list[float] | None:
    """`factors` of products none of which may be 0."""
    if 0 in wanted:
        return None
    powers = [1.0]  # body i has powers[i] first^((-1)^i)
    for product in wanted:
        powers.append(product / powers[-1])
    first, high = max(powers[1::2]), min(1 / power for power in powers[0::2])
    if first > high * (1 + CLOSED):
        return None
    return [min(1.0, p * first if i % 2 == 0 else p / first) for i, p in enumerate(powers)]
