r"""The corners between the model and what an engine was asked for: every combination of three switches.

| switch | off | on |
|---|---|---|
| positions | `frozen`: a contact returns as soon as its bodies approach | `free`: when its gap has closed |
| law | `energetic` restitution | the law that the engine was `asked` for, kelvin-voigt as a rule |
| gravity | `weightless` | as in the `scenario` of the run, B2 in static equilibrium |

All off is the state-transition model, all on the law of the engine in its scenario; what each of the eight is stands in
docs/theory.md, section 7. They are computed through the batch functions of the references, exactly between events and
without a time step, whether or not a run lists them as solvers; the model's is the run's own row. In an `impact`
the corners of the third switch are two and two the same; columns of N balls know no gravity, and have two switches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines import references
from impact_xval.compliant_baselines.marks import JUMPS, jumps, marks_of
from impact_xval.compliant_baselines.registry import KELVIN_VOIGT
from impact_xval.model.chain.following import MAX_PIECES
from impact_xval.model.collision import Collisions, Outcomes
from impact_xval.model.inputs import GRAZING_THRESHOLD

Floats = NDArray[np.float64]
Texts = NDArray[np.object_]

#: Positions of a switch.
FROZEN, FREE = 0, 1
ENERGETIC = 0
WEIGHTLESS, SCENARIO = 0, 1

#: A corner: the positions of its switches (positions, law, gravity); that of the model.
Index = tuple[int, int, int]
MODEL: Index = (FROZEN, ENERGETIC, WEIGHTLESS)


#: Pieces of segments after which a corner of N balls is given up, a second of ten balls.
_MAX_STEPS = 100_000

#: Laws that engines are asked for.
LAWS = (KELVIN_VOIGT, "hunt-crossley")


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """The corners of n cells.

    Attributes
    ----------
    velocities : ndarray, shape (2, 2, g, n, N)
        By position of each switch, velocities per abs(v0); NaN without a result. g is 2, or 1 of columns of N balls,
        which know no gravity.
    reason : ndarray of str, shape (n,)
        Empty where all have a result; else the first, of those beside the model, that has none, and its status. Those
        that come after it have none either.
    mark : ndarray of str, shape (n,)
        Which corner jumps beside the cell, or is decided by rounding: shares would be others; empty where none does.
    """

    velocities: Floats
    reason: Texts
    mark: Texts

    @property
    def model(self) -> Floats:
        """The state-transition model, shape (n, N)."""
        return self.velocities[MODEL]

    @property
    def asked(self) -> Floats:
        """The law of the engine in its scenario, shape (n, N)."""
        return self.velocities[-1, -1, -1]


def corner_names(*, gravity: bool = True) -> dict[Index, str]:
    """Return the name of every corner, as in columns of tables, by the positions of its switches."""
    return {
        (i, j, k): f"{positions}_{law}{weight}"
        for i, positions in enumerate(("frozen", "free"))
        for j, law in enumerate(("energetic", "asked"))
        for k, weight in enumerate(("_weightless", "_scenario") if gravity else ("",))
    }


def laws_of(obeyed: str) -> tuple[str, str]:
    """Return the names of the laws of a cube: bistiffness, and that of the engine."""
    if obeyed not in LAWS:
        raise ValueError(f"obeyed = {obeyed!r}; legal: {', '.join(LAWS)}")
    return "bistiffness", obeyed


def called(index: Index, laws: Sequence[str]) -> str:
    """Name a corner in a sentence."""
    positions, law, gravity = index
    frozen = "frozen " if positions == FROZEN else ""
    return f"{frozen}{laws[law]}{' with gravity' if gravity else ''}"


def corners(
    model: Floats, collisions: Collisions, gravity: Floats, obeyed: str = KELVIN_VOIGT, *, pair: bool = True
) -> Corners:
    r"""Compute the corners of collisions of one number of balls.

    Parameters
    ----------
    model : ndarray, shape (n, N)
        Final velocities of the state-transition model per abs(v0); NaN without a result, and nothing is computed.
    collisions : Collisions
    gravity : ndarray, shape (n,)
        In m/s^2; 0 without.
    obeyed : str
        One of `LAWS`: what the engine was asked for.
    pair : bool
        Whether they are cells of two balls, which may know gravity.

    Raises
    ------
    ValueError
        For an unknown law.
    """
    laws, n = laws_of(obeyed), len(model)
    velocities = np.full((2, len(laws), 1 + pair, *model.shape), np.nan)
    velocities[MODEL] = model
    reason, mark = np.full(n, "", dtype=object), np.full(n, "", dtype=object)
    speed = np.abs(collisions.velocities).max(axis=1)
    left = np.flatnonzero(~np.isnan(model).any(axis=1))
    marked = []
    for index in _order(weighty=bool(pair and (gravity > 0).any())):
        if index == MODEL or not len(left):
            continue
        positions, law, weight = index
        some, g = collisions[left], gravity[left] * (weight == SCENARIO)
        solve = references.law_at(
            laws[law], frozen=positions == FROZEN, max_steps=MAX_PIECES if pair else _MAX_STEPS
        )
        found = solve(some, g)
        velocities[index][left] = found.velocities / speed[left, None]
        there = found.has_result
        reason[left[~there]] = [f"{called(index, laws)}: {status}" for status in found.statuses[~there]]
        marked.append((left, _marks(solve, called(index, laws), laws[law], some, found, g, pair=pair)))
        left = left[there]
    for places, says in marked:  # the first that jumps is told
        new = (mark[places] == "") & (reason[places] == "")
        mark[places[new]] = says[new]
    if pair and not (gravity > 0).any():
        velocities[:, :, SCENARIO] = velocities[:, :, WEIGHTLESS]
    return Corners(velocities, reason, mark)


def _order(*, weighty: bool) -> list[Index]:
    """Give corners in the order in which they are computed."""
    weights = (WEIGHTLESS, SCENARIO) if weighty else (WEIGHTLESS,)
    return [(positions, law, weight) for weight in weights for positions in (FREE, FROZEN) for law in (0, 1)]


def _marks(
    solve: references.marks.Law,
    name: str,
    law: str,
    collisions: Collisions,
    found: Outcomes,
    gravity: Floats,
    *,
    pair: bool,
) -> Texts:
    """Say where a corner jumps (`marks.jumps`), grazes, or is decided by rounding."""
    if pair:
        excess, _ = jumps(solve, collisions, found, gravity)
        text = f"ladder: {name} jumps where a parameter changes by {max(JUMPS):g} or less"
        return np.where(excess > 1, text, "").astype(object)
    says = marks_of(solve, law, collisions, found, gravity)
    grazes = found.has_result & (found.grazing_margin < GRAZING_THRESHOLD)
    return np.array(
        [
            f"ladder: {name} grazes by {margin:.2g}" if near else f"ladder: {name}: {mark}" if mark else ""
            for near, margin, mark in zip(grazes, found.grazing_margin, says, strict=True)
        ],
        dtype=object,
    )
