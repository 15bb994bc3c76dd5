"""Columns as people set them up, each by a few numbers: a chain, a cradle, a drop, a stack.

`chain`
    ball 1 strikes a row of N - 1 balls at rest;
`cradle`
    j balls strike N - j at rest;
`drop`
    ball 1 falls on a stack of N - 1 balls that rests on a table;
`stack`
    N balls fall together onto a table.

Masses and stiffnesses taper from the top: of every next ball and contact they are so many times those of the one above.
A drop of two balls is therefore the cell of two balls, the tapers being m2/m1 and k2/k1.
"""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

import numpy as np
from pydantic import Field, field_validator, model_validator

from impact_xval.experiments.config.axes import (
    MAX_CELLS,
    Axis,
    Strict,
    axis_length,
    axis_problem,
    expand_axis,
)
from impact_xval.experiments.config.errors import short
from impact_xval.model.collision import MAX_BALLS, Collision
from impact_xval.model.inputs import E1, EXPONENT, V0, Legal

Arrangement = Literal["chain", "cradle", "drop", "stack"]

#: Least number of balls: in all but a stack one strikes another.
_FEWEST = {"stack": 1}
#: Arrangements on a table.
_ON_TABLE = ("drop", "stack")

_NAMES = "'chain', 'cradle', 'drop' or 'stack'"
_LEAST, _LARGEST = math.ulp(0.0), float(np.finfo(float).max)

#: What is legal on the axes of columns, in their order: the first varies slowest.
COLUMN_LEGAL = {
    legal.name: legal
    for legal in (
        Legal("balls", 1, MAX_BALLS, f"a whole number from 2 (a stack: 1) to {MAX_BALLS}"),
        Legal("strike", 1, MAX_BALLS - 1, "a whole number from 1 to balls - 1, of a cradle only"),
        EXPONENT,
        Legal("mass_taper", _LEAST, _LARGEST, "a finite number > 0 (m_(i+1)/m_i)"),
        Legal("stiffness_taper", _LEAST, _LARGEST, "a finite number > 0 (k_(i+1)/k_i)"),
        Legal("gap", 0.0, _LARGEST, "a finite number >= 0 (m)"),
        E1._replace(name="e"),
    )
}
_WHOLE = ("balls", "strike")

#: By what columns are grouped, and how a reader knows it.
COLUMN_AXES = {
    "balls": "balls",
    "arrangement": "arrangement",
    "strike": "strikers",
    "e": "e",
    "exponent": "exponent",
    "mass_taper": "mass taper",
    "stiffness_taper": "stiffness taper",
    "gap": "gap in m",
}


def _positive(default: float, what: str) -> Any:
    return Field(default, gt=0, allow_inf_nan=False, description=f"a finite number > 0 ({what})")


def _axis(name: str, default: Axis | None) -> Any:
    return Field(default, description=COLUMN_LEGAL[name].text)


class Arranged(Strict):
    """One column by its arrangement."""

    arrangement: Arrangement = Field("cradle", description=_NAMES)
    balls: int = Field(5, description=f"a whole number from 2 (a stack: 1) to {MAX_BALLS}")
    strike: int | None = Field(None, description="a whole number from 1 to balls - 1, of a cradle only")
    e: float = Field(0.95, ge=E1.low, le=E1.high, description=E1.text)
    exponent: float = Field(1.0, ge=EXPONENT.low, le=EXPONENT.high, description=EXPONENT.text)
    gap: float = Field(0.0, ge=0, allow_inf_nan=False, description="a finite number >= 0 (m)")
    m: float = _positive(1.0, "kg")
    mass_taper: float = _positive(1.0, "m_(i+1)/m_i")
    k: float = _positive(1e8, "N/m^p")
    stiffness_taper: float = _positive(1.0, "k_(i+1)/k_i")
    v0: float = Field(-1.0, lt=0, allow_inf_nan=False, description=V0.text)

    @field_validator("balls")
    @classmethod
    def _something_meets(cls, balls: int, info: Any) -> int:
        name = info.data.get("arrangement", "stack")
        fewest = _FEWEST.get(name, 2)
        if not fewest <= balls <= MAX_BALLS:
            raise ValueError(f"{balls}; legal: a whole number from {fewest} to {MAX_BALLS}, for a {name}")
        return balls

    @field_validator("strike")
    @classmethod
    def _some_rest(cls, strike: int | None, info: Any) -> int | None:
        name, balls = info.data.get("arrangement"), info.data.get("balls")
        if strike is None or name is None or balls is None:
            return strike
        if name != "cradle":
            raise ValueError(f"{strike}; legal: none for a {name}, it is of a cradle")
        if not 1 <= strike < balls:
            raise ValueError(f"{strike}; legal: a whole number from 1 to {balls - 1}, for {balls} balls")
        return strike

    @field_validator("mass_taper", "stiffness_taper")
    @classmethod
    def _within_double_precision(cls, taper: float, info: Any) -> float:
        first = "m" if info.field_name == "mass_taper" else "k"
        if {first, "balls"} <= info.data.keys():
            problem = taper_problem(taper, info.data["balls"], first, info.data[first])
            if problem:
                raise ValueError(problem)
        return taper

    @field_validator("v0")
    @classmethod
    def _finite_impulse(cls, v0: float, info: Any) -> float:
        m = info.data.get("m", 1.0)
        if not 0 < m * abs(v0) < math.inf:
            raise ValueError(
                f"{v0!r}: m = {m!r} times |v0| leaves double precision; legal: a finite product > 0 "
                "(the unit of impulses)"
            )
        return v0

    @property
    def striking(self) -> int:
        """Number of balls that move at first; the contact below them, of this number, is struck."""
        if self.arrangement == "stack":
            return self.balls
        return self.strike or 1

    def column(self) -> Collision:
        """Return the column in kg, N/m^p and m/s; the contact that is struck touches, all others have the gap."""
        table = self.arrangement in _ON_TABLE
        contacts = self.balls - 1 + table
        gaps = [self.gap] * contacts
        gaps[self.striking - 1] = 0.0
        return Collision(
            masses=_tapered(self.m, self.mass_taper, self.balls),
            stiffnesses=_tapered(self.k, self.stiffness_taper, contacts),
            restitutions=(self.e,) * contacts,
            velocities=(self.v0,) * self.striking + (0.0,) * (self.balls - self.striking),
            table=table,
            gaps=tuple(gaps),
            exponent=self.exponent,
        )


class ColumnTable(Strict):
    """Axes of columns of N balls, each a number, a list or as those of a grid."""

    arrangement: list[Arrangement] = Field(
        ["cradle", "drop", "stack"], description=f"{_NAMES}, or a list of them"
    )
    balls: Axis = _axis("balls", [2.0, 3.0, 5.0, 10.0])
    strike: Axis | None = _axis("strike", None)
    exponent: Axis = _axis("exponent", [1.0])
    mass_taper: Axis = _axis("mass_taper", [1.0])
    stiffness_taper: Axis = _axis("stiffness_taper", [0.8, 1.0, 1.25])
    gap: Axis = _axis("gap", [0.0])
    e: Axis = _axis("e", [0.5, 0.6, 0.7, 0.8, 0.9, 1.0])

    @field_validator("arrangement", mode="before")
    @classmethod
    def _arrangements(cls, value: object) -> object:
        names = value if isinstance(value, list) else [value]
        for name in names:
            if not isinstance(name, str) or name not in get_args(Arrangement):
                raise ValueError(f"{short(name)}; legal: {_NAMES}")
        if not names or len(set(names)) < len(names):
            raise ValueError(f"{short(value)}; legal: one or more of {_NAMES}, each once")
        return names

    @field_validator(*COLUMN_LEGAL, mode="before")
    @classmethod
    def _legal_axis(cls, value: object, info: Any) -> object:
        if value is None and info.field_name == "strike":
            return None
        legal = COLUMN_LEGAL[info.field_name]
        axis: Any = value if isinstance(value, (list, dict)) else [value]
        problem = axis_problem(legal, axis)
        if problem:
            raise ValueError(problem)
        if legal.name in _WHOLE:
            broken = [number for number in expand_axis(axis) if not number.is_integer()]
            if broken:
                raise ValueError(f"{broken[0]!r}; legal: {legal.text}")
        return axis

    @model_validator(mode="after")
    def _something_meets(self) -> ColumnTable:
        fewest_given = int(min(expand_axis(self.balls)))
        for name in self.arrangement:
            fewest = _FEWEST.get(name, 2)
            if fewest_given < fewest:
                legal = f"legal: a whole number from {fewest} to {MAX_BALLS}, for a {name}"
                raise ValueError(f"balls = {fewest_given}; {legal}")
        if self.strike is not None:
            most = int(max(expand_axis(self.strike)))
            if "cradle" not in self.arrangement:
                raise ValueError(f"strike = {most}; legal: none without a cradle, it is of one only")
            if most >= fewest_given:
                legal = f"legal: a whole number from 1 to {fewest_given - 1}, for {fewest_given} balls"
                raise ValueError(f"strike = {most}; {legal}")
        if self.columns() > MAX_CELLS:
            raise ValueError(f"the axes make {self.columns()} columns; legal: 1 to {MAX_CELLS}")
        return self

    def columns(self) -> int:
        """Count the columns of all arrangements."""
        return sum(math.prod(map(len, self.axes(name).values())) for name in self.arrangement)

    def lengths(self) -> dict[str, int]:
        """Count the values of every axis that is there, the arrangements among them."""
        axes = {name: getattr(self, name) for name in COLUMN_LEGAL}
        there = {name: axis_length(axis) for name, axis in axes.items() if axis is not None}
        return {"arrangement": len(self.arrangement)} | there

    def axes(self, arrangement: str) -> dict[str, list[float]]:
        """Values of every axis of an arrangement, the first varies slowest; strikers are NaN in what is no cradle."""
        axes = {name: expand_axis(getattr(self, name) or [1.0]) for name in COLUMN_LEGAL}
        return axes if arrangement == "cradle" else axes | {"strike": [math.nan]}

    def taper_problem(self, m: float, k: float) -> str | None:
        """Say that masses or stiffnesses, tapered from these, leave double precision, or return None."""
        balls = int(max(expand_axis(self.balls)))
        for name, first, value in (("mass_taper", "m1", m), ("stiffness_taper", "k1", k)):
            for taper in expand_axis(getattr(self, name)):
                problem = taper_problem(taper, balls, first, value)
                if problem:
                    return f"column.{name} = {problem}"
        return None


def taper_problem(taper: float, balls: int, first: str, value: float) -> str | None:
    """Write that the last of so many tapered masses or stiffnesses leaves double precision, or return None."""
    last = _tapered(1.0, taper, balls)[-1]
    if 0 < last < math.inf and 0 < last * value < math.inf:
        return None
    return (
        f"{taper!r}: its power {balls - 1}, or {first} = {value!r} times that, leaves double precision; "
        "legal: finite numbers > 0"
    )


def _tapered(first: float, taper: float, count: int) -> tuple[float, ...]:
    with np.errstate(over="ignore", under="ignore"):
        return tuple((first * np.power(float(taper), np.arange(count))).tolist())
