"""Statistics of finished tables of any size: one column in memory at a time, in numbers, never in text.

Rows are grouped by the levels of an axis: the values of a grid, or bins where cells are scattered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.dataset as ds
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import law_of
from impact_xval.experiments.config.arrangements import COLUMN_AXES
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.tables.folder import Tally
from impact_xval.experiments.tables.parquet import blocks, codes, column, present, texts
from impact_xval.model.collision import RESULT_STATUSES

#: A pandas DataFrame or Series. Their annotations are too wide to check code against: any selection may be
#: either.
Frame = Any

#: Whether the state paths are equal, where the model followed its own to the end; null elsewhere.
FULL_PATHS = "states_equal_without_limit"

#: Whether a solver's state path is that of the exact solver of its own law; null without one in the run.
OWN_LAW = "states_equal_own_law"


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

    values: list[Any]
    edges: NDArray[np.float64] | None = None

    def codes(self, x: NDArray[Any]) -> NDArray[np.int32]:
        """Position in `values` of each x; -1 of NaN."""
        values = np.array(self.values)
        if self.edges is None:
            order, known = np.argsort(values), x == x
            codes = np.full(len(x), -1, np.int32)
            codes[known] = order[np.searchsorted(values[order], x[known].astype(values.dtype))]
            return codes
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


@dataclass(frozen=True, slots=True)
class Compared:
    """The rows of the table of divergence, in columns of small numbers.

    Attributes
    ----------
    path : Path
        The table.
    pair : bool
        Whether it is of two balls on a table.
    solvers : list of str
        The compared solvers.
    levels : dict
        By axis.
    solver : ndarray of int8
        Position of each row's solver.
    codes : dict of ndarray of int32
        Position of each row's level, by axis.
    compared : ndarray of bool
        Rows with a result on both sides.
    marked : ndarray of bool
        Rows kept apart (`schema`).
    """

    path: Path
    pair: bool
    solvers: list[str]
    levels: dict[str, Levels]
    solver: NDArray[np.int8]
    codes: dict[str, NDArray[np.int32]]
    compared: NDArray[np.bool_]
    marked: NDArray[np.bool_]

    @classmethod
    def of(cls, path: Path, config: Config) -> Compared:
        """Read the columns by which everything is grouped."""
        solvers = [name for name in config.solvers if name != REFERENCE]
        pair = config.column is None
        levels = grid_levels(config) if pair and not (config.sample or config.cells) else {}
        where = {}
        for axis in AXES if pair else COLUMN_AXES:
            x = texts(path, axis) if axis == "arrangement" else column(path, axis)
            if not pair:
                levels[axis] = Levels(sorted({value for value in x.tolist() if value == value}))
            levels.setdefault(axis, levels_of(x) if len(x) else Levels([]))
            where[axis] = levels[axis].codes(x)
        return cls(
            path=path,
            pair=pair,
            solvers=solvers,
            levels=levels,
            solver=codes(path, "solver", solvers),
            codes=where,
            compared=~np.isnan(column(path, "velocity_divergence")),
            marked=present(path, "marked"),
        )

    def measure(self, name: str) -> NDArray[np.float64]:
        """Read a measure, `FULL_PATHS` or `OWN_LAW`; NaN where there is none."""
        if name == OWN_LAW:
            return self._own_law()
        if name != FULL_PATHS:
            return column(self.path, name)
        values = column(self.path, "states_equal")
        # Where the model took a limit, its path ends there: it cannot equal one that was followed to the end.
        values[codes(self.path, "model_status", ["ok"]) != 0] = np.nan
        return values

    def _own_law(self) -> NDArray[np.float64]:
        """Compare each path with that of the exact solver of its law, a row above or below in the same cell."""
        law = np.array([self._position_of_law(name) for name in self.solvers])
        if not (law >= 0).any():
            return np.full(len(self.compared), np.nan)
        pieces = [np.empty((0, len(law)), bool)]
        for block in blocks(self.path, ["cell", "states_compared"]):
            paths = block.column("states_compared").combine_chunks().dictionary_encode().indices
            of_cell = paths.fill_null(-1).to_numpy(zero_copy_only=False).reshape(-1, len(law))
            pieces.append(of_cell == of_cell[:, law])
        compared = self.compared.reshape(-1, len(law))
        there = compared & compared[:, law] & (law >= 0)
        return np.where(there, np.concatenate(pieces), np.nan).ravel()

    def _position_of_law(self, name: str) -> int:
        law = law_of(name)
        return self.solvers.index(law) if law != name and law in self.solvers else -1

    def frame(self, measures: Sequence[str], rows: NDArray[np.bool_]) -> Frame:
        """Make a table of some rows: solver, the level of every axis, and measures."""
        columns: dict[str, Any] = {
            "solver": pd.Categorical.from_codes(self.solver[rows], categories=self.solvers)
        }
        for axis, levels in self.levels.items():
            columns[axis] = np.array(levels.values)[self.codes[axis][rows]]
        for name in measures:
            columns[name] = self.measure(name)[rows]
        return pd.DataFrame(columns)


def statistics(table: Compared, measures: Sequence[str], shares: Sequence[str]) -> Frame:
    """Compute the statistics of every measure by solver, and by solver and axis (regular cells)."""
    frames = []
    parts = {
        "all": table.compared,
        "regular": table.compared & ~table.marked,
        "marked": table.compared & table.marked,
    }
    for measure in (*measures, *shares):
        sizes = np.abs(table.measure(measure))
        for label, rows in parts.items():
            part = pd.Series(sizes[rows])
            for axis in ("all", *table.levels) if label == "regular" or not table.pair else ("all",):
                keys = [table.solver[rows], *([] if axis == "all" else [table.codes[axis][rows]])]
                there = np.ones(len(part), bool) if axis == "all" else keys[1] >= 0
                frame = _grouped(part[there], [key[there] for key in keys], quantiles=measure not in shares)
                solver = [table.solvers[code] for code in frame.index.get_level_values(0)]
                frame = frame.assign(solver=solver, cells=label, axis=axis, measure=measure)
                if axis != "all":
                    values = np.array(table.levels[axis].values)
                    frame["value"] = values[frame.index.get_level_values(1)]
                frames.append(frame)
    columns = ["solver", "cells", "axis", "value", "measure", "n", "mean", "median", "p95", "max"]
    kinds = {"median": float} | ({"value": float} if table.pair else {"value": object})
    filled = [frame.reindex(columns=columns).astype(kinds) for frame in frames if len(frame)]
    return pd.concat(filled, ignore_index=True) if filled else pd.DataFrame(columns=columns)


def _grouped(sizes: Frame, keys: list[NDArray[Any]], *, quantiles: bool) -> Frame:
    grouped = sizes.groupby(keys)
    frame = pd.DataFrame({"n": grouped.count(), "mean": grouped.mean()})
    if quantiles:
        frame["median"] = grouped.median()
        frame["p95"] = grouped.quantile(0.95)
        frame["max"] = grouped.max()
    return frame


def worst_rows(table: Compared, count: int) -> Frame:
    """Read the regular rows with the largest D of every solver, by solver, then from the largest."""
    d = table.measure("velocity_divergence")
    picked: list[int] = []
    for code in range(len(table.solvers)):
        rows = np.flatnonzero(table.compared & ~table.marked & (table.solver == code))
        picked += rows[np.argsort(-d[rows], kind="stable")[:count]].tolist()
    return ds.dataset(table.path).take(pa.array(picked, pa.int64())).to_pandas()


def reasons_of(outcomes: Tally) -> list[tuple[str, str, str, int]]:
    """Return why rows have no result: solver, status, reason and number, the most frequent reasons first."""
    rows = [(*key, n) for key, n in outcomes.items() if key[1] not in RESULT_STATUSES]
    return sorted(rows, key=lambda row: (-row[3], row[0], row[2], row[1]))


def between(path: Path, config: Config) -> Frame:
    """D between compliant solvers, marked rows left out: near zero where they share what tells them from the model.

    Parameters
    ----------
    path : Path
        The table of cells: as many rows a cell as there are solvers, in their order.
    """
    names = [name for name in config.solvers if name != REFERENCE]
    speed = np.abs(column(path, "v0"))
    u1 = (column(path, "v1") / speed).reshape(-1, len(config.solvers))
    u2 = (np.sqrt(column(path, "mass_ratio")) * column(path, "v2") / speed).reshape(-1, len(config.solvers))
    done = np.isin(codes(path, "status", RESULT_STATUSES), range(len(RESULT_STATUSES))).reshape(u1.shape)
    done &= ~present(path, "marked").reshape(u1.shape)
    u1[~done], u2[~done] = np.nan, np.nan
    rows = []
    for i, name in enumerate(names):
        for other in names[i + 1 :]:
            a, b = config.solvers.index(name), config.solvers.index(other)
            d = np.hypot(u1[:, a] - u1[:, b], u2[:, a] - u2[:, b])
            d = d[~np.isnan(d)]
            if len(d):
                rows.append((name, other, len(d), np.median(d), np.quantile(d, 0.95), d.max()))
    return pd.DataFrame(rows, columns=["solver", "other", "n", "median", "p95", "max"])
