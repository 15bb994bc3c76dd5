"""Many collisions with the same number of balls, as arrays: `Collisions`.

Needs `model.collision` and `model.inputs`. Used by every solver of arrays of collisions.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from impact_xval.model.arrays import Booleans, Floats, Rows
from impact_xval.model.collision import Collision, legal_fields, scaling_units
from impact_xval.model.inputs import LINE, RATIOS, checked_array


@dataclass(frozen=True, slots=True, eq=False)
class Collisions(Sequence[Collision]):
    """Collisions of N balls each, as read-only arrays. Item `[i]` is the `Collision` number i.

    The number C of contacts is N - 1, or N on a table.

    Attributes
    ----------
    masses, velocities : ndarray, shape (n, N)
        Masses in kg, and velocities at first touch in m/s.
    stiffnesses, restitutions, gaps : ndarray, shape (n, C)
        Stiffnesses in N/m^p, coefficients of restitution, and gaps in m.
    table : bool
        Whether all collisions are on a table, or none.
    exponent : float
        Exponent p of all contact forces.

    Raises
    ------
    ValueError
        If a value is illegal; the message names field, row, value and legal range.
    """

    masses: Floats
    stiffnesses: Floats
    restitutions: Floats
    velocities: Floats
    table: bool
    gaps: Floats
    exponent: float = 1.0

    def __post_init__(self) -> None:
        n, balls = self.masses.shape
        for legal, width in legal_fields(balls, self.table):
            array = checked_array(legal, getattr(self, legal.name)).view()
            if array.shape != (n, width):
                raise ValueError(f"{legal.name} has the shape {array.shape}; legal: {(n, width)}")
            array.flags.writeable = False
            object.__setattr__(self, legal.name, array)
        resting = np.flatnonzero(~(self.compression_rates > 0).any(axis=1))
        if resting.size:
            raise ValueError(
                f"velocities of row {resting[0]}: nothing meets; legal: some contact is compressed"
            )

    @classmethod
    def of(cls, collisions: Iterable[Collision]) -> Collisions:
        """Make arrays from collisions with the same number of balls and the same exponent, all or none with a table."""
        if isinstance(collisions, cls):
            return collisions
        rows = list(collisions)
        kinds = {(len(c.masses), c.table, c.exponent) for c in rows} or {(2, True, 1.0)}
        if len(kinds) > 1:
            raise ValueError(
                f"collisions of {len(kinds)} kinds; legal: one number of balls, table and exponent"
            )
        ((balls, table, exponent),) = kinds
        arrays = {
            legal.name: np.array([getattr(c, legal.name) for c in rows], float).reshape(len(rows), width)
            for legal, width in legal_fields(balls, table)
        }
        return cls(**arrays, table=table, exponent=exponent)

    @classmethod
    def from_ratios(
        cls, stiffness_ratio: ArrayLike, mass_ratio: ArrayLike, e1: ArrayLike, e2: ArrayLike
    ) -> Collisions:
        """Make collisions of two balls on a table with m1 = 1 kg, k1 = 1 N/m and v0 = -1 m/s.

        The arguments are arrays of the arguments of `Collision.from_ratios`. They are broadcast and flattened.
        """
        arrays = np.broadcast_arrays(*map(checked_array, RATIOS, (stiffness_ratio, mass_ratio, e1, e2)))
        kappa, mu, e1, e2 = map(np.ravel, arrays)
        ones, zeros = np.ones_like(mu), np.zeros_like(mu)
        return cls(
            masses=np.stack((ones, mu), axis=-1),
            stiffnesses=np.stack((ones, kappa), axis=-1),
            restitutions=np.stack((e1, e2), axis=-1),
            velocities=np.stack((-ones, zeros), axis=-1),
            table=True,
            gaps=np.stack((zeros, zeros), axis=-1),
        )

    def __len__(self) -> int:
        return len(self.masses)

    @overload
    def __getitem__(self, index: int) -> Collision: ...
    @overload
    def __getitem__(self, index: slice | Rows) -> Collisions: ...
    def __getitem__(self, index: int | slice | Rows) -> Collision | Collisions:
        arrays = {legal.name: getattr(self, legal.name)[index] for legal in LINE}
        if arrays["masses"].ndim == 2:
            return replace(self, **arrays)
        numbers = {name: tuple(array.tolist()) for name, array in arrays.items()}
        return Collision(**numbers, table=self.table, exponent=self.exponent)

    @property
    def compression_rates(self) -> Floats:
        """Rates of compression w_i = v_{i+1} - v_i at first touch, in m/s, shape (n, C); -v_N at the table."""
        return np.diff(self.velocities, axis=1, append=np.zeros((len(self), int(self.table))))

    @property
    def stiffness_ratio(self) -> Floats:
        """Stiffness ratios k2/k1 of two balls on a table, shape (n,)."""
        with np.errstate(divide="ignore"):
            return self.stiffnesses[:, 1] / self.stiffnesses[:, 0]

    @property
    def mass_ratio(self) -> Floats:
        """Mass ratios m2/m1, shape (n,)."""
        return self.masses[:, 1] / self.masses[:, 0]

    @property
    def falls_on_resting(self) -> Booleans:
        """True for each collision in which B1 falls on B2 at rest on a table, with linear contacts; shape (n,)."""
        if self.masses.shape[1] != 2 or not self.table or self.exponent != 1:
            return np.zeros(len(self), bool)
        return (self.velocities[:, 0] < 0) & (self.velocities[:, 1] == 0) & ~self.gaps.any(axis=1)

    @property
    def units(self) -> tuple[Floats, Floats]:
        """Units of time (s) and of velocity (m/s) that scale each collision as `Units` does; each of shape (n,)."""
        return scaling_units(self.masses, self.stiffnesses, self.compression_rates, self.exponent)
