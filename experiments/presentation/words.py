"""Sentences that several pages and commands share, and the names and looks of solvers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from impact_xval.compliant_baselines.registry import group_by_law, solver_names, title_of
from impact_xval.experiments.config.arrangements import ChainSetup
from impact_xval.experiments.config.axes import AXES, SI_AXES
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.tables.frames import AxisValue, FrameRow, Record
from impact_xval.experiments.tables.numbers import join_words, number

#: The measure of divergence, in words.
WHAT_D_IS = (
    "D is the difference between two outcomes: that of the final velocities, weighted by mass (the kinetic "
    "norm), per speed of impact. D = 0 is the same outcome; at D = 0.1 velocities differ by a tenth of the "
    "incoming motion."
)

LAWS_WITH_LAWS = (
    "Laws of contact are compared with one another; no laboratory measurement is in the comparison, and no "
    "number says which law is nearer to a real collision."
)

#: Colour, marker and dash of the solvers of most runs, by the palette of Okabe and Ito, safe for the colour-blind.
_LOOKS = {
    "state-transition": ("#000000", "", "solid"),
    "mujoco": ("#0072B2", "o", "solid"),
    "pybullet": ("#D55E00", "s", "dashed"),
    "kelvin-voigt": ("#009E73", "^", "dashdot"),
    "bistiffness": ("#CC79A7", "D", "dotted"),
    "kelvin-voigt-anchored": ("#56B4E9", "<", "dashed"),
    "kelvin-voigt-textbook": ("#8C8C8C", "x", (0, (1, 1))),
    "linear-dashpot": ("#228833", "d", (0, (2, 1))),
    "hunt-crossley": ("#7A4B1E", "P", "solid"),
    "liu-zhao-brogliato": ("#5D3A9B", "*", (0, (3, 1))),
    "drake": ("#E69F00", "v", (0, (5, 1, 1, 1, 1, 1))),
}
#: Colours and markers of all other solvers, in the order of the list of solvers, by the muted palette of Tol.
_COLORS = ("#882255", "#44AA99", "#999933", "#332288", "#661100", "#AA4499", "#117733", "#DDCC77")
_MARKERS = ("P", "X", "h", ">", "p")

#: Explanations of the causes of divergence, by the name of the contribution, for readers new to the paper.
MEANINGS = {
    "frozen_positions": "the model keeps all bodies in place during the collision; in an engine they move",
    "dissipation_law": "a dashpot takes energy out at another time and in another amount than the model's restitution",
    "gravity": "it acts in an engine and not in the model",
    "mapping": "how the engine softens its contacts, and how stiffness and damping become its parameters",
    "discretisation": "the engine's step is not zero",
}

#: What happens in the contact graphs of an experiment, by name.
GRAPHS_IN_WORDS = {
    "bernoulli": "a ball falls between two equal balls at rest (bernoulli)",
    "corner": "a ball meets two walls at once (corner)",
    "bridge": "a ball falls on two balls that rest on a table (bridge)",
    "rack": "a ball strikes a rack of balls (rack)",
}

#: Mark after the numbers of a row without a result, and the note below a table with such rows.
NO_RESULT = "*"
WHAT_NO_RESULT_IS = (
    f"{NO_RESULT}: what the solver came to, but no result; the status and the reason say why. The velocities are those "
    "at the step of the run, and a reason that speaks of halving the step is about the shortest step tried. Such a row "
    "counts in no statistic of D. A sentence on its causes, where there is one, tells its D at the step of the run."
)

#: Engines that multiply the restitutions of two bodies, and their names as their makers spell them.
_MULTIPLYING = {"pybullet": "PyBullet", "dart": "DART", "pymunk": "Pymunk"}

_COUNTS = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


@dataclass(frozen=True, slots=True)
class Look:
    """Colour, marker and dash of one solver."""

    color: str
    marker: str
    dash: str | tuple[int, tuple[int, ...]]  # matplotlib and Bokeh have the same words


def look_of(solver: str) -> Look:
    """Return the look of a solver, the same in every figure."""
    if solver in _LOOKS:
        return Look(*_LOOKS[solver])
    names = [name for name in solver_names(on_request=True) if name not in _LOOKS]
    place = names.index(solver) if solver in names else 0
    return Look(_COLORS[place % len(_COLORS)], _MARKERS[place % len(_MARKERS)], "dashed")


def display_name(solver: str) -> str:
    """Return the name of a solver for readers."""
    return title_of(solver)


def name_solver_in(solver: str, text: str) -> str:
    """Replace the identifier of a solver at the beginning of a ladder's sentence by the solver's name."""
    identifier = next(filter(text.startswith, (solver, REFERENCE)), "")
    return display_name(identifier) + text.removeprefix(identifier)


def capitalise_first(sentence: str) -> str:
    """Return a sentence with its first letter capitalised."""
    return sentence[:1].upper() + sentence[1:]


def format_axis_value(value: AxisValue, digits: int = 3) -> str:
    """Write a value of an axis: a word, or a number."""
    return value if isinstance(value, str) else number(value, digits)


def describe_cell(cell: Record | FrameRow, axes: Mapping[str, str] = AXES, digits: int = 3) -> str:
    """Describe a cell by the axes on which it has a value."""
    known = ((label, cell[axis]) for axis, label in axes.items() if cell[axis] is not None)
    return ", ".join(f"{label} = {format_axis_value(value, digits)}" for label, value in known)


def describe_si_values(cell: Record | FrameRow, quantities: Iterable[str] = SI_AXES) -> str:
    """Write masses and stiffnesses of a cell of two balls with their units."""
    return ", ".join(f"{name} = {number(cell[name], 6)} {SI_AXES[name]}" for name in quantities)


def describe_chain(chain: ChainSetup) -> str:
    """Say in words how a chain is arranged."""
    words = f"a {chain.arrangement} of {chain.balls} balls"
    words += f", {chain.striking} striking" if chain.arrangement == "cradle" else ""
    words += f", e = {number(chain.e, 6)}"
    words += f", F = k delta^{number(chain.exponent, 6)}" if chain.exponent != 1 else ""
    words += f", mass taper {number(chain.mass_taper, 6)}" if chain.mass_taper != 1 else ""
    words += f", stiffness taper {number(chain.stiffness_taper, 6)}" if chain.stiffness_taper != 1 else ""
    return words + (f", gaps of {number(chain.gap, 6)} m" if chain.gap else "")


def describe_restitution_product(solvers: Iterable[str], e: float = 0.9) -> str:
    """Say what to write for e in engines that multiply the restitutions of two bodies; empty without such engines."""
    engines = [re.split("[-:]", name)[0] for name in solvers]
    titles = [title for engine, title in _MULTIPLYING.items() if engine in engines]
    if not titles:
        return ""
    verb = "multiplies" if len(titles) == 1 else "multiply"
    return (
        f"{join_words(titles)} {verb} the restitutions of the two bodies of a contact: {number(e, 4)} on both gives "
        f"{number(e * e, 4)}. For e = {number(e, 4)} write {number(e, 4)} on one and 1 on the other."
    )


def describe_shared_laws(solvers: Iterable[str]) -> str:
    """Say which solvers were asked for the same law, and are one vote on it; empty if there are none."""
    said: list[str] = []
    for group in group_by_law(solvers).values():
        if len(group) > 1:
            count = _COUNTS[len(group)] if len(group) < len(_COUNTS) else len(group)
            names = capitalise_first(join_words(map(display_name, group)))
            said.append(f"{names} were asked for one law: one vote, not {count}.")
    return " ".join(said)
