"""The cells of an experiment: deterministic, numbered, made one by one."""

from __future__ import annotations

import hashlib
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.config.cells import Block
from impact_xval.experiments.config.configuration import Cell, Config
from impact_xval.model.collision import Collision, Collisions

#: Cells of a chunk, and the number of chunks from which they become larger instead of more.
_CHUNK = 16
_QUICK_CHUNK = 128
_MOST_CHUNKS = 10_000

_Cell = TypeVar("_Cell")


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


class Chunked(ABC, Generic[_Cell]):
    """The cells of an experiment, in order, and their chunks; a cell is made when it is asked for."""

    #: Cells of a chunk where an engine is among the solvers: a few seconds of work with their estimates.
    with_engines = _CHUNK

    def __init__(self, config: Config) -> None:
        self._config = config

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def cells(self, indices: range) -> list[_Cell]:
        """Make some cells."""

    @abstractmethod
    def block(self, indices: range) -> Block:
        """Make some cells, as arrays."""

    @abstractmethod
    def digest(self, indices: range) -> str:
        """SHA-256 of the parameters of some cells, to the last bit."""

    def __getitem__(self, index: int) -> _Cell:
        if not 0 <= index < len(self):
            raise IndexError(f"cell {index} of {len(self)}")
        return self.cells(range(index, index + 1))[0]

    def __iter__(self) -> Iterator[_Cell]:
        return (self[index] for index in range(len(self)))

    @property
    def chunk_size(self) -> int:
        """Cells of a chunk: as configured, or `with_engines` if an engine is among the solvers, else up to 128.

        That is 0.17 s for 128 cells of two balls (docs/load.md). There are at most 10 000 chunks: beyond that they are
        larger.
        """
        if self._config.chunk_size is not None:
            return self._config.chunk_size
        quick = not any(map(is_engine, self._config.solvers))
        usual = max(_CHUNK, min(_QUICK_CHUNK, len(self) // 64)) if quick else self.with_engines
        return max(usual, -(-len(self) // _MOST_CHUNKS))

    def chunks(self) -> int:
        """Return the number of chunks."""
        return -(-len(self) // self.chunk_size)

    def chunk(self, number: int) -> range:
        """Return the indices of the cells of a chunk."""
        size = self.chunk_size
        return range(number * size, min((number + 1) * size, len(self)))


class Cells(Chunked[GridCell]):
    """Cells of two balls on a table."""

    @abstractmethod
    def ratios(self, indices: range) -> NDArray[np.float64]:
        """Stiffness ratio, mass ratio, e1 and e2 of some cells, shape (n, 4)."""

    def cells(self, indices: range) -> list[GridCell]:
        """Make some cells."""
        return [
            GridCell(index, values[0], values[1], _collision(self._config, *values))
            for index, values in zip(indices, self.ratios(indices).tolist(), strict=True)
        ]

    def block(self, indices: range) -> Block:
        """Make some cells, as arrays."""
        return block_of(self._config, self.ratios(indices), indices.start)

    def digest(self, indices: range) -> str:
        """SHA-256 of the parameters of some cells, to the last bit."""
        data = self.ratios(indices).astype("<f8").tobytes()
        return hashlib.sha256(f"{indices.start} ".encode() + data).hexdigest()


class CellGrid(Cells):
    """The cells of a grid, in the order of its axes; the last axis (e2) varies fastest.

    Stiffness ratios vary slowest, so that neighbouring cells need about the same number of steps and an
    engine that runs them side by side wastes little.
    """

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self._axes = [np.array(axis) for axis in config.grid.axes().values()]
        self._shape = tuple(len(axis) for axis in self._axes)

    def __len__(self) -> int:
        return math.prod(self._shape)

    def ratios(self, indices: range) -> NDArray[np.float64]:
        """Stiffness ratio, mass ratio, e1 and e2 of some cells, shape (n, 4)."""
        places = np.unravel_index(np.arange(indices.start, indices.stop), self._shape)
        return np.column_stack([axis[place] for axis, place in zip(self._axes, places, strict=True)])


class CellList(Cells):
    """Cells in any order.

    Parameters
    ----------
    config : Config
    values : ndarray, shape (n, 4)
        Stiffness ratio, mass ratio, e1, e2.
    """

    def __init__(self, config: Config, values: NDArray[np.float64]) -> None:
        super().__init__(config)
        self._values = values

    def __len__(self) -> int:
        return len(self._values)

    def ratios(self, indices: range) -> NDArray[np.float64]:
        """Stiffness ratio, mass ratio, e1 and e2 of some cells, shape (n, 4)."""
        return self._values[indices.start : indices.stop]


def block_of(config: Config, values: NDArray[np.float64], first: int = 0) -> Block:
    """Make cells of two balls from their ratios, shape (n, 4), numbered from `first` on."""
    kappa, mu, e1, e2 = values.T
    ones = np.ones(len(values))
    m1, k1, v0 = config.m1 * ones, config.k1 * ones, config.v0 * ones
    pairs = (m1, config.m1 * mu), (k1, config.k1 * kappa), (e1, e2), (v0, 0 * ones)
    m, k, e, v = (np.stack(pair, axis=1) for pair in pairs)
    given = (kappa, mu, e1, e2, m1, m[:, 1], k1, k[:, 1], v0)
    names = ("stiffness_ratio", "mass_ratio", "e1", "e2", "m1", "m2", "k1", "k2", "v0")
    collisions = Collisions(m, k, e, v, True, np.zeros_like(k))
    return Block(first + np.arange(len(values)), dict(zip(names, given, strict=True)), collisions)


def collision_of(config: Config, cell: Cell) -> Collision:
    """Give a cell the masses, stiffnesses and velocity of an experiment."""
    return _collision(config, cell.stiffness_ratio, cell.mass_ratio, cell.e1, cell.e2)


def _collision(config: Config, stiffness_ratio: float, mass_ratio: float, e1: float, e2: float) -> Collision:
    return Collision.two_balls(
        m1=config.m1,
        m2=config.m1 * mass_ratio,
        k1=config.k1,
        k2=config.k1 * stiffness_ratio,
        e1=e1,
        e2=e2,
        v0=config.v0,
    )
