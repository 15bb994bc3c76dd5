"""Velocities, impulses and forces during a collision: `Path` of one collision, `Paths` of many.

Used by solvers that record paths, by `Outcome` and `Outcomes`, and by pictures.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import overload

import numpy as np

from impact_xval.model.arrays import Booleans, Floats, Integers


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Velocities, impulses and forces at p points of one collision, in the order of time.

    Several points may have the same time.

    Attributes
    ----------
    time : ndarray, shape (p,)
        Time since first touch, in s. It is infinite from the point on at which a contact of stiffness 0 finishes its
        impact. The model computes time as if the positions of first touch stayed the same.
    velocities : ndarray, shape (p, N)
        Velocities of the balls, in m/s.
    impulses, forces : ndarray, shape (p, C)
        Accumulated impulses in N s, and forces in N. The force of a rigid contact is the force that it passes on. The
        forces of an engine are means since the previous point. While the model completes the impact of a stiff contact
        by a closed form, the force of the soft contact stays the same, and does not change velocities (supplement,
        3.4).
    active : ndarray of bool, shape (p, C)
        Whether each contact is active from this point on. A rigid contact is active while another contact is active.
    """

    time: Floats
    velocities: Floats
    impulses: Floats
    forces: Floats
    active: Booleans

    v1 = property(lambda self: self.velocities[:, 0], doc="Velocity of ball 1, in m/s.")
    v2 = property(lambda self: self.velocities[:, 1], doc="Velocity of ball 2, in m/s.")
    impulse1 = property(lambda self: self.impulses[:, 0], doc="Impulse of contact 1, in N s.")
    impulse2 = property(lambda self: self.impulses[:, 1], doc="Impulse of contact 2, in N s.")

    @property
    def state(self) -> Integers:
        """State of two balls on a table at each point: 1 to 4 for S1 to S4; shape (p,)."""
        return 4 - self.active @ np.array([1, 2])


@dataclass(frozen=True, slots=True, eq=False)
class Paths(Sequence[Path | None]):
    """Paths of n collisions of N balls each. Item `[i]` is the `Path` of collision i, or None if it has no points.

    The arrays are those of `Path`, with the points of one collision after another.
    """

    #: The points of collision i are those with the indices from offsets[i] to offsets[i + 1].
    offsets: Integers
    time: Floats
    velocities: Floats
    impulses: Floats
    forces: Floats
    active: Booleans

    @classmethod
    def of(cls, paths: Iterable[Path | None], balls: int, contacts: int) -> Paths:
        """Concatenate the paths of several collisions; None stands for a collision without points."""
        no_impulses = np.empty((0, contacts))
        empty = Path(
            np.empty(0), np.empty((0, balls)), no_impulses, no_impulses, np.empty((0, contacts), bool)
        )
        rows = [path or empty for path in paths]
        arrays = (
            np.concatenate([getattr(path, array.name) for path in (empty, *rows)]) for array in fields(Path)
        )
        return cls(np.cumsum([0, *(len(path.time) for path in rows)]), *arrays)

    def scatter(self, has_path: Booleans) -> Paths:
        """Return paths of m collisions: these n paths where `has_path` is true, and empty paths elsewhere.

        `has_path` has the shape (m,), and is true n times.
        """
        lengths = np.zeros(len(has_path), np.int64)
        lengths[has_path] = np.diff(self.offsets)
        return replace(self, offsets=np.append(0, np.cumsum(lengths)))

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @overload
    def __getitem__(self, index: int) -> Path | None: ...
    @overload
    def __getitem__(self, index: slice) -> list[Path | None]: ...
    def __getitem__(self, index: int | slice) -> Path | list[Path | None] | None:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        i = range(len(self))[index]
        points = slice(*self.offsets[i : i + 2].tolist())
        if points.start == points.stop:
            return None
        return Path(*(getattr(self, array.name)[points] for array in fields(Path)))
