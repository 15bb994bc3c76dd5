"""Corners: exact solutions of a collision for every combination of three switches (docs/ladder.md).

Each switch stands for one difference between the model and the law that an engine was asked for:

* positions: if the switch is off, positions are frozen as in the model; if it is on, the balls move;
* law: if the switch is off, energetic restitution as in the model; if it is on, the law of the engine;
* gravity: if the switch is off, no gravity; if it is on, the gravity of the run's scenario.

The corner with all switches off is the state-transition model. The corner with all switches on is the law of the engine
in the scenario of the run. The caller of `corners` passes the corner of the model. All other corners are computed by
exact solvers, which have no time step. A run need not list these solvers. In the scenario ``impact``, which has no
gravity, the third switch changes nothing. Chains of N balls have no gravity either, so they have only two switches.
`ladder` calls this module.
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

#: Switches of a corner, in the order positions, law, gravity. A switch is 0 if it is off and 1 if it is on.
Index = tuple[int, int, int]
#: Index of the corner of the state-transition model, in which all switches are off.
MODEL: Index = (0, 0, 0)

#: Largest number of steps of an exact solver of N balls. A solution that needs more steps is given up. A step covers a
#: part of the time between two changes of contact. With ten balls this number of steps takes about a second.
_MAX_STEPS = 100_000


class Corners(NamedTuple):
    """Exact solutions of n cells of N balls for every combination of the switches."""

    #: Final velocities per abs(v0), shape (2, 2, g, n, N). The first three indices say which switches are on; g is 1
    #: for chains, which have no gravity. If a corner of a cell has no result, this corner and all later corners of the
    #: cell are NaN.
    velocities: Floats
    #: For each cell, a text with the first corner that has no result, and the status of this corner. The text is empty
    #: where every corner has a result.
    reason: Texts
    #: For each cell, a text with the first corner whose outcome jumps near the cell or is decided by rounding. The
    #: shares of causes are uncertain in such a cell. The text is empty where no corner has such an outcome.
    mark: Texts

    @property
    def model(self) -> Floats:
        """Final velocities per abs(v0) of the state-transition model (all switches off), shape (n, N)."""
        return self.velocities[MODEL]

    @property
    def engine_law(self) -> Floats:
        """Final velocities per abs(v0) by the engine's law in the run's scenario (all switches on), shape (n, N)."""
        return self.velocities[-1, -1, -1]

    @property
    def gravity(self) -> bool:
        """Whether gravity is one of the switches."""
        return self.velocities.shape[2] > 1


def corner_names(*, gravity: bool = True) -> dict[Index, str]:
    """Return the name of every corner by its index; columns of the table ``ladder`` begin with these names."""
    weights = ("_weightless", "_scenario") if gravity else ("",)
    names = product(("frozen", "free"), ("energetic", "asked"), weights)
    indices = product((0, 1), (0, 1), range(len(weights)))
    return {index: f"{x}_{law}{weight}" for index, (x, law, weight) in zip(indices, names, strict=True)}


def corners(
    model: Floats, collisions: Collisions, gravity: Floats, obeyed: str = KELVIN_VOIGT, *, pair: bool = True
) -> Corners:
    """Compute the corners of n collisions, all of N balls.

    Parameters
    ----------
    model : array, shape (n, N)
        Final velocities of the model per abs(v0). No corner is computed for a cell in which they are NaN.
    collisions : Collisions
    gravity : array, shape (n,)
        Gravity in m/s^2. It is used only if `pair` is true.
    obeyed : str
        Law that the engine was asked for, one of `references.LAWS`.
    pair : bool
        Whether the collisions are pairs of balls on a table, which may have gravity.
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
        new = (mark[left] == "") & (jumps != "")  # the mark names only the first corner that jumps
        mark[left[new]] = f"ladder: {name}" + jumps[new]
        left = left[solved]
    mark[reason != ""] = ""
    if pair and not falls:
        velocities[:, :, 1] = velocities[:, :, 0]
    return Corners(velocities, reason, mark)


def _describe_jumps(
    solve: Law, law: str, collisions: Collisions, outcomes: Outcomes, gravity: Floats, pair: bool
) -> Texts:
    """Return, for each collision, a text that says why the outcome of a corner is uncertain.

    The text is empty if the outcome is not uncertain.

    The outcome of a pair is uncertain if it jumps at a small change of a parameter. The outcome of a chain is uncertain
    if a contact grazes, or if rounding decides the outcome.
    """
    if pair:
        excess = find_jumps(solve, collisions, outcomes, gravity).excess
        text = f" jumps where a parameter changes by {max(JUMPS):g} or less"
        return np.where(excess > 1, text, "").astype(object)
    marks, margins = marks_of(solve, law, collisions, outcomes, gravity), outcomes.grazing_margin
    texts = np.array([f": {mark}" if mark else "" for mark in marks], dtype=object)
    grazes = outcomes.has_result & (margins < GRAZING_THRESHOLD)
    texts[grazes] = [f" grazes by {margin:.2g}" for margin in margins[grazes]]
    return texts
