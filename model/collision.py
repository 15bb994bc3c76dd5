"""One collision of N balls in a line (`Collision`), and the units that scale it (`Units`).

A `Collision` holds and checks the input of a solver. `model.collisions` has many collisions as arrays.

Needs `model.inputs` for the legal ranges. Used by every solver.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np

from impact_xval.model.arrays import Floats
from impact_xval.model.inputs import (
    EXPONENT,
    LINE,
    MASS_RATIO,
    STIFFNESS_RATIO,
    STIFFNESSES_WITH_LIMITS,
    TWO_BALLS,
    Legal,
)

#: Largest number of balls of a collision.
MAX_BALLS = 1000


def legal_fields(balls: int, table: bool) -> Iterator[tuple[Legal, int]]:
    """Yield the legal range and the expected length of each field with one number per ball or per contact."""
    masses, stiffnesses, *remaining = LINE
    if table and balls == 2:
        stiffnesses = STIFFNESSES_WITH_LIMITS
    contacts = balls - 1 + table
    lengths = (balls, contacts, contacts, balls, contacts)
    return zip((masses, stiffnesses, *remaining), lengths, strict=True)


def scaling_units(
    masses: Floats, stiffnesses: Floats, rates: Floats, exponent: float
) -> tuple[Floats, Floats]:
    """Return the units of time (s) and of velocity (m/s) that scale n collisions as `Units` does; each of shape (n,).

    `masses` has the shape (n, N). `stiffnesses` and the rates of compression `rates` have the shape (n, C).
    """
    speed = np.abs(rates).max(axis=1)
    with np.errstate(over="ignore", divide="ignore"):
        time = (masses[:, 0] / stiffnesses[:, 0] * speed ** (1 - exponent)) ** (1 / (exponent + 1))
    return time, speed


class Units(NamedTuple):
    """Units in which a collision has m1 = 1, k1 = 1 and the largest rate of compression 1 (Theorem 5 of the paper)."""

    #: Unit of time in s. With linear contacts it is sqrt(m1/k1), which is infinite if k1 is 0.
    time: float
    #: Unit of velocity in m/s: the largest rate of compression at first touch. For two balls on a table it is abs(v0).
    velocity: float
    #: Unit of impulse in N s: m1 times the unit of velocity.
    impulse: float


@dataclass(frozen=True, slots=True)
class Collision:
    """Collision of N balls in a line, from ball 1 at the top to ball N at the bottom. Up is positive.

    Contact i is between balls i and i + 1. If there is a table, contact N is between ball N and the table. The problem
    of the paper is two balls on a table (`two_balls`).

    Parameters
    ----------
    masses : sequence of float, length N
        Masses in kg; positive, finite. N is from 1 to `MAX_BALLS`.
    stiffnesses : sequence of float, length N - 1, or N with a table
        Stiffnesses k_i of the contact forces F = k_i delta^p, in N/m^p; positive, finite. Two balls on a table may also
        have the stiffnesses 0 and infinity, as limiting cases, but k2/k1 must not be 0/0 or inf/inf.
    restitutions : sequence of float, one per contact
        Coefficients of energetic restitution, from 0 (perfectly plastic) to 1 (elastic).
    velocities : sequence of float, length N
        Velocities at first touch, in m/s; finite. At least one ball has to approach the next ball, or ball N the table.
    table : bool
        Whether there is a fixed table below ball N.
    gaps : sequence of float, one per contact
        Distance between the bodies of each contact at the start, in m; not negative. By default there are no gaps. Only
        solvers that follow positions accept gaps; the model refuses them.
    exponent : float
        Exponent p of the contact forces, from 1 (linear) to 3; Hertz's contact has 1.5.

    Raises
    ------
    ValueError
        For an illegal value; the message names the field, the value and the legal range.
    """

    masses: tuple[float, ...]
    stiffnesses: tuple[float, ...]
    restitutions: tuple[float, ...]
    velocities: tuple[float, ...]
    table: bool = False
    gaps: tuple[float, ...] = ()
    exponent: float = 1.0

    def __post_init__(self) -> None:
        if type(self.table) is not bool:
            raise ValueError(f"table = {self.table!r}; legal: True or False")
        object.__setattr__(self, "exponent", EXPONENT.number(self.exponent))
        masses, *_ = LINE
        balls = len(_numbers(masses, self.masses))
        if not 1 <= balls <= MAX_BALLS:
            raise ValueError(f"masses: {balls} balls; legal: from 1 to {MAX_BALLS}")
        for legal, length in legal_fields(balls, self.table):
            numbers = _numbers(legal, getattr(self, legal.name))
            if legal.name == "gaps":
                numbers = numbers or (0.0,) * length
            if len(numbers) != length:
                table = "on a table" if self.table else "without a table"
                raise ValueError(
                    f"{legal.name}: {len(numbers)} values; legal: {length}, for {balls} balls {table}"
                )
            object.__setattr__(self, legal.name, numbers)
        if self.table and balls == 2:
            _check_ratios(*self.masses, *self.stiffnesses)
        if not any(rate > 0 for rate in self.compression_rates):
            raise ValueError(
                f"velocities = {self.velocities!r}: nothing meets; legal: a ball is slower than the next below it"
                + (", or the last one falls on the table" if self.table else "")
            )

    @classmethod
    def two_balls(
        cls, m1: float, m2: float, k1: float, k2: float, e1: float, e2: float, v0: float = -1.0
    ) -> Collision:
        """Make the collision of two balls on a table: B1 falls onto B2, which is at rest.

        Contact 1 is between the balls, and contact 2 is between B2 and the table.

        Parameters
        ----------
        m1, m2 : float
            Masses of B1 and B2 in kg; positive, finite.
        k1, k2 : float
            Stiffnesses in N/m, from 0 to infinity; k2/k1 must not be 0/0 or inf/inf.
        e1, e2 : float
            Coefficients of energetic restitution, from 0 (perfectly plastic) to 1 (elastic).
        v0 : float
            Velocity of B1 when it touches B2, in m/s; negative, finite.

        Raises
        ------
        ValueError
            For an illegal value; the message names the parameter, the value and the legal range.
        """
        given = zip(TWO_BALLS, (m1, m2, k1, k2, e1, e2, v0), strict=True)
        m1, m2, k1, k2, e1, e2, v0 = (legal.number(value) for legal, value in given)
        return cls((m1, m2), (k1, k2), (e1, e2), (v0, 0.0), table=True)

    @classmethod
    def from_ratios(cls, stiffness_ratio: float, mass_ratio: float, e1: float, e2: float) -> Collision:
        r"""Make a collision of two balls on a table with m1 = 1 kg, k1 = 1 N/m and v0 = -1 m/s.

        By Theorem 5 of the paper, the outcome divided by \|v0\| depends only on the four parameters below.

        Parameters
        ----------
        stiffness_ratio : float
            k2/k1, from 0 to infinity.
        mass_ratio : float
            m2/m1, positive, finite.
        e1, e2 : float
            Coefficients of energetic restitution, from 0 to 1.

        Raises
        ------
        ValueError
            For an illegal value; the message names the parameter, the value and the legal range.
        """
        ratio, mass = STIFFNESS_RATIO.number(stiffness_ratio), MASS_RATIO.number(mass_ratio)
        return cls.two_balls(m1=1.0, m2=mass, k1=1.0, k2=ratio, e1=e1, e2=e2)

    m1 = property(lambda self: self.masses[0], doc="Mass of ball 1, in kg.")
    m2 = property(lambda self: self.masses[1], doc="Mass of ball 2, in kg.")
    k1 = property(lambda self: self.stiffnesses[0], doc="Stiffness of contact 1, in N/m.")
    k2 = property(lambda self: self.stiffnesses[1], doc="Stiffness of contact 2, in N/m.")
    e1 = property(lambda self: self.restitutions[0], doc="Restitution of contact 1.")
    e2 = property(lambda self: self.restitutions[1], doc="Restitution of contact 2.")
    v0 = property(lambda self: self.velocities[0], doc="Velocity of ball 1 at first touch, in m/s.")

    @property
    def falls_on_resting(self) -> bool:
        """Whether this is the problem of the paper: B1 falls on B2, which rests on a table, with linear contacts."""
        first, *below = self.velocities
        is_linear_and_closed = self.exponent == 1 and not any(self.gaps)
        return is_linear_and_closed and self.table and below == [0.0] and first < 0

    @property
    def compression_rates(self) -> tuple[float, ...]:
        """Rates of compression w_i = v_{i+1} - v_i of all contacts at first touch, in m/s; -v_N at the table."""
        below = (*self.velocities, 0.0) if self.table else self.velocities
        return tuple(lower - upper for upper, lower in pairwise(below))

    @property
    def stiffness_ratio(self) -> float:
        """Stiffness ratio k2/k1, from 0 to infinity."""
        return math.inf if self.k1 == 0 else self.k2 / self.k1

    @property
    def mass_ratio(self) -> float:
        """Mass ratio m2/m1."""
        return self.m2 / self.m1

    @property
    def units(self) -> Units:
        """Units of time, velocity and impulse that scale this collision."""
        masses, stiffnesses = np.array([self.masses]), np.array([self.stiffnesses])
        rates = np.array([self.compression_rates])
        times, speeds = scaling_units(masses, stiffnesses, rates, self.exponent)
        speed = float(speeds[0])
        return Units(float(times[0]), speed, self.m1 * speed)

    def reversed(self) -> Collision:
        """Return the mirror image of a collision without a table: the order of balls and all velocities reversed."""
        if self.table:
            raise ValueError("table = True: a chain on a table has no reverse; legal: False")
        return replace(
            self,
            masses=self.masses[::-1],
            stiffnesses=self.stiffnesses[::-1],
            restitutions=self.restitutions[::-1],
            velocities=tuple(-v for v in self.velocities[::-1]),
            gaps=self.gaps[::-1],
        )


def _numbers(legal: Legal, values: object) -> tuple[float, ...]:
    """Return the values of a field as floats; a ValueError names the place of the first illegal value, from 1."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise ValueError(f"{legal.name} = {values!r}: not a sequence of numbers; legal: {legal.text}")
    items = cast("Iterable[object]", values)
    return tuple(legal._replace(name=f"{legal.name}[{i}]").number(item) for i, item in enumerate(items, 1))


def _check_ratios(m1: float, m2: float, k1: float, k2: float) -> None:
    """Raise a ValueError if k2/k1 is undefined, or if m2/m1 is too large or too small for double precision."""
    if k1 == k2 and (k1 == 0 or math.isinf(k1)):
        raise ValueError(
            f"stiffness ratio: k2 = {k2!r} over k1 = {k1!r} is undefined; "
            "legal: k2/k1 from 0 to inf, not 0/0 or inf/inf"
        )
    if not 0 < m2 / m1 < math.inf:
        raise ValueError(
            f"mass ratio: m2 = {m2!r} over m1 = {m1!r} leaves double precision; legal: finite, > 0"
        )
