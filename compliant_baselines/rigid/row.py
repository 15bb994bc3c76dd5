r"""A column as a rigid law sees it: rates of separation and the impulses that change them.

All contacts touch. Contact i has the rate of separation u_i = v_i - v_{i+1} (u_N = v_N at a table), the negative of the
compression rate w_i of docs/columns.md, and an impulse p_i >= 0. With the masses M and u = W^T v,

    M (v+ - v-) = W p,    u+ = u- + G p,    G = W^T M^-1 W  (the Delassus matrix).

In a line G is tridiagonal, G_ii = 1/m_i + 1/m_{i+1} (1/m_N at the table) and G_{i,i+1} = -1/m_{i+1}, and positive
definite: no impulses but none leave all velocities as they are (Glocker, Set-Valued Force Laws, Springer 2001).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.columns.column import Column

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Row:
    """A column in units of its own, which are powers of two: no bit of a result depends on them.

    Attributes
    ----------
    inverse_masses : ndarray, shape (N,)
        1/m_i; the heaviest ball's is from 1 to 2.
    velocities : ndarray, shape (N,)
        Before the impact; the largest magnitude is from 1/2 to 1.
    restitutions : ndarray, shape (C,)
        e_i.
    table : bool
        Whether the last contact is with a table.
    mass_power, velocity_power : int
        Two to these powers are the units, in kg and in m/s.
    """

    inverse_masses: Floats
    velocities: Floats
    restitutions: Floats
    table: bool
    mass_power: int
    velocity_power: int

    @classmethod
    def of(cls, column: Column) -> Row:
        """Set a column up; inverse masses beyond double precision are infinite."""
        _, mass = math.frexp(max(column.masses))
        _, velocity = math.frexp(max(map(abs, column.velocities)))
        with np.errstate(over="ignore", divide="ignore"):
            inverse = 1 / np.ldexp(np.array(column.masses), -mass)
        velocities = np.ldexp(np.array(column.velocities), -velocity)
        return cls(inverse, velocities, np.array(column.restitutions), column.table, mass, velocity)

    @property
    def rates(self) -> Floats:
        """u_i before the impact, shape (C,)."""
        below = np.append(self.velocities, 0.0) if self.table else self.velocities
        return -np.diff(below)

    @property
    def delassus(self) -> Floats:
        """G, shape (C, C)."""
        n = len(self.restitutions)
        below = np.append(self.inverse_masses, 0.0)[1 : n + 1]
        shared = below[:-1]
        return np.diag(self.inverse_masses[:n] + below) - np.diag(shared, 1) - np.diag(shared, -1)

    def velocities_after(self, rates: Floats, impulses: Floats) -> tuple[float, ...]:
        """Give the velocities that have these rates of separation, in m/s, ball 1 first.

        They are summed up and down from what moves least, the table or else the heaviest ball: so rates that are not
        negative leave v_1 >= v_2 >= ... to the last bit, and a light ball does not have the rounding of a heavy one.

        Parameters
        ----------
        rates, impulses : ndarray, shape (C,)
            u_i after the impact and p_i, in the row's units.
        """
        balls = len(self.velocities)
        if self.table:
            fixed, v = balls, [*[0.0] * balls, 0.0]
        else:
            fixed = int(np.argmin(self.inverse_masses))
            p = [0.0, *impulses.tolist(), 0.0]
            v = [0.0] * balls
            v[fixed] = float(self.velocities[fixed] + (p[fixed + 1] - p[fixed]) * self.inverse_masses[fixed])
        for i in range(fixed - 1, -1, -1):
            v[i] = v[i + 1] + float(rates[i])
        for upper, lower in pairwise(range(fixed, balls)):
            v[lower] = v[upper] - float(rates[upper])
        return tuple(math.ldexp(one, self.velocity_power) for one in v[:balls])

    def impulses_after(self, impulses: Floats) -> tuple[float, ...]:
        """Give impulses of the row's units in N s."""
        return tuple(math.ldexp(one, self.mass_power + self.velocity_power) for one in impulses.tolist())
