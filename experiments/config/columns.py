"""The columns of N balls of an experiment: deterministic, numbered, made one by one."""

from __future__ import annotations

import hashlib
import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from impact_xval.experiments.config.arrangements import COLUMN_LEGAL, Arranged
from impact_xval.experiments.config.cells import Block
from impact_xval.experiments.config.configuration import Config
from impact_xval.experiments.config.grid import Chunked
from impact_xval.model.collision import Collision


@dataclass(frozen=True)
class ColumnCell:
    """A numbered column.

    Attributes
    ----------
    index : int
        Position in the experiment, from 0.
    arranged : Arranged
        The values of the axes.
    """

    index: int
    arranged: Arranged

    @cached_property
    def column(self) -> Collision:
        """The column in kg, N/m^p and m/s."""
        return self.arranged.column()


class Columns(Chunked[ColumnCell]):
    """The columns of an experiment, one arrangement after the other; of each the last axis varies fastest.

    Numbers of balls vary slowest, so that neighbouring columns take about as long.
    """

    with_engines = 4

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        assert config.column is not None
        self._names = config.column.arrangement
        self._axes = [list(config.column.axes(name).values()) for name in self._names]
        self._ends = list(accumulate(math.prod(map(len, axes)) for axes in self._axes))

    def __len__(self) -> int:
        return self._ends[-1]

    def cells(self, indices: range) -> list[ColumnCell]:
        """Make some columns."""
        c = self._config
        cells = []
        for name, places, values in self._blocks(indices):
            for index, row in zip(places, values.tolist(), strict=True):
                numbers = dict(zip(COLUMN_LEGAL, row, strict=True))
                strike = None if math.isnan(numbers["strike"]) else int(numbers["strike"])
                counts = {"balls": int(numbers["balls"]), "strike": strike}
                values_of = numbers | counts | {"arrangement": name, "m": c.m1, "k": c.k1, "v0": c.v0}
                cells.append(ColumnCell(index, Arranged.model_validate(values_of)))
        return cells

    def block(self, indices: range) -> Block:
        """Make some columns, as arrays."""
        return block_of_columns([cell.arranged for cell in self.cells(indices)], indices.start)

    def digest(self, indices: range) -> str:
        """SHA-256 of the parameters of some columns, to the last bit."""
        found = hashlib.sha256(f"{indices.start} ".encode())
        for name, _, values in self._blocks(indices):
            found.update(f"{name} ".encode() + values.astype("<f8").tobytes())
        return found.hexdigest()

    def _blocks(self, indices: range) -> Iterator[tuple[str, range, NDArray[np.float64]]]:
        """Cut indices by arrangement: its name, the indices of it, the values of its axes, shape (n, 7)."""
        start = indices.start
        while start < indices.stop:
            block = bisect_right(self._ends, start)
            first = self._ends[block - 1] if block else 0
            stop = min(indices.stop, self._ends[block])
            axes = self._axes[block]
            places = np.unravel_index(np.arange(start - first, stop - first), [len(axis) for axis in axes])
            values = [np.array(axis)[place] for axis, place in zip(axes, places, strict=True)]
            yield self._names[block], range(start, stop), np.column_stack(values)
            start = stop


def block_of_columns(some: Sequence[Arranged], first: int = 0) -> Block:
    """Make cells of columns, numbered from `first` on."""
    strike = [each.striking if each.arrangement == "cradle" else math.nan for each in some]
    named = {"m1": "m", "k1": "k", "v0": "v0"}
    parameters = {
        "arrangement": np.array([each.arrangement for each in some], dtype=object),
        **{name: np.array([getattr(each, name) for each in some]) for name in COLUMN_LEGAL},
        "strike": np.array(strike, float),
        **{name: np.array([getattr(each, own) for each in some]) for name, own in named.items()},
    }
    return Block(first + np.arange(len(some)), parameters, [each.column() for each in some])
