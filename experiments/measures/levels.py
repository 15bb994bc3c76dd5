"""Values along an axis by which results are grouped: those of a grid, or bins where cells are scattered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_xval.experiments.config.experiment import Config

#: Scattered values up to this many are taken as they are; more go into this many bins.
_FEW = 24
_BINS = 12
#: Ratio of the ends of an axis from which its bins are even in the logarithm.
_WIDE = 20.0


@dataclass(frozen=True, slots=True)
class Levels:
    """Levels of one axis.

    Attributes
    ----------
    values : list of float
        The level, or the middle of its bin (the geometric one where bins are even in the logarithm); in the
        order of the grid, else rising.
    edges : ndarray or None
        Inner edges of the bins, between the finite positive levels; None where values are themselves levels.
    """

    values: list[float]
    edges: NDArray[np.float64] | None = None

    def codes(self, x: NDArray[np.float64]) -> NDArray[np.int32]:
        """Position in `values` of each x."""
        values = np.array(self.values)
        if self.edges is None:
            order = np.argsort(values)
            return order[np.searchsorted(values[order], x)].astype(np.int32)
        codes = np.searchsorted(self.edges, x, side="right").astype(np.int32)
        if values[0] == 0:
            codes = np.where(x == 0, 0, codes + 1)
        if np.isinf(values[-1]):
            codes = np.where(np.isinf(x), len(values) - 1, codes)
        return codes.astype(np.int32)


def grid_levels(config: Config) -> dict[str, Levels]:
    """Levels of a grid: the values of its axes."""
    return {name: Levels(values) for name, values in config.grid.axes().items()}


def levels_of(x: NDArray[np.float64]) -> Levels:
    """Levels of scattered values; 0 and infinity, where they occur, are levels of their own."""
    unique = np.unique(x)
    if len(unique) <= _FEW:
        return Levels(unique.tolist())
    inside = unique[(unique > 0) & np.isfinite(unique)]
    low, high = inside[0], inside[-1]
    wide = high / low > _WIDE
    ends = np.geomspace(low, high, _BINS + 1) if wide else np.linspace(low, high, _BINS + 1)
    middles = np.sqrt(ends[:-1] * ends[1:]) if wide else (ends[:-1] + ends[1:]) / 2
    values = [
        *([0.0] if unique[0] == 0 else []),
        *middles.tolist(),
        *([np.inf] if np.isinf(unique[-1]) else []),
    ]
    return Levels(values, ends[1:-1])
