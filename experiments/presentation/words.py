"""Sentences that the page of a run and several commands share, and the names and looks of solvers.

The module needs the list of solvers and the names of axes. The page, the figures and the terminal call this module.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from impact_xval.compliant_baselines.registry import group_by_law, solver_names, title_of
from impact_xval.experiments.config.arrangements import ChainSetup
from impact_xval.experiments.config.axes import AXES, SI_AXES
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.tables.frames import AxisValue, FrameRow, Record
from impact_xval.experiments.tables.numbers import join_words, number

#: Explanation of the measure of divergence D.
WHAT_D_IS = (
    "D says how far apart two outcomes are. It is the difference of their final velocities, weighted by mass (the "
    "kinetic norm), and divided by the same norm of the velocities before the impact. D = 0 means that both outcomes "
    "are the same. D = 0.1 means that they differ by a tenth of the incoming motion."
)

#: Description of the scenario without gravity.
WITHOUT_GRAVITY = "without gravity (scenario impact)"

#: Statement that says what the comparison cannot show.
LAWS_WITH_LAWS = (
    "Contact laws are compared with one another, not with laboratory measurements. No number here says which law is "
    "nearer to a real collision."
)

#: Colour, marker and dash of the solvers that most runs have. Most colours are from the palette of Okabe and Ito, which
#: colour-blind readers can tell apart.
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
#: Colours and markers of all other solvers, in the order of the list of solvers. The colours are from the muted palette
#: of Tol.
_COLORS = ("#882255", "#44AA99", "#999933", "#332288", "#661100", "#AA4499", "#117733", "#DDCC77")
_MARKERS = ("P", "X", "h", ">", "p")

#: Explanations of the causes of divergence, by the name of the contribution, for readers new to the paper.
MEANINGS = {
    "frozen_positions": "the model keeps all bodies in place during the collision; in an engine they move",
    "dissipation_law": "a dashpot takes energy out at another time and in another amount than the model's restitution",
    "gravity": "gravity acts in the engine but not in the model",
    "mapping": "how the engine softens its contacts, and how stiffness and damping become its parameters",
    "discretisation": "the engine advances in time steps of finite length",
}

#: Sentences that say what happens in each contact graph of an experiment, by the name of the graph.
GRAPHS_IN_WORDS = {
    "bernoulli": "a ball falls between two equal balls at rest (bernoulli)",
    "corner": "a ball meets two walls at once (corner)",
    "bridge": "a ball falls on two balls that rest on a table (bridge)",
    "rack": "a ball strikes a rack of balls (rack)",
}

#: Mark that follows the numbers of a solver without a result, and note below a table with such numbers.
NO_RESULT = "*"
WHAT_NO_RESULT_IS = (
    f"{NO_RESULT}: the solver ended with these numbers, but they do not count as a result. The status and the reason "
    "say why. The velocities were computed with the time step of the run. If the reason speaks of halving the step, it "
    "means the shortest time step that was tried. Statistics of D leave these numbers out. If a sentence names causes "
    "of D for these numbers, D was computed with the time step of the run."
)

#: Engines in which the restitution of a contact is the product of the restitutions of its two bodies. Keys are names of
#: solvers, values the spelling of the makers.
_MULTIPLYING = {"pybullet": "PyBullet", "dart": "DART", "pymunk": "Pymunk"}


@dataclass(frozen=True, slots=True)
class Look:
    """Colour, marker and dash of one solver."""

    color: str
    marker: str
    dash: str | tuple[int, tuple[int, ...]]  # the words that matplotlib and Bokeh both understand


def look_of(solver: str) -> Look:
    """Return the colour, marker and dash of a solver, which are the same in every figure."""
    if solver in _LOOKS:
        return Look(*_LOOKS[solver])
    names = [name for name in solver_names(on_request=True) if name not in _LOOKS]
    place = names.index(solver) if solver in names else 0
    return Look(_COLORS[place % len(_COLORS)], _MARKERS[place % len(_MARKERS)], "dashed")


def display_name(solver: str) -> str:
    """Return the name of a solver as readers see it, such as MuJoCo for ``mujoco``."""
    return title_of(solver)


def name_solver_in(solver: str, text: str) -> str:
    """Return a sentence about causes of divergence with the name of a solver for readers in place of its first word.

    The first word is the name of the solver in tables.
    """
    identifier = next(filter(text.startswith, (solver, REFERENCE)), "")
    return display_name(identifier) + text.removeprefix(identifier)


def capitalise_first(sentence: str) -> str:
    """Return a sentence with its first letter capitalised."""
    return sentence[:1].upper() + sentence[1:]


def format_axis_value(value: AxisValue, digits: int = 3) -> str:
    """Return the value of an axis as text: a word as it is, a number rounded to `digits` digits."""
    return value if isinstance(value, str) else number(value, digits)


def describe_cell(cell: Record | FrameRow, axes: Mapping[str, str] = AXES, digits: int = 3) -> str:
    """Return the values of a cell as text, such as ``k2/k1 = 40, e1 = 0.9``.

    Axes on which the cell has no value are left out.
    """
    known = ((label, cell[axis]) for axis, label in axes.items() if cell[axis] is not None)
    return ", ".join(f"{label} = {format_axis_value(value, digits)}" for label, value in known)


def describe_si_values(cell: Record | FrameRow, quantities: Iterable[str] = SI_AXES) -> str:
    """Return masses and stiffnesses of a cell of two balls as text with their units."""
    return ", ".join(f"{name} = {number(cell[name], 6)} {SI_AXES[name]}" for name in quantities)


def describe_scenario(config: Config) -> str:
    """Return the scenario of an experiment as text: with or without gravity, and its name in files and options."""
    if config.scenario == "drop":
        return f"with gravity {number(config.gravity, 6)} m/s^2 (scenario drop)"
    return WITHOUT_GRAVITY


def describe_direction(*, table: bool) -> str:
    """Say in which direction the velocities of N balls are positive, with or without a table below them."""
    return "up is positive" if table else "the direction from the last ball to ball 1 is positive"


def describe_chain(chain: ChainSetup) -> str:
    """Return a description of a chain: its arrangement, number of balls, restitution, force law, tapers and gaps."""
    words = f"a {chain.arrangement} of {chain.balls} balls"
    words += f", {chain.striking} striking" if chain.arrangement == "cradle" else ""
    words += f", e = {number(chain.e, 6)}"
    words += f", F = k delta^{number(chain.exponent, 6)}" if chain.exponent != 1 else ""
    words += (
        f", each mass {number(chain.mass_taper, 6)} times the one before" if chain.mass_taper != 1 else ""
    )
    if chain.stiffness_taper != 1:
        words += f", each stiffness {number(chain.stiffness_taper, 6)} times the one before"
    return words + (f", gaps of {number(chain.gap, 6)} m" if chain.gap else "")


def describe_restitution_product(solvers: Iterable[str], e: float = 0.9) -> str:
    """Return advice about engines that multiply the restitutions of two bodies; empty if there is no such engine."""
    engines = [re.split("[-:]", name)[0] for name in solvers]
    titles = [title for engine, title in _MULTIPLYING.items() if engine in engines]
    if not titles:
        return ""
    verb = "multiplies" if len(titles) == 1 else "multiply"
    return (
        f"{join_words(titles)} {verb} the restitutions of the two bodies of a contact: {number(e, 4)} on both bodies "
        f"gives {number(e * e, 4)}. For a contact with e = {number(e, 4)} write {number(e, 4)} on one body and 1 "
        "on the other body."
    )


def describe_shared_laws(solvers: Iterable[str]) -> str:
    """Say which solvers were asked for the same contact law; empty if no two solvers were.

    If such solvers agree, this confirms nothing.
    """
    said: list[str] = []
    for group in group_by_law(solvers).values():
        if len(group) > 1:
            names = capitalise_first(join_words(map(display_name, group)))
            said.append(
                f"{names} were asked for the same contact law, so where they agree, this is no independent "
                "confirmation."
            )
    return " ".join(said)
