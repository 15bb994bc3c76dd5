r"""The corners between the model and what an engine was asked for: every combination of three switches.

| switch | off | on |
|---|---|---|
| positions | `frozen`: a contact returns as soon as its bodies approach | `free`: when its gap has closed |
| law | `energetic` restitution | the law that the engine was `asked` for, kelvin-voigt as a rule |
| gravity | `weightless` | as in the `scenario` of the run, B2 in static equilibrium |

All off is the state-transition model, all on the law of the engine in its scenario; what each of the eight is stands in
docs/theory.md, section 7. They are computed through the batch functions of the references, exactly between events and
without a time step, whether or not a run lists them as solvers; the model's is the run's own row. In an `impact`
the corners of the third switch are two and two the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines import references
from impact_xval.compliant_baselines.marks import JUMPS, jumps
from impact_xval.compliant_baselines.registry import KELVIN_VOIGT
from impact_xval.model.collision import Collisions, Outcomes

Floats = NDArray[np.float64]
Texts = NDArray[np.str_]

#: Positions of a switch.
FROZEN, FREE = 0, 1
ENERGETIC = 0
WEIGHTLESS, SCENARIO = 0, 1

#: A corner: the positions of its switches (positions, law, gravity); that of the model.
Index = tuple[int, int, int]
MODEL: Index = (FROZEN, ENERGETIC, WEIGHTLESS)


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
    """

    velocities: Floats
    reason: Texts

    def take(self, index: NDArray[np.intp]) -> Corners:
        """Return those of some cells, in the order of `index`."""
        return Corners(self.velocities[:, :, :, index], self.reason[index])

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


def solvers(gravity_number: Floats, laws: Sequence[str]) -> Iterator[tuple[Index, str, bool, Floats]]:
    r"""Give the law of each corner but the model, whether positions are frozen, and its gravity numbers.

    Parameters
    ----------
    gravity_number : ndarray, shape (n,)
        g/(\|v0\| omega1); where all are 0, the corners of the scenario are left out.
    laws : sequence of str
        From `laws_of`.
    """
    for gravity in (WEIGHTLESS, SCENARIO) if np.any(gravity_number > 0) else (WEIGHTLESS,):
        for positions, law in product((FREE, FROZEN), range(len(laws))):
            index = positions, law, gravity
            if index != MODEL:
                number = gravity_number if gravity else np.zeros_like(gravity_number)
                yield index, laws[law], positions == FROZEN, number


def corner_marks(cells: Sequence[Floats], gravity_number: Floats, obeyed: str = KELVIN_VOIGT) -> Texts:
    """Say of each cell which corner jumps beside it (`marks.jumps`): its shares would be others.

    Parameters
    ----------
    cells, gravity_number, obeyed
        As for `corners`.

    Returns
    -------
    ndarray of str, shape (n,)
        Empty where no corner between the model and the engine's law does.
    """
    laws = laws_of(obeyed)
    marks = np.full(len(gravity_number), "", dtype="U120")
    collisions = Collisions.from_ratios(*cells)
    for index, name, frozen, number in solvers(gravity_number, laws):
        law, gravity = references.law_at(name, frozen=frozen), number * np.sqrt(1 + 1 / cells[1])
        excess, _ = jumps(law, collisions, law(collisions, gravity), gravity)
        found = (excess > 1) & (marks == "")
        marks[found] = (
            f"ladder: {called(index, laws)} jumps where a parameter changes by {max(JUMPS):g} or less"
        )
    return marks


def gather(model: Floats, batches: Iterable[tuple[Index, Outcomes]], laws: Sequence[str]) -> Corners:
    """Put corners together.

    Parameters
    ----------
    model : ndarray, shape (n, 2)
        Final velocities per abs(v0); NaN without a result.
    batches : iterable of (Index, Outcomes)
        The outcomes of `solvers`, for the same cells.
    laws : sequence of str
        From `laws_of`.
    """
    velocities = np.full((2, len(laws), 2, *model.shape), np.nan)
    velocities[MODEL] = model
    reason, weighty = np.full(len(model), "", dtype="U80"), False
    for index, batch in batches:
        velocities[index] = batch.velocities
        failed = ~batch.has_result & (reason == "")
        reason[failed] = np.char.add(f"{called(index, laws)}: ", batch.statuses[failed])
        weighty |= index[2] == SCENARIO
    if not weighty:
        velocities[:, :, SCENARIO] = velocities[:, :, WEIGHTLESS]
    return Corners(velocities, reason)


def called(index: Index, laws: Sequence[str]) -> str:
    """Name a corner in a sentence."""
    positions, law, gravity = index
    frozen = "frozen " if positions == FROZEN else ""
    return f"{frozen}{laws[law]}{' with gravity' if gravity else ''}"


def corners(
    model: Floats,
    cells: Sequence[Floats],
    gravity_number: Floats,
    obeyed: str = KELVIN_VOIGT,
) -> Corners:
    r"""Compute the corners of cells.

    Parameters
    ----------
    model : ndarray, shape (n, 2)
        Final velocities of the state-transition model per \|v0\|; NaN without a result.
    cells : sequence of four ndarray, shape (n,)
        k2/k1, m2/m1, e1 and e2.
    gravity_number : ndarray, shape (n,)
        g/(\|v0\| omega1); 0 without gravity.
    obeyed : str
        One of `LAWS`: what the engine was asked for.

    Raises
    ------
    ValueError
        For an unknown law, or an illegal value.
    """
    laws = laws_of(obeyed)
    return gather(model, _solved(cells, gravity_number, laws), laws)


def _solved(
    cells: Sequence[Floats], gravity_number: Floats, laws: Sequence[str]
) -> Iterator[tuple[Index, Outcomes]]:
    """Solve the corners one by one; a cell without a result at one of them is not followed at those that come after.

    It has no ladder, and may have been given up after as many segments as a batch follows, which takes a second.
    """
    ratios, mu, e1, e2 = cells
    ratios = ratios.copy()
    for index, law, frozen, number in solvers(gravity_number, laws):
        batch = references.solve_batch(law, ratios, mu, e1, e2, number, frozen=frozen)
        ratios[~batch.has_result] = 0.0  # refused at once
        yield index, batch
