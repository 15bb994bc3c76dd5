"""Contact graphs in an experiment: the table ``[graph]``, which names graphs and gives the values on their axes.

The graphs are `bernoulli`, `corner`, `bridge` and `rack` of `model.graph.named` (`docs/graphs.md`). In that module they
have a mass of 1 kg, a stiffness k1 of 1 N/m and a speed of 1 m/s. In an experiment they get the mass m1, stiffness k1
and velocity v0 of the experiment. Each graph has only some of the axes. The cells of a graph have NaN on all other
axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

from pydantic import Field, ValidationInfo, field_validator, model_validator

from impact_xval.experiments.config.axes import Axes, GivenAxis, expand_axis, legal_axis
from impact_xval.experiments.config.errors import is_list, shorten
from impact_xval.model.graph.collision import GraphCollision
from impact_xval.model.graph.named import RACKS, bernoulli, bridge, corner, rack
from impact_xval.model.inputs import E1, MASS_RATIO, Legal

#: Axes by which contact graphs are grouped, each with its name in tables and figures.
GRAPH_AXES = {
    "stiffness_ratio": "k2/k1",
    "graph": "graph",
    "angle": "angle in degrees",
    "mass_ratio": "m2/m1",
    "balls": "balls of the rack",
    "e": "e",
}

_LEAST, _BELOW_90, _BELOW_180 = (
    math.ulp(0.0),
    math.nextafter(90.0, 0.0),
    math.nextafter(180.0, 0.0),
)
_BETWEEN_BALLS = Legal("angle", 30.0, _BELOW_90, "from 30 to less than 90 degrees")
_BETWEEN_WALLS = Legal("angle", _LEAST, _BELOW_180, "more than 0 and less than 180 degrees")

#: Legal values on each axis. For some graphs the range of angles is narrower.
_LEGAL = {
    "angle": Legal("angle", _LEAST, _BELOW_180, "degrees, more than 0 and less than 180"),
    "stiffness_ratio": Legal("stiffness_ratio", _LEAST, 1e150, "a number > 0, at most 1e150 (k2/k1)"),
    "mass_ratio": MASS_RATIO._replace(high=1e150, text="a number > 0, at most 1e150 (m2/m1)"),
    "balls": Legal("balls", RACKS[0], RACKS[-1], "3, 6 or 10"),
    "e": E1._replace(name="e"),
}

#: Values of a graph, one for each axis, by the name of the axis.
Numbers = Mapping[str, float]


class Mirror(NamedTuple):
    """Mirror symmetry of a contact graph."""

    #: Index of the coordinate whose sign the mirror changes: 0 for x, 1 for z.
    coordinate: int
    #: For each body the index of its mirror image, from 0.
    images: tuple[int, ...]


class GraphSpec(NamedTuple):
    """Axes, construction and symmetry of a contact graph that an experiment names."""

    #: Names of the axes that the graph has.
    axes: tuple[str, ...]
    #: Function that returns the graph with given values on its axes.
    make: Callable[[Numbers], GraphCollision]
    #: Function that returns the mirror symmetry of the graph with given values on its axes, or None if this graph is
    #: not symmetric.
    mirror: Callable[[Numbers], Mirror | None]
    #: Default angles in degrees, and the legal angles. For a graph without an angle, the first is empty and the second
    #: is None.
    angles: tuple[float, ...] = ()
    legal_angle: Legal | None = None


def _mirrored_rack(numbers: Numbers) -> Mirror:
    """Return the mirror symmetry of a rack about its axis: the order of the balls in each row is reversed."""
    images, row = [0], 1
    while len(images) <= numbers["balls"]:
        images += range(len(images) + row - 1, len(images) - 1, -1)
        row += 1
    return Mirror(1, tuple(images))


#: Contact graphs that an experiment can name. In `bernoulli` and `bridge` a ball falls on two equal balls, which are
#: mirror images of each other.
GRAPH_SPECS = {
    "bernoulli": GraphSpec(
        ("angle", "stiffness_ratio", "e"),
        lambda x: bernoulli(x["angle"], stiffness_ratio=x["stiffness_ratio"], restitution=x["e"]),
        lambda x: Mirror(0, (0, 2, 1)) if x["stiffness_ratio"] == 1 else None,
        (30.0, 45.0, 60.0),
        _BETWEEN_BALLS,
    ),
    "corner": GraphSpec(
        ("angle", "stiffness_ratio", "e"),
        lambda x: corner(x["angle"], stiffness_ratio=x["stiffness_ratio"], restitutions=(x["e"], x["e"])),
        lambda x: None,
        (60.0, 90.0, 120.0),
        _BETWEEN_WALLS,
    ),
    "bridge": GraphSpec(
        ("angle", "stiffness_ratio", "mass_ratio", "e"),
        lambda x: bridge(
            x["angle"],
            table_stiffness_ratio=x["stiffness_ratio"],
            mass_ratio=x["mass_ratio"],
            restitutions=(x["e"], x["e"]),
        ),
        lambda x: Mirror(0, (0, 2, 1)),
        (30.0, 45.0, 60.0),
        _BETWEEN_BALLS,
    ),
    "rack": GraphSpec(
        ("balls", "e"),
        lambda x: rack(int(x["balls"]), restitution=x["e"]),
        _mirrored_rack,
    ),
}
_NAMES = "'bernoulli', 'corner', 'bridge' or 'rack'"


class GraphGrid(Axes):
    """Axes of an experiment with contact graphs; the first axis varies slowest.

    The values on an axis apply to the graphs that have this axis.
    """

    name: list[str] = Field(default=[*GRAPH_SPECS], description=_NAMES)
    stiffness_ratio: GivenAxis = Field(
        [0.01, 0.1, 1.0, 10.0, 100.0], description=_LEGAL["stiffness_ratio"].text
    )
    angle: GivenAxis | None = Field(None, description=_LEGAL["angle"].text)
    mass_ratio: GivenAxis = Field([2.0], description=_LEGAL["mass_ratio"].text)
    balls: GivenAxis = Field([3.0, 6.0], description=_LEGAL["balls"].text)
    e: GivenAxis = Field([0.5, 0.7, 0.9, 1.0], description=_LEGAL["e"].text)

    @field_validator("name", mode="before")
    @classmethod
    def _known(cls, value: object) -> object:
        names = value if is_list(value) else [value]
        if not names or any(
            not isinstance(name, str) or name not in GRAPH_SPECS or names.count(name) > 1 for name in names
        ):
            raise ValueError(f"{shorten(value)}; legal: {_NAMES}, or a list of them, each once")
        return names

    @field_validator(*_LEGAL, mode="before")
    @classmethod
    def _legal(cls, value: object, info: ValidationInfo) -> object:
        return None if value is None else legal_axis(_LEGAL[str(info.field_name)], value)

    @field_validator("balls")
    @classmethod
    def _racks(cls, value: GivenAxis) -> GivenAxis:
        for number in expand_axis(value):
            if number not in RACKS:
                raise ValueError(f"{number:g}; legal: {_LEGAL['balls'].text}")
        return value

    @model_validator(mode="after")
    def _of_some_graph(self) -> GraphGrid:
        for key in sorted(self.model_fields_set & self.unused_axes):
            if getattr(self, key) is not None:
                have = ", ".join(name for name, spec in GRAPH_SPECS.items() if key in spec.axes)
                raise ValueError(f"{key} is given without a graph that has it; legal: with {have}")
        for name in self.name:
            legal = GRAPH_SPECS[name].legal_angle
            for angle in expand_axis(self.angle) if legal and self.angle is not None else ():
                if legal and not legal.includes(angle):
                    raise ValueError(f"angle = {angle:g} of {name}; legal: {legal.text}")
        return self

    @property
    def unused_axes(self) -> set[str]:
        """Names of the axes that no graph of this experiment has."""
        return {key for key in _LEGAL if not any(key in GRAPH_SPECS[name].axes for name in self.name)}

    def varied(self) -> dict[str, list[float] | list[str]]:
        """Return the names of the graphs, and the values on every axis that at least one of the graphs has.

        If the file gives no angles, each graph has its own default angles, and the axis of angles is not in the result.
        """
        axes: dict[str, list[float] | list[str]] = {"name": self.name}
        keys = [key for key in GRAPH_AXES if key in _LEGAL and key not in self.unused_axes]
        given = ((key, getattr(self, key)) for key in keys)
        return axes | {key: expand_axis(axis) for key, axis in given if axis is not None}

    def most_bodies(self) -> int:
        """Return the largest number of bodies that move in a cell."""
        return max(len(named_graph(*corner, 1.0, 1.0, -1.0).masses) for corner in self.corners())

    def count(self) -> int:
        """Return the number of cells, over all graphs."""
        return sum(math.prod(map(len, self.axes(name).values())) for name in self.name)

    def axes(self, name: str) -> dict[str, list[float]]:
        """Return the values of a graph on every axis.

        On an axis that the graph does not have, the only value is NaN.
        """
        spec = GRAPH_SPECS[name]
        given = {key: getattr(self, key) for key in _LEGAL}
        given["angle"] = self.angle or list(spec.angles)
        return {
            key: expand_axis(given[key]) if key in spec.axes else [math.nan]
            for key in GRAPH_AXES
            if key != "graph"
        }

    def corners(self) -> Iterator[tuple[str, dict[str, float]]]:
        """Yield the graphs at the ends of all axes, each as its name and its value on each axis.

        If any graph on the axes is illegal, at least one of these graphs is illegal too.
        """
        for name in self.name:
            for end in (min, max):
                yield name, {key: end(values) for key, values in self.axes(name).items()}


def named_graph(name: str, numbers: Numbers, m1: float, k1: float, v0: float) -> GraphCollision:
    """Return a contact graph by its name and its values on all axes, in the units of an experiment.

    Parameters
    ----------
    name : str
        One of the names in `GRAPH_SPECS`.
    numbers : mapping of str to float
        Value on each axis.
    m1, k1 : float
        Mass in kg and stiffness in N/m. They replace the values 1 kg and 1 N/m of `model.graph.named`.
    v0 : float
        Velocity in m/s. Its absolute value replaces the speed of 1 m/s in `model.graph.named`.

    Raises
    ------
    ValueError
        If a number is illegal, or over- or underflows in double precision.
    """
    graph, speed = GRAPH_SPECS[name].make(numbers), abs(v0)
    return replace(
        graph,
        masses=[m1 * mass for mass in graph.masses],
        velocities=[[speed * component for component in velocity] for velocity in graph.velocities],
        contacts=[replace(contact, stiffness=k1 * contact.stiffness) for contact in graph.contacts],
    )
