"""One contact graph by its name, as it is typed: the options that each graph has, and their legal values.

Nothing heavy is imported before something is asked: the options of help texts stand here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from impact_xval.experiments.config.errors import UserError, hint

if TYPE_CHECKING:
    from impact_xval.model.graph import GraphCollision

#: Options of graphs alone, each with its unit and meaning.
GRAPH_PARAMETERS = {
    "graph": ("NAME", "'bernoulli', 'corner', 'bridge', 'rack' or 'box'."),
    "angle": ("DEG", "Of a fall to a line of centres, or between walls, in degrees."),
    "restitution": ("E", "Restitution of every contact of a graph, 0 to 1."),
    "velocity": ("X,Z", "Of the ball in a corner, in m/s."),
    "table_stiffness_ratio": ("R", "Stiffness of the table of a bridge over all others."),
    "offset": ("DEG", "Of the cue ball's velocity from the axis of a rack, in degrees."),
    "inertia": ("R", "Of a box, over m a^2 with the half width a."),
}

#: Options that every graph has: how it is solved.
SOLVED_BY = ("step_fraction", "cell_timeout")

#: Options of each graph; e1 and e2 are its two restitutions.
OPTIONS_OF = {
    "bernoulli": ("angle", "stiffness_ratio", "restitution"),
    "corner": ("angle", "stiffness_ratio", "e1", "e2", "velocity"),
    "bridge": ("angle", "table_stiffness_ratio", "mass_ratio", "e1", "e2"),
    "rack": ("balls", "restitution", "offset"),
    "box": ("inertia", "stiffness_ratio", "restitution"),
}

#: Restitutions of a graph that has two, if they are not given: those of `model.graph.named`.
_RESTITUTIONS = {"corner": (1.0, 1.0), "bridge": (0.9, 0.7)}


def parse_graph(parameters: Mapping[str, str | None]) -> tuple[GraphCollision, str]:
    """Make a collision of bodies of what is typed for one, and name it in words.

    Parameters are typed as options, None where nothing was; those of `SOLVED_BY` are left alone. A `UserError` names
    the option that is illegal, its value and what is legal.
    """
    given = {key: text for key, text in parameters.items() if text is not None and key not in SOLVED_BY}
    name = given.pop("graph")
    if name not in OPTIONS_OF:
        raise UserError(
            f"--graph = {name!r:.60} is no graph{hint(name, [*OPTIONS_OF])}; legal: {', '.join(OPTIONS_OF)}"
        )
    legal = OPTIONS_OF[name]
    for key, text in given.items():
        if key not in legal:
            raise UserError(
                f"{_option(key)} = {text!r:.60} beside --graph {name}; legal: {', '.join(map(_option, legal))}"
            )
    values = {key: _READERS.get(key, _number)(key, text) for key, text in given.items()}
    restitutions = _RESTITUTIONS.get(name)
    if restitutions is not None and ("e1" in values or "e2" in values):
        values["restitutions"] = values.pop("e1", restitutions[0]), values.pop("e2", restitutions[1])
    from impact_xval.model.graph import GRAPHS

    try:
        collision = GRAPHS[name](**values)
    except ValueError as error:
        raise UserError(_named_option(str(error), given)) from None
    return collision, ", ".join([name, *(f"{key.replace('_', ' ')} {text}" for key, text in given.items())])


def _number(key: str, text: str) -> float:
    """Read a number."""
    try:
        return float(text)
    except ValueError:
        raise UserError(f"{_option(key)} = {text!r:.60}; legal: a number") from None


def _restitution(key: str, text: str) -> float:
    """Read a restitution."""
    value = _number(key, text)
    if not 0 <= value <= 1:
        raise UserError(f"{_option(key)} = {text!r:.60}; legal: from 0 to 1")
    return value


def _count(key: str, text: str) -> float:
    """Read a number, as a whole one if it is."""
    value = _number(key, text)
    return int(value) if value.is_integer() else value


def _vector(key: str, text: str) -> tuple[float, ...]:
    """Read two numbers, separated by a comma."""
    try:
        x, z = map(float, text.split(","))
    except ValueError:
        raise UserError(f"{_option(key)} = {text!r:.60}; legal: two numbers X,Z (m/s)") from None
    return x, z


_READERS: Mapping[str, Callable[[str, str], object]] = {
    "e1": _restitution,
    "e2": _restitution,
    "restitution": _restitution,
    "balls": _count,
    "velocity": _vector,
}


def _named_option(said: str, given: Mapping[str, str]) -> str:
    """Name the option in what a graph says of an illegal value, which begins with the name of a field."""
    field, _, rest = said.partition(" ")
    if field in given:
        return f"{_option(field)} {rest}"
    if field.startswith("velocities") and "velocity" in given:
        _, _, why = said.rpartition(": nothing meets; ")
        rest = f": nothing meets; {why}" if why != said else f"; {said}"
        return f"--velocity = {given['velocity']!r:.60}{rest}"
    return said


def _option(key: str) -> str:
    return "--" + key.replace("_", "-")
