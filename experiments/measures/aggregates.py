"""The finished table of divergence of a run, with its rows grouped by solver and by the levels of the axes.

The table may be larger than the memory, so its columns are read one at a time. `summary` and the pages of a run call
this module.
"""

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

#: Columns of ``summary.csv``: the group of rows, the measure, and the statistics of this measure in this group.
STATISTICS = ["solver", "cells", "axis", "value", "measure", "n", "mean", "median", "p95", "max"]

#: Name of a measure that tells whether the state paths of solver and model are equal. It is null where the model used a
#: closed form, because the model then does not follow its path to the end.
FULL_PATHS = "states_equal_without_limit"

#: Name of a measure that tells whether a solver's state path equals the path of the exact solver of the same law. It is
#: null where the run has no such exact solver.
OWN_LAW = "states_equal_own_law"

#: Scattered values come from a sample or a list of cells. Up to `_FEW` different values are levels themselves. More
#: values are put into `_BINS` bins.
_FEW = 24
_BINS = 12
#: Bins are evenly spaced in the logarithm if the largest value is more than this many times the smallest.
_WIDE = 20.0


@dataclass(frozen=True, slots=True)
class AxisLevels:
    """Levels of one axis, by which rows are grouped. A level is a value on the axis, or the middle of a bin.

    `edges` holds the lower end of every bin except the first. It is None if there are no bins.
    """

    values: Sequence[AxisValue]
    edges: NDArray[np.float64] | None = None

    def codes(self, x: np.ndarray) -> NDArray[np.intp]:
        """Return, for each element of x, the position of its level in `values`.

        If there are no bins, the position of NaN is -1.
        """
        if self.edges is None:
            return pd.Index(self.values).get_indexer(x)
        return np.searchsorted(self.edges, x, side="right")


def axis_levels(config: Config, axis: str, x: np.ndarray) -> AxisLevels:
    """Return the levels of an axis.

    For a grid, chains or graphs, the levels are the values on the axis. If values are scattered, because they come from
    a sample or a list of cells, the levels are the middles of bins.
    """
    if config.kind != "pair":
        return AxisLevels(sorted(set(pd.Series(x).dropna())))
    scattered = config.sample is not None or config.cells is not None
    axes = {} if scattered else config.grid.axes()
    if axis in axes:
        return AxisLevels(axes[axis])
    return levels_of(x)  # if the axes of a grid are in SI units, their ratios are scattered too


def levels_of(x: NDArray[np.float64]) -> AxisLevels:
    """Return the levels of scattered values: few values are levels themselves, more values are put into bins.

    If 0 or infinity is among the values, it is a separate level.
    """
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
    """The table of divergence of a run. Solvers and levels of its rows are in memory, measures stay in the file.

    In memory a solver or a level is a small integer, which points into a list of names or values.
    """

    path: Path
    solvers: list[str]
    #: Levels of each axis, by the name of the axis.
    levels: dict[str, AxisLevels]
    #: One row per row of the table. Columns: ``solver`` and the level of every axis, as categories; ``compared``,
    #: whether both the solver and the model have a result; ``marked``, whether the row lies next to a jump of the
    #: outcome, where a slight change of a parameter changes the outcome by a finite amount.
    rows: Frame

    @property
    def regular(self) -> NDArray[np.bool_]:
        """Mask of the rows that statistics count.

        In these rows both the solver and the model have a result, and no jump of the outcome is near.
        """
        return (self.rows.compared & ~self.rows.marked).to_numpy()

    def measure(self, name: str) -> NDArray[np.float64]:
        """Return the values of a measure, one per row of the table; NaN where a row has no value.

        `name` is a column of the table, `FULL_PATHS` or `OWN_LAW`.
        """
        if name == OWN_LAW:
            return self._own_law()
        if name != FULL_PATHS:
            return read_column(self.path, name)
        # Where the model used a closed form, its state path stops early. It cannot equal a path that is followed to the
        # end.
        followed = read_codes(self.path, "model_status", ["ok"]) == 0
        return np.where(followed, read_column(self.path, "states_equal"), np.nan)

    def _own_law(self) -> NDArray[np.float64]:
        """Return whether each row's state path equals the path of the exact solver of the same law in the same cell.

        The values are 1 and 0, and NaN where one of the two solvers has no result or the run lacks the exact solver.
        """
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
        """Return a table of the regular rows, with the solver, the level of every axis, and some measures.

        Regular rows are the rows that statistics count (`DivergenceTable.regular`).
        """
        regular = self.regular
        rows = self.rows.loc[regular, ["solver", *self.levels]].reset_index(drop=True)
        levels = {axis: rows[axis].to_numpy() for axis in self.levels}
        return rows.assign(**levels, **{name: self.measure(name)[regular] for name in measures})


def load_divergence(folder: RunFolder, config: Config) -> DivergenceTable:
    """Read a run's table of divergence: the solver of every row, its levels on the axes, and whether it is marked.

    The measures stay in the file. `DivergenceTable.measure` reads them when they are needed.
    """
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
    """Return statistics of grouped values: for each statistic its values by group.

    The statistics are the number of values, and their mean, median, 95th percentile and maximum.
    """
    return {"n": groups.count(), "mean": groups.mean(), **cuts(groups)}


def cuts(values: Frame) -> dict[str, Frame]:
    """Return the median, the 95th percentile and the maximum of values.

    For grouped values, each of the three is a series with one element per group.
    """
    return {"median": values.median(), "p95": values.quantile(0.95), "max": values.max()}
