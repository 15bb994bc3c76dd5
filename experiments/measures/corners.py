"""The corners between the model and the law of an engine: every combination of three switches (docs/ladder.md).

The switches are positions, law and gravity. All off is the state-transition model, all on the law of the engine in its
scenario. Corners are computed by the references, without a time step, whether or not a run lists them as solvers; the
model's is the run's own row. In an `impact` the corners of the third switch are two and two the same; chains of N
balls know no gravity, and have two switches.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines import references
from impact_xval.compliant_baselines.marks import JUMPS, Law, find_jumps, marks_of
from impact_xval.compliant_baselines.registry import KELVIN_VOIGT
from impact_xval.model.arrays import Floats
from impact_xval.model.chain.following import MAX_WINDOWS
from impact_xval.model.collisions import Collisions
from impact_xval.model.inputs import GRAZING_THRESHOLD
from impact_xval.model.outcomes import Outcomes

Texts = NDArray[np.object_]

#: A corner: the position of each of its switches (positions, law, gravity), 0 if off and 1 if on.
Index = tuple[int, int, int]
#: The corner of the model.
MODEL: Index = (0, 0, 0)

#: Pieces of segments after which a corner of N balls is given up, a second of ten balls.
_MAX_STEPS = 100_000


class Corners(NamedTuple):
    """The corners of n cells of N balls."""

    #: Final velocities by position of each switch, per abs(v0), shape (2, 2, g, n, N); g is 1 for chains. NaN from the
    #: first corner without a result on.
    velocities: Floats
    #: Which corner, beside the model, is the first without a result, and its status; empty where all have one.
    reason: Texts
    #: Which corner jumps beside the cell, or is decided by rounding, so that shares are uncertain; empty where none.
    mark: Texts

    @property
    def model(self) -> Floats:
        """Velocities of the state-transition model, all switches off, shape (n, N)."""
        return self.velocities[MODEL]

    @property
    def engine_law(self) -> Floats:
        """Velocities of the law of the engine in its scenario, all switches on, shape (n, N)."""
        return self.velocities[-1, -1, -1]

    @property
    def gravity(self) -> bool:
        """Whether there is a switch for gravity."""
        return self.velocities.shape[2] > 1


def corner_names(*, gravity: bool = True) -> dict[Index, str]:
    """Return the name of every corner, as in columns of tables, by its switches."""
    weights = ("_weightless", "_scenario") if gravity else ("",)
    names = product(("frozen", "free"), ("energetic", "asked"), weights)
    indices = product((0, 1), (0, 1), range(len(weights)))
    return {index: f"{x}_{law}{weight}" for index, (x, law, weight) in zip(indices, names, strict=True)}


def corners(
    model: Floats, collisions: Collisions, gravity: Floats, obeyed: str = KELVIN_VOIGT, *, pair: bool = True
) -> Corners:
    """Compute the corners of collisions of one number of balls; of a `pair` they may know gravity, in m/s^2.

    `model` are final velocities of the model per abs(v0), shape (n, N); nothing is computed where they are NaN. The
    engine was asked for the law `obeyed`, one of `references.LAWS`.
    """
    velocities = np.full((2, 2, 1 + pair, *model.shape), np.nan)
    velocities[MODEL] = model
    reason, mark = np.full((2, len(model)), "", dtype=object)
    speed = np.abs(collisions.velocities).max(axis=1)
    left = np.flatnonzero(~np.isnan(model).any(axis=1))
    falls = bool(pair and (gravity > 0).any())
    for weight, free, asked in product(range(1 + falls), (1, 0), (0, 1)):
        index = free, asked, weight
        if index == MODEL or not len(left):
            continue
        law = obeyed if asked else "bistiffness"
        remaining, g = collisions[left], gravity[left] * weight
        name = f"{'' if free else 'frozen '}{law}{' with gravity' if weight else ''}"
        solve = references.law_at(law, frozen=not free, max_steps=MAX_WINDOWS if pair else _MAX_STEPS)
        outcomes = solve(remaining, g)
        velocities[index][left] = outcomes.velocities / speed[left, None]
        solved = outcomes.has_result
        reason[left[~solved]] = [f"{name}: {status}" for status in outcomes.statuses[~solved]]
        jumps = _describe_jumps(solve, law, remaining, outcomes, g, pair)
        new = (mark[left] == "") & (jumps != "")  # the first that jumps is told
        mark[left[new]] = f"ladder: {name}" + jumps[new]
        left = left[solved]
    mark[reason != ""] = ""
    if pair and not falls:
        velocities[:, :, 1] = velocities[:, :, 0]
    return Corners(velocities, reason, mark)


def _describe_jumps(
    solve: Law, law: str, collisions: Collisions, outcomes: Outcomes, gravity: Floats, pair: bool
) -> Texts:
    """Say where a corner jumps; for chains, where it grazes or is decided by rounding. Empty elsewhere."""
    if pair:
        excess = find_jumps(solve, collisions, outcomes, gravity).excess
        text = f" jumps where a parameter changes by {max(JUMPS):g} or less"
        return np.where(excess > 1, text, "").astype(object)
    marks, margins = marks_of(solve, law, collisions, outcomes, gravity), outcomes.grazing_margin
    texts = np.array([f": {mark}" if mark else "" for mark in marks], dtype=object)
    grazes = outcomes.has_result & (margins < GRAZING_THRESHOLD)
    texts[grazes] = [f" grazes by {margin:.2g}" for margin in margins[grazes]]
    return texts
