"""The vocabulary of columns: `Column` is what is solved, `ColumnOutcome` what any solver gives.

`ColumnPath` is the way there. Nothing here computes a column.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.collision import Status, html_table
from impact_xval.model.inputs import Legal
from impact_xval.model.kinetic import column_norm

#: Most balls of a column.
MAX_BALLS = 1000

_LEAST, _LARGEST = math.ulp(0.0), float(np.finfo(float).max)
_MASSES = Legal("masses", _LEAST, _LARGEST, "finite numbers > 0 (kg)")
_STIFFNESSES = Legal("stiffnesses", _LEAST, _LARGEST, "finite numbers > 0 (N/m)")
_RESTITUTIONS = Legal("restitutions", 0.0, 1.0, "from 0 to 1")
_VELOCITIES = Legal("velocities", -_LARGEST, _LARGEST, "finite numbers (m/s, up is positive)")
_GAPS = Legal("gaps", 0.0, _LARGEST, "finite numbers >= 0 (m)")


@dataclass(frozen=True, slots=True)
class Column:
    """N balls in a line, each touching the next, ball 1 on top; with a table, ball N touches it. Up is positive.

    Contact i is between balls i and i + 1; with a table, contact N is between ball N and the table.

    Parameters
    ----------
    masses : sequence of float, length N
        In kg; positive, finite. N is from 1 to `MAX_BALLS`.
    stiffnesses : sequence of float, one a contact
        N - 1 of them, or N with a table: k_i of F = k_i delta^p, in N/m^p; positive, finite.
    restitutions : sequence of float, one a contact
        Coefficients of energetic restitution, from 0 (perfectly plastic) to 1 (elastic).
    velocities : sequence of float, length N
        At first touch, in m/s; finite. At least one ball approaches the next, or ball N the table.
    table : bool
        Whether there is a fixed table below ball N.
    gaps : sequence of float, one a contact
        Distances of the bodies of each contact at first, in m; not negative. None by default. Only solvers with
        positions know them.

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

    def __post_init__(self) -> None:
        table = cast(object, self.table)
        if not isinstance(table, bool):
            raise ValueError(f"table = {table!r}; legal: True or False")
        for legal in (_MASSES, _STIFFNESSES, _RESTITUTIONS, _VELOCITIES, _GAPS):
            object.__setattr__(self, legal.name, _numbers(legal, getattr(self, legal.name)))
        balls = len(self.masses)
        if not 1 <= balls <= MAX_BALLS:
            raise ValueError(f"masses: {balls} balls; legal: from 1 to {MAX_BALLS}")
        contacts = balls - 1 + self.table
        if not self.gaps:
            object.__setattr__(self, "gaps", (0.0,) * contacts)
        lengths = {"velocities": balls, "stiffnesses": contacts, "restitutions": contacts, "gaps": contacts}
        for name, length in lengths.items():
            given = len(getattr(self, name))
            if given != length:
                on = "on a table" if self.table else "without a table"
                raise ValueError(f"{name}: {given} values; legal: {length}, for {balls} balls {on}")
        if not any(rate > 0 for rate in self.compression_rates):
            raise ValueError(
                f"velocities = {self.velocities!r}: nothing meets; legal: a ball is slower than the next below it"
                + (", or the last one falls on the table" if self.table else "")
            )

    @property
    def compression_rates(self) -> tuple[float, ...]:
        """w_i = v_{i+1} - v_i of each contact at first touch, in m/s; -v_N at the table."""
        below = (*self.velocities, 0.0) if self.table else self.velocities
        return tuple(lower - upper for upper, lower in pairwise(below))

    @property
    def mean_velocity(self) -> float:
        """Velocity of the centre of mass at first touch, in m/s."""
        _, power = math.frexp(max(self.masses))
        masses = [math.ldexp(m, -power) for m in self.masses]  # whose sum is finite, and no bit another
        return float(np.dot(masses, self.velocities)) / math.fsum(masses)

    def reversed(self) -> Column:
        """Return the column seen from below, if it has no table: order of balls and sign of velocities reversed."""
        if self.table:
            raise ValueError("table = True: a column on a table has no reverse; legal: False")
        return Column(
            self.masses[::-1],
            self.stiffnesses[::-1],
            self.restitutions[::-1],
            tuple(-v for v in reversed(self.velocities)),
            gaps=self.gaps[::-1],
        )


def _numbers(legal: Legal, values: object) -> tuple[float, ...]:
    """Return the values of a field as numbers; the message of a refusal counts them from 1."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise ValueError(f"{legal.name} = {values!r}: not a sequence of numbers; legal: {legal.text}")
    each = enumerate(cast("Iterable[object]", values), 1)
    return tuple(legal._replace(name=f"{legal.name}[{i}]").number(value) for i, value in each)


#: A column that every solver answers at once: one ball strikes another.
ORDINARY = Column((1.0, 1.0), (1e8,), (0.9,), (-1.0, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class ColumnPath:
    """A column along its way: n points in the order of time, some of them at one instant.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Since first touch, in s; of the model that of positions that stay frozen.
    velocities : ndarray, shape (n, N)
        In m/s.
    impulses, forces : ndarray, shape (n, C)
        Accumulated impulses in N s, and forces in N; of a contact that has become rigid, what it passes on. Forces of
        an engine are means since the point before.
    acting : ndarray of bool, shape (n, C)
        Which contacts act from here on; one that has become rigid does.
    """

    time: NDArray[np.float64]
    velocities: NDArray[np.float64]
    impulses: NDArray[np.float64]
    forces: NDArray[np.float64]
    acting: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ColumnOutcome:
    """The result of one column by any solver.

    Attributes
    ----------
    solver : str
        Name of the solver.
    velocities : tuple of float, length N
        When no contact acts any more, in m/s; NaN only with a status that explains it.
    impulses : tuple of float, one a contact
        Total impulses in N s.
    states : tuple of tuple of int
        The sets of contacts that act, in their order, each as the numbers of its contacts from 1, the last one empty;
        nothing where it was not asked for.
    status, reason
        As in `model.Outcome`.
    grazing_margin : float or None
        How near the column came to a jump of the model's outcome: the smallest magnitude of a compression rate that
        turned around while its contact acted, per the largest one since it last did (docs/columns.md, section 3).
        Infinity if none did, None if not computed.
    marked : str
        As in `model.Outcome`.
    n_events : int
        Number of events.
    diagnostics : mapping of str to float
        Further numbers a solver wishes to state.
    path : ColumnPath or None
        The way there, if asked for.
    """

    solver: str
    velocities: tuple[float, ...]
    impulses: tuple[float, ...]
    states: tuple[tuple[int, ...], ...] = ()
    status: Status = "ok"
    reason: str = ""
    grazing_margin: float | None = None
    marked: str = ""
    n_events: int = 0
    diagnostics: Mapping[str, float] = field(default_factory=dict[str, float])
    path: ColumnPath | None = None

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        velocities = ((f"v{i} (m/s)", v) for i, v in enumerate(self.velocities, 1))
        impulses = ((f"impulse of contact {i} (N s)", value) for i, value in enumerate(self.impulses, 1))
        return html_table(
            self.solver,
            (
                ("status", self.status),
                ("reason", self.reason),
                *velocities,
                *impulses,
                ("states", len(self.states) or None),
                ("grazing margin", self.grazing_margin),
                ("marked", self.marked),
            ),
        )

    def retained_energy(self, column: Column) -> float:
        """Kinetic energy after the collision over that before it, dimensionless."""
        before, after = (column_norm(column.masses, each.velocities) for each in (column, self))
        return (after / before) ** 2

    def retained_momentum(self, column: Column) -> float:
        """Momentum after the collision over that before it, dimensionless: 1 without a table."""
        weights = np.array(column.masses) / max(column.masses)
        return float(weights @ self.velocities / (weights @ column.velocities))

    @classmethod
    def failure(cls, solver: str, column: Column, status: Status, reason: str) -> ColumnOutcome:
        """Record that a solver gave no result, and why."""
        unknown = (math.nan,)
        return cls(
            solver,
            unknown * len(column.masses),
            unknown * len(column.stiffnesses),
            status=status,
            reason=reason,
        )
