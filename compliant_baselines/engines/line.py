"""What an engine is asked to run of a column of N balls: the numbers it needs, without gravity.

Heights are counted from touching: that of ball i above the place where all balls below it only just touch, and the last
one the table, if there is one. Contact i has the gap x_i - x_{i+1}, and the last one on a table x_N.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.mapping import Contact
from impact_xval.compliant_baselines.solver import MappingName, Settings
from impact_xval.model.collision import Collision

#: Most contacts of a column that an engine runs: the states of a run are sets of them, kept as bits.
MOST_CONTACTS = 60


@dataclass(frozen=True, slots=True)
class Line:
    """N balls in a line, ball 1 on top.

    Attributes
    ----------
    masses : tuple of float, length N
        In kg.
    contacts : tuple of Contact
        What is asked of each contact; the last one with the table, if there is one.
    velocities : tuple of float, length N
        In m/s, at t = 0.
    gaps : tuple of float, one a contact
        In m, at t = 0.
    table : bool
        Whether there is a table.
    mapping : str
        How contacts become the engine's own parameters.
    step : float
        Time step in s.
    regularisation : float
        How many times the engine's least regularisation of contacts, where it has any.
    """

    masses: tuple[float, ...]
    contacts: tuple[Contact, ...]
    velocities: tuple[float, ...]
    gaps: tuple[float, ...]
    table: bool
    mapping: MappingName
    step: float
    regularisation: float = 1.0
    gravity: ClassVar[float] = 0.0

    @property
    def weights(self) -> tuple[float, ...]:
        """Masses over that of the first ball."""
        return tuple(m / self.masses[0] for m in self.masses)

    @property
    def rates(self) -> NDArray[np.float64]:
        """Compression rates at t = 0, in m/s, shape (C,)."""
        return np.diff([*self.velocities, *([0.0] if self.table else [])])

    @property
    def speed(self) -> float:
        """Largest compression rate at t = 0, in m/s: what errors are relative to."""
        return float(self.rates.max())

    @property
    def fastest(self) -> float:
        """Largest speed at t = 0, in m/s."""
        return max(map(abs, self.velocities))

    @property
    def period(self) -> float:
        """Shortest of the contact periods asked for, in s."""
        return min(contact.period for contact in self.contacts)

    def depth(self, *stiffnesses: float) -> float:
        """Bound the penetrations in m, given the stiffnesses as the engine has them: all energy in the softest."""
        m, v = np.array(self.masses), np.array(self.velocities)
        mean = 0.0 if self.table else float(m @ v / m.sum())
        return math.sqrt(float(m @ (v - mean) ** 2) / min(stiffnesses))

    def heights(self, radius: float) -> NDArray[np.float64]:
        """Heights at t = 0 in m, shape (N,), rounded so that adding up to 2 N radii rounds nothing away."""
        far = 2.0 ** math.ceil(math.log2(2 * len(self.masses) * radius))
        below = [*self.gaps, *([] if self.table else [0.0])]
        return (np.cumsum(below[::-1])[::-1] + far) - far


def line_of(column: Collision, settings: Settings) -> Line:
    """Set a column up at the time step of the settings: its share of the shortest contact period.

    Raises
    ------
    ValueError
        For a restitution of 0.
    """
    inverse = [*(1 / m for m in column.masses), *([0.0] if column.table else [])]
    contacts = tuple(
        Contact.from_restitution(k, e, 1 / (inverse[i] + inverse[i + 1]), settings.mapping)
        for i, (k, e) in enumerate(zip(column.stiffnesses, column.restitutions, strict=True))
    )
    return Line(
        masses=column.masses,
        contacts=contacts,
        velocities=column.velocities,
        gaps=column.gaps,
        table=column.table,
        mapping=settings.mapping,
        step=float(settings.step_fraction * min(contact.period for contact in contacts)),
    )


def unrepresentable_column(column: Collision) -> str | None:
    """Why no engine represents this column, in one sentence; None if one may."""
    if column.exponent != 1:
        return (
            f"exponent = {column.exponent!r}: the contacts of an engine are linear springs and dashpots; legal: 1 "
            "(the references kelvin-voigt, hunt-crossley and bistiffness have others)"
        )
    for i, e in enumerate(column.restitutions, 1):
        if e == 0:
            return f"restitutions[{i}] = 0.0: no finite damping is perfectly plastic; legal: greater than 0, at most 1"
    if len(column.stiffnesses) > MOST_CONTACTS:
        return f"{len(column.stiffnesses)} contacts: engines run columns of up to {MOST_CONTACTS}"
    return None
