"""Options of the command ``solve --graph``: the options that each contact graph has, and their legal values.

`parse_graph` makes a contact graph from these options. NumPy is imported only in this function, because help texts show
the options and must appear at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from impact_xval.experiments.config.errors import UserError, hint

if TYPE_CHECKING:
    from impact_xval.model.graph import GraphCollision

#: Options that only contact graphs have, each with its placeholder in the help and its meaning.
GRAPH_PARAMETERS = {
    "graph": (
        "NAME",
        "'bernoulli', 'corner', 'bridge', 'rack' or 'box'; --graph NAME --help shows its options.",
    ),
    "angle": ("DEG", "Angle of a fall to a line of centres, or between walls, in degrees."),
    "restitution": ("E", "Restitution of every contact of a graph, 0 to 1."),
    "velocity": ("X,Z", "Velocity of the ball in a corner, in m/s."),
    "table_stiffness_ratio": ("R", "Stiffness of the table of a bridge over all others."),
    "offset": ("DEG", "Angle of the cue ball's velocity to the axis of a rack, in degrees."),
    "inertia": ("R", "Moment of inertia of a box over m a^2 with the half width a."),
}

#: Options that every graph has. They decide how solvers solve the graph.
SOLVED_BY = ("step_fraction", "cell_timeout")

#: Options of each graph with their defaults, by the name of the graph. The options e1 and e2 are two restitutions.
#: `model.graph.named` has the same defaults, but importing it takes too long for a help text.
OPTIONS_OF: Mapping[str, Mapping[str, float | tuple[float, ...]]] = {
    "bernoulli": {"angle": 30.0, "stiffness_ratio": 1.0, "restitution": 1.0},
    "corner": {"angle": 90.0, "stiffness_ratio": 1.0, "e1": 1.0, "e2": 1.0, "velocity": (-1.0, -0.3)},
    "bridge": {"angle": 30.0, "table_stiffness_ratio": 3.0, "mass_ratio": 2.0, "e1": 0.9, "e2": 0.7},
    "rack": {"balls": 3, "restitution": 0.95, "offset": 0.0},
    "box": {"inertia": 1 / 3, "stiffness_ratio": 1.0, "restitution": 0.8},
}


#: Graphs whose restitutions e1 and e2 are not those of ball on ball and of ball on table, with what they are.
_RESTITUTIONS_OF = {"corner": "e1 and e2 are the restitutions of the two walls."}


def describe_options(graph: str) -> str:
    """Return lines that name the options of a graph with their defaults, as they can be typed."""
    options = (f"{_option(key)} {_format_value(value)}" for key, value in OPTIONS_OF[graph].items())
    lines = [f"Defaults of {graph}: {' '.join(options)}", *filter(None, [_RESTITUTIONS_OF.get(graph)])]
    return "\n".join(lines)


def parse_graph(parameters: Mapping[str, str | None]) -> tuple[GraphCollision, str]:
    """Return the contact graph that options describe, and its description in words.

    The description has the values of all options of the graph, also of those that were not typed.

    `parameters` has the text of each option by the name of the option, or None if the option was not typed. The options
    in `SOLVED_BY` are ignored here. If an option is illegal, a `UserError` names the option, its value and the legal
    values.
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
    values: dict[str, object] = {**legal}
    values |= {key: _READERS.get(key, _number)(key, text) for key, text in given.items()}
    if "e1" in values:
        values["restitutions"] = values.pop("e1"), values.pop("e2")
    from impact_xval.model.graph import GRAPHS

    try:
        collision = GRAPHS[name](**values)
    except ValueError as error:
        raise UserError(_named_option(str(error), given)) from None
    texts = {key: given.get(key) or _format_value(default) for key, default in legal.items()}
    return collision, ", ".join([name, *(f"{key.replace('_', ' ')} {text}" for key, text in texts.items())])


def _format_value(value: float | tuple[float, ...]) -> str:
    """Return the default of an option as it can be typed."""
    return ",".join(f"{x:g}" for x in value) if isinstance(value, tuple) else f"{value:g}"


def _number(key: str, text: str) -> float:
    """Return the number that was typed for an option."""
    try:
        return float(text)
    except ValueError:
        raise UserError(f"{_option(key)} = {text!r:.60}; legal: a number") from None


def _restitution(key: str, text: str) -> float:
    """Return the restitution from 0 to 1 that was typed for an option."""
    value = _number(key, text)
    if not 0 <= value <= 1:
        raise UserError(f"{_option(key)} = {text!r:.60}; legal: from 0 to 1")
    return value


def _count(key: str, text: str) -> float:
    """Return the number that was typed for an option, as an int if it is whole."""
    value = _number(key, text)
    return int(value) if value.is_integer() else value


def _vector(key: str, text: str) -> tuple[float, ...]:
    """Return the two numbers, separated by a comma, that were typed for an option."""
    try:
        x, z = map(float, text.split(","))
    except ValueError:
        raise UserError(f"{_option(key)} = {text!r:.60}; legal: two numbers X,Z (m/s)") from None
    return x, z


#: Functions that read the text of an option, by the name of the option. `_number` reads all options that are not named
#: here.
_READERS: Mapping[str, Callable[[str, str], object]] = {
    "e1": _restitution,
    "e2": _restitution,
    "restitution": _restitution,
    "balls": _count,
    "velocity": _vector,
}


def _named_option(said: str, given: Mapping[str, str]) -> str:
    """Return a message about an illegal value of a graph, with the name of the option in place of the field's name.

    `said` is the message, which begins with the name of a field of the graph. `given` has the text of each option that
    was typed, by the name of the option.
    """
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
