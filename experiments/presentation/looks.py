"""How each solver looks, in figures, charts and on a terminal: a colour, marker and dash, safe for the colour-blind."""

from __future__ import annotations

from dataclasses import dataclass

from impact_xval.compliant_baselines.registry import solver_names

#: Of the solvers of most runs, by Okabe and Ito's palette.
_FIXED = {
    "state-transition": ("#000000", "", "-"),
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
#: Of the others, in the order in which solvers are listed: other colours, by Tol's muted palette.
_COLORS = ("#882255", "#44AA99", "#999933", "#332288", "#661100", "#AA4499", "#117733", "#DDCC77")
_MARKERS = ("P", "X", "h", ">", "p")


@dataclass(frozen=True, slots=True)
class Look:
    """How one solver is drawn."""

    color: str
    marker: str
    dash: str | tuple[int, tuple[int, ...]]


def look(solver: str) -> Look:
    """Return the look of a solver, the same in every figure."""
    if solver in _FIXED:
        return Look(*_FIXED[solver])
    others = [name for name in solver_names(on_request=True) if name not in _FIXED]
    place = others.index(solver) if solver in others else 0
    return Look(_COLORS[place % len(_COLORS)], _MARKERS[place % len(_MARKERS)], "--")
