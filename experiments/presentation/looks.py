"""How each solver looks, in figures, charts and on a terminal: a colour, marker and dash, safe for the colour-blind."""

from __future__ import annotations

from dataclasses import dataclass

#: Of the model.
BLACK = "#000000"

#: Okabe and Ito's palette, of the others.
_PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442")
#: Of the solvers that come with the project.
FIXED = {
    "state-transition": (BLACK, "", "-"),
    "mujoco": ("#0072B2", "o", "-"),
    "pybullet": ("#D55E00", "s", "--"),
    "kelvin-voigt": ("#009E73", "^", "-."),
    "bistiffness": ("#CC79A7", "D", ":"),
    "kelvin-voigt-anchored": ("#56B4E9", "<", "--"),
    "kelvin-voigt-textbook": ("#8C8C8C", "x", (0, (1, 1))),
    "hunt-crossley": ("#7A4B1E", "P", "-"),
    "liu-zhao-brogliato": ("#5D3A9B", "*", (0, (3, 1))),
    "drake": ("#E69F00", "v", (0, (5, 1, 1, 1, 1, 1))),
}


@dataclass(frozen=True, slots=True)
class Look:
    """How one solver is drawn."""

    color: str
    marker: str
    dash: str | tuple[int, tuple[int, ...]]


def look(solver: str, position: int = 0) -> Look:
    """Return the look of a solver; an unknown one gets a colour by its position."""
    if solver in FIXED:
        return Look(*FIXED[solver])
    return Look(_PALETTE[position % len(_PALETTE)], "P", "--")
