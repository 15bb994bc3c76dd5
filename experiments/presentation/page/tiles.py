"""The map of a run whose tiles open: k2/k1, or the number of balls, by other axes, bounded in number."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from impact_xval.experiments.config.arrangements import COLUMN_AXES
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.measures.aggregates import Compared, Frame, Levels, levels_of
from impact_xval.experiments.tables.numbers import number
from impact_xval.experiments.tables.parquet import column, texts

#: Tiles of a map at most: what a browser draws at once, and a page has room for.
TILES = 1000

#: An axis with more levels than this is put into bins, where the map has no room for them.
_FEW = 24

#: How a reader knows an axis.
LABELS = AXES | COLUMN_AXES


@dataclass(frozen=True, slots=True)
class Tiles:
    """Tiles of a map, those without a cell left out.

    Attributes
    ----------
    along : str
        The axis along the map.
    up : tuple of str
        The axes along its side.
    rest : tuple of str
        The other axes with several values: over them is the median.
    places : DataFrame
        Of every tile its place, ``across`` and ``above``; what it says there, ``column`` and ``row``; and the ``cell``
        that it opens: that of the largest D by any solver, unmarked where there is one.
    medians : DataFrame
        Median D of each solver that was compared, by tile, marked cells left out; NaN where nothing was compared.
    n_cells : int
        Of the run.
    """

    along: str
    up: tuple[str, ...]
    rest: tuple[str, ...]
    places: Frame
    medians: Frame
    n_cells: int


def tiles_of(table: Compared) -> Tiles:
    """Lay the compared cells of a run out as a map.

    As many axes as there is room for stand up the side, in the order of the tables: with all of them a tile is one
    cell of a grid. Of columns those that have several values in every cell.
    """
    levels = {
        axis: each if each.edges is not None else Levels(sorted(each.values))
        for axis, each in table.levels.items()
    }
    along, *up = levels
    if along == "balls":
        up = [axis for axis in up if len(levels[axis].values) > 1 and table.rows[axis].notna().all()]
        up = up or ["arrangement"]

    def count() -> int:
        return math.prod(len(levels[axis].values) for axis in (along, *up))

    while len(up) > 1 and count() > TILES:
        up.pop()
    axes = (along, *up)
    for axis in axes if count() > TILES else ():
        if len(levels[axis].values) > _FEW:
            levels[axis] = levels_of(column(table.path, axis))
    rows = pd.DataFrame({axis: levels[axis].codes(_values(table, axis)) for axis in axes})
    rows["tile"] = rows.groupby(list(axes)).ngroup()  # numbered in the order of the axes
    rows["cell"] = column(table.path, "cell").astype(np.int64)
    rows["d"], rows["solver"] = table.measure("velocity_divergence"), table.rows.solver
    rows["rank"] = np.where(table.regular, rows.d, -1.0)  # those that are kept apart come last
    largest = rows.sort_values(["tile", "rank"], ascending=[True, False], kind="stable")
    places = largest.drop_duplicates("tile").reset_index(drop=True)
    places["across"] = places[along]
    places["above"] = places.groupby(up).ngroup()
    places["column"] = [_label(levels, along, code) for code in places[along]]
    codes = zip(*(places[axis] for axis in up), strict=True)
    places["row"] = [" · ".join(map(_label, [levels] * len(up), up, row)) for row in codes]
    medians = rows[table.regular].groupby(["tile", "solver"], observed=True).d.median().unstack()
    return Tiles(
        along=along,
        up=tuple(up),
        rest=tuple(axis for axis, each in levels.items() if axis not in axes and len(each.values) > 1),
        places=places[["across", "above", "column", "row", "cell"]],
        medians=medians.reindex(places.index),
        n_cells=len(rows) // max(1, len(table.solvers)),
    )


def _values(table: Compared, axis: str) -> np.ndarray:
    return texts(table.path, axis) if axis == "arrangement" else np.array(column(table.path, axis))


def _label(levels: dict[str, Levels], axis: str, code: int) -> str:
    value = levels[axis].values[code]
    return value if isinstance(value, str) else number(value)
