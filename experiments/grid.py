"""The cells of an experiment: deterministic, numbered, made one by one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from experiments.config import Cell, Config
from model.collision import Collision


@dataclass(frozen=True, slots=True)
class GridCell:
    """A numbered cell.

    Attributes
    ----------
    index : int
        Position in the grid, from 0.
    stiffness_ratio, mass_ratio : float
        k2/k1 and m2/m1 as written on the axes.
    collision : Collision
        The collision in kg, N/m and m/s.
    """

    index: int
    stiffness_ratio: float
    mass_ratio: float
    collision: Collision


class CellGrid:
    """The cells of a configuration, in the order of its axes; the last axis (e2) varies fastest.

    Stiffness ratios vary slowest, so that neighbouring cells need about the same number of steps and an
    engine that runs them side by side wastes little.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._axes = list(config.grid.axes().values())

    def __len__(self) -> int:
        return math.prod(len(axis) for axis in self._axes)

    def __getitem__(self, index: int) -> GridCell:
        if not 0 <= index < len(self):
            raise IndexError(f"cell {index} of {len(self)}")
        values: list[float] = []
        rest = index
        for axis in reversed(self._axes):
            rest, position = divmod(rest, len(axis))
            values.append(axis[position])
        e2, e1, mass_ratio, stiffness_ratio = values
        cell = Cell(stiffness_ratio=stiffness_ratio, mass_ratio=mass_ratio, e1=e1, e2=e2)
        return GridCell(index, stiffness_ratio, mass_ratio, collision_of(self._config, cell))

    def __iter__(self) -> Iterator[GridCell]:
        return (self[index] for index in range(len(self)))

    def chunks(self) -> int:
        """Return the number of chunks of `Config.chunk_size` cells."""
        return -(-len(self) // self._config.chunk_size)

    def chunk(self, number: int) -> range:
        """Return the indices of the cells of a chunk."""
        size = self._config.chunk_size
        return range(number * size, min((number + 1) * size, len(self)))


def collision_of(config: Config, cell: Cell) -> Collision:
    """Give a cell the masses, stiffnesses and velocity of an experiment."""
    return Collision(
        m1=config.m1,
        m2=config.m1 * cell.mass_ratio,
        k1=config.k1,
        k2=config.k1 * cell.stiffness_ratio,
        e1=cell.e1,
        e2=cell.e2,
        v0=config.v0,
    )
