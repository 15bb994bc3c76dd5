"""The finished table of divergence, grouped by solver and by the levels of axes; a column in memory at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import law_name_of
from impact_xval.experiments.config.experiment import AXES_OF, REFERENCE, Config
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.frames import AxisValue, Frame
from impact_xval.experiments.tables.parquet import read_codes, read_column, read_selected, read_where_present

#: Columns of ``summary.csv``: which rows, of what, and the statistics of it.
STATISTICS = ["solver", "cells", "axis", "value", "measure", "n", "mean", "median", "p95", "max"]

#: Whether the state paths are equal, where the model followed its own to the end; null elsewhere.
FULL_PATHS = "states_equal_without_limit"

#: Whether a solver's state path is that of the exact solver of its own law; null without one in the run.
OWN_LAW = "states_equal_own_law"

#: Scattered values up to this many are levels; more go into this many bins.
_FEW = 24
_BINS = 12
#: Ratio of the ends of an axis from which its bins are even in the logarithm.
_WIDE = 20.0


@dataclass(frozen=True, slots=True)
class AxisLevels:
    """Levels of one axis, by which rows are grouped: its values, or the middles of bins.

    With bins `edges` has the lower end of every bin but the first.
    """

    values: Sequence[AxisValue]
    edges: NDArray[np.float64] | None = None

    def codes(self, x: np.ndarray) -> NDArray[np.intp]:
        """Return the position in `values` of each x; without bins -1 for NaN."""
        if self.edges is None:
            return pd.Index(self.values).get_indexer(x)
        return np.searchsorted(self.edges, x, side="right")


def axis_levels(config: Config, axis: str, x: np.ndarray) -> AxisLevels:
    """Return the levels of an axis: the values of a grid, of chains or of graphs, else the bins of scattered values."""
    if config.kind != "pair":
        return AxisLevels(sorted(set(pd.Series(x).dropna())))
    scattered = config.sample is not None or config.cells is not None
    axes = {} if scattered else config.grid.axes()
    if axis in axes:
        return AxisLevels(axes[axis])
    return levels_of(x)  # so are ratios of quantities in SI units


def levels_of(x: NDArray[np.float64]) -> AxisLevels:
    """Return the levels of scattered values; 0 and infinity, where they occur, are levels of their own."""
    unique = np.unique(x)
    if len(unique) <= _FEW:
        return AxisLevels(unique.tolist())
    below, above = unique[unique == 0].tolist(), unique[np.isinf(unique)].tolist()
    inside = unique[(unique > 0) & np.isfinite(unique)]
    low, high = inside[0], inside[-1]
    if high / low > _WIDE:
        ends = np.geomspace(low, high, _BINS + 1)
        middles = np.sqrt(ends[:-1] * ends[1:])
    else:
        ends = np.linspace(low, high, _BINS + 1)
        middles = (ends[:-1] + ends[1:]) / 2
    return AxisLevels(
        [*below, *middles.tolist(), *above], np.array([*([low] if below else []), *ends[1:-1], *above])
    )


@dataclass(frozen=True, slots=True, eq=False)
class DivergenceTable:
    """The rows of the table of divergence, in columns of small numbers."""

    path: Path
    solvers: list[str]
    #: By axis.
    levels: dict[str, AxisLevels]
    #: ``solver`` and the level of every axis, as categories; ``compared``, whether there is a result on both sides;
    #: ``marked``, whether the row is kept apart (`schema`).
    rows: Frame

    @property
    def regular(self) -> NDArray[np.bool_]:
        """Rows that statistics count: compared, and not marked."""
        return (self.rows.compared & ~self.rows.marked).to_numpy()

    def measure(self, name: str) -> NDArray[np.float64]:
        """Read a measure, `FULL_PATHS` or `OWN_LAW`; NaN where there is none."""
        if name == OWN_LAW:
            return self._own_law()
        if name != FULL_PATHS:
            return read_column(self.path, name)
        # Where the model took a limit, its path ends there: it cannot equal one that was followed to the end.
        followed = read_codes(self.path, "model_status", ["ok"]) == 0
        return np.where(followed, read_column(self.path, "states_equal"), np.nan)

    def _own_law(self) -> NDArray[np.float64]:
        """Compare each path with that of the exact solver of its law, a row above or below in the same cell."""
        laws = ["" if law_name_of(name) == name else law_name_of(name) for name in self.solvers]
        law = np.array([self.solvers.index(name) if name in self.solvers else -1 for name in laws])
        if not (law >= 0).any():
            return np.full(len(self.rows), np.nan)
        paths = read_selected(self.path, ["states_compared"])["states_compared"].combine_chunks()
        paths = paths.indices.fill_null(-1).to_numpy().reshape(-1, len(law))
        compared = self.rows.compared.to_numpy().reshape(-1, len(law))
        there = compared & compared[:, law] & (law >= 0)
        return np.where(there, paths == paths[:, law], np.nan).ravel()

    def frame(self, measures: Sequence[str]) -> Frame:
        """Make a table of the regular rows: solver, the level of every axis, and measures."""
        regular = self.regular
        rows = self.rows.loc[regular, ["solver", *self.levels]].reset_index(drop=True)
        levels = {axis: rows[axis].to_numpy() for axis in self.levels}
        return rows.assign(**levels, **{name: self.measure(name)[regular] for name in measures})


def load_divergence(folder: RunFolder, config: Config) -> DivergenceTable:
    """Read the columns of the table of divergence by which everything is grouped; measures are read as needed."""
    path = folder.table_path("divergence.parquet")
    solvers = [name for name in config.solvers if name != REFERENCE]
    rows = pd.DataFrame({"solver": pd.Categorical.from_codes(read_codes(path, "solver", solvers), solvers)})
    levels = {}
    for axis in AXES_OF[config.kind]:
        x = read_column(path, axis)
        levels[axis] = axis_levels(config, axis, x)
        rows[axis] = pd.Categorical.from_codes(levels[axis].codes(x), levels[axis].values)
    rows["compared"] = ~np.isnan(read_column(path, "velocity_divergence"))
    rows["marked"] = read_where_present(path, "marked")
    return DivergenceTable(path, solvers, levels, rows)


def statistics_of(groups: Frame) -> dict[str, Frame]:
    """Count the values of each group; their mean, median, 95 % and largest."""
    return {"n": groups.count(), "mean": groups.mean(), **cuts(groups)}


def cuts(values: Frame) -> dict[str, Frame]:
    """Take the median, 95 % and largest of some values, or of those of each group."""
    return {"median": values.median(), "p95": values.quantile(0.95), "max": values.max()}
