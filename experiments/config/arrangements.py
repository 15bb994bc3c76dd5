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
A drop of two balls is therefore the collision of `config.grid`, the tapers being m2/m1 and k2/k1.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator

from impact_xval.experiments.config.axes import Strict
from impact_xval.model.columns.column import MAX_BALLS, Column
from impact_xval.model.inputs import E1, EXPONENT, V0

#: Least number of balls: in all but a stack one strikes another.
_FEWEST = {"stack": 1}
#: Arrangements on a table.
_ON_TABLE = ("drop", "stack")


def _positive(default: float, what: str) -> Any:
    return Field(default, gt=0, allow_inf_nan=False, description=f"a finite number > 0 ({what})")


class Arranged(Strict):
    """One column by its arrangement."""

    arrangement: Literal["chain", "cradle", "drop", "stack"] = Field(
        "cradle", description="'chain', 'cradle', 'drop' or 'stack'"
    )
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
            last = _tapered(1.0, taper, info.data["balls"])[-1]
            if not 0 < last < math.inf or not 0 < last * info.data[first] < math.inf:
                raise ValueError(
                    f"{taper!r}: its power {info.data['balls'] - 1}, or {first} = {info.data[first]!r} times that, "
                    "leaves double precision; legal: finite numbers > 0"
                )
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

    def column(self) -> Column:
        """Return the column in kg, N/m^p and m/s; the contact that is struck touches, all others have the gap."""
        table = self.arrangement in _ON_TABLE
        contacts = self.balls - 1 + table
        gaps = [self.gap] * contacts
        gaps[self.striking - 1] = 0.0
        return Column(
            masses=_tapered(self.m, self.mass_taper, self.balls),
            stiffnesses=_tapered(self.k, self.stiffness_taper, contacts),
            restitutions=(self.e,) * contacts,
            velocities=(self.v0,) * self.striking + (0.0,) * (self.balls - self.striking),
            table=table,
            gaps=tuple(gaps),
        )


def _tapered(first: float, taper: float, count: int) -> tuple[float, ...]:
    with np.errstate(over="ignore", under="ignore"):
        return tuple((first * np.power(float(taper), np.arange(count))).tolist())
