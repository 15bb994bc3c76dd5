"""Arrangements of chains, each described by a few numbers: row, cradle, pile and stack (`docs/chains.md`).

`ChainSetup` describes one chain, and `ChainGrid` the axes of an experiment with chains. Options of commands and the
TOML file of an experiment use them.

The mass taper is the mass of each ball over the mass of the ball above it. The stiffness taper is the stiffness of each
contact over the stiffness of the contact above it. A pile of two balls is the problem of two balls on a table. Its
tapers are m2/m1 and k2/k1.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from typing import Literal, get_args

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from impact_xval.experiments.config.axes import (
    KEPT,
    LEGAL,
    Axes,
    Axis,
    Strict,
    expand_axis,
    legal_field,
    positive_field,
)
from impact_xval.experiments.config.errors import is_list, shorten
from impact_xval.experiments.config.renamed import rename_arrangement
from impact_xval.model.collision import MAX_BALLS, Collision
from impact_xval.model.inputs import V0

Arrangement = Literal["row", "cradle", "pile", "stack"]
_NAMES = "'row', 'cradle', 'pile' or 'stack'"

#: Axes by which chains are grouped, each with its name in tables and figures.
CHAIN_AXES = {
    "balls": "balls",
    "arrangement": "arrangement",
    "strike": "strikers",
    "e": "e",
    "exponent": "exponent",
    "mass_taper": "mass taper",
    "stiffness_taper": "stiffness taper",
    "gap": "gap in m",
}


class ChainSetup(Strict):
    """Setup of one chain: the arrangement and a few numbers, in SI units."""

    arrangement: Arrangement = Field("cradle", description=_NAMES)
    balls: int = Field(5, description=LEGAL["balls"].text)
    strike: int | None = Field(None, description=LEGAL["strike"].text)
    e: float = legal_field(LEGAL["e"], 0.95)
    exponent: float = legal_field(LEGAL["exponent"], 1.0)
    gap: float = legal_field(LEGAL["gap"], 0.0)
    m: float = positive_field(1.0, "kg")
    mass_taper: float = legal_field(LEGAL["mass_taper"], 1.0)
    k: float = positive_field(1e8, "N/m^p")
    stiffness_taper: float = legal_field(LEGAL["stiffness_taper"], 1.0)
    v0: float = legal_field(V0, -1.0)

    @field_validator("arrangement", mode="before")
    @classmethod
    def _of_today(cls, name: object, info: ValidationInfo) -> object:
        return rename_arrangement(name, warn=info.context != KEPT)

    @field_validator("balls")
    @classmethod
    def _something_meets(cls, balls: int, info: ValidationInfo) -> int:
        name = info.data.get("arrangement", "stack")
        fewest = 1 if name == "stack" else 2
        if not fewest <= balls <= MAX_BALLS:
            raise ValueError(f"{balls}; legal: a whole number from {fewest} to {MAX_BALLS}, for a {name}")
        return balls

    @field_validator("strike")
    @classmethod
    def _some_rest(cls, strike: int | None, info: ValidationInfo) -> int | None:
        if strike is not None and {"arrangement", "balls"} <= info.data.keys():
            name, balls = info.data["arrangement"], info.data["balls"]
            if name != "cradle":
                raise ValueError(f"{strike}; legal: none for a {name}; only a cradle has it")
            if not 1 <= strike < balls:
                raise ValueError(f"{strike}; legal: a whole number from 1 to {balls - 1}, for {balls} balls")
        return strike

    @model_validator(mode="after")
    def _within_double_precision(self) -> ChainSetup:
        try:
            self.collision()
            if not 0 < self.m * abs(self.v0) < math.inf:
                raise ValueError("m times |v0| leaves double precision; legal: a finite product > 0")
        except ValueError as error:
            scales = ("balls", "m", "mass_taper", "k", "stiffness_taper", "v0")
            given = ", ".join(f"{name} = {getattr(self, name)!r}" for name in scales)
            raise ValueError(f"{given}: {error}") from None
        return self

    @property
    def striking(self) -> int:
        """Number of balls that move at first.

        The contact that is struck lies below these balls, and has the same number.
        """
        return self.balls if self.arrangement == "stack" else self.strike or 1

    def collision(self) -> Collision:
        """Return the chain as a collision in kg, N/m^p and m/s.

        The contact that is struck is closed at first; all other contacts have the gap.
        """
        table = self.arrangement in ("pile", "stack")
        contacts, struck = self.balls - 1 + table, self.striking - 1
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            masses = self.m * np.power(float(self.mass_taper), np.arange(self.balls))
            stiffnesses = self.k * np.power(float(self.stiffness_taper), np.arange(contacts))
        return Collision(
            masses=tuple(masses.tolist()),
            stiffnesses=tuple(stiffnesses.tolist()),
            restitutions=(self.e,) * contacts,
            velocities=tuple(self.v0 if i <= struck else 0.0 for i in range(self.balls)),
            table=table,
            gaps=tuple(self.gap if i != struck else 0.0 for i in range(contacts)),
            exponent=self.exponent,
        )


class ChainGrid(Axes):
    """Axes of an experiment with chains; the first axis varies slowest."""

    arrangement: list[Arrangement] = Field(
        default=["cradle", "pile", "stack"], description=f"{_NAMES}, or a list of them"
    )
    balls: Axis = Field(default=[2.0, 3.0, 5.0, 10.0])
    strike: Axis | None = Field(default=None)
    exponent: Axis = Field(default=[1.0])
    mass_taper: Axis = Field(default=[1.0])
    stiffness_taper: Axis = Field(default=[0.8, 1.0, 1.25])
    gap: Axis = Field(default=[0.0])
    e: Axis = Field(default=[0.5, 0.6, 0.7, 0.8, 0.9, 1.0])

    @field_validator("arrangement", mode="before")
    @classmethod
    def _arrangements(cls, value: object, info: ValidationInfo) -> object:
        warn = info.context != KEPT
        given = value if is_list(value) else [value]
        names = [rename_arrangement(name, warn=warn) for name in given]
        if not names or any(name not in get_args(Arrangement) or names.count(name) > 1 for name in names):
            raise ValueError(f"{shorten(value)}; legal: {_NAMES}, or a list of them, each once")
        return names

    @model_validator(mode="after")
    def _of_a_cradle(self) -> ChainGrid:
        if self.strike is not None and "cradle" not in self.arrangement:
            raise ValueError(f"strike = {shorten(self.strike)}; legal: none without a cradle")
        return self

    def count(self) -> int:
        """Return the number of chains, over all arrangements."""
        return sum(math.prod(map(len, self.axes(name).values())) for name in self.arrangement)

    def axes(self, arrangement: str) -> dict[str, list[float]]:
        """Return the values of every axis for an arrangement.

        The number of strikers is 1 by default for a cradle, and NaN for other arrangements.
        """
        axes = {name: expand_axis(axis or [1.0]) for name, axis in self if name != "arrangement"}
        return axes if arrangement == "cradle" else axes | {"strike": [math.nan]}

    def corners(self) -> Iterator[dict[str, object]]:
        """Yield the fields of `ChainSetup` for the chains that lie at the ends of all axes.

        If any chain on the axes is illegal, at least one of these chains is illegal too.
        """
        for name in self.arrangement:
            for fewest_or_most, end in itertools.product((min, max), (min, max)):
                row = {key: end(values) for key, values in self.axes(name).items()}
                balls = fewest_or_most(self.axes(name)["balls"])
                yield chain_setup_values(name, row | {"balls": balls})


def chain_setup_values(arrangement: str, numbers: Mapping[str, float]) -> dict[str, object]:
    """Return the fields of `ChainSetup` for an arrangement and for its values on all other axes of chains."""
    strike = None if math.isnan(numbers["strike"]) else int(numbers["strike"])
    return {**numbers, "arrangement": arrangement, "balls": int(numbers["balls"]), "strike": strike}
