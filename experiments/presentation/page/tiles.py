"""The map of a run whose tiles open: k2/k1, or the number of balls, by other axes, bounded in number."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from impact_xval.experiments.config.arrangements import COLUMN_AXES
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.measures.aggregates import Compared, Levels, levels_of
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
    across_labels, up_labels : list of str
        Of the columns and the rows of the map, in their order.
    across, above : list of int
        Column and row of every tile.
    medians : dict of list
        Median D of each solver by tile, marked cells left out; None where nothing was compared.
    cells : list of int
        The cell that a tile opens: that of the largest D by any solver, unmarked where there is one.
    n_cells : int
        Of the run.
    """

    along: str
    up: tuple[str, ...]
    rest: tuple[str, ...]
    across_labels: list[str]
    up_labels: list[str]
    across: list[int]
    above: list[int]
    medians: dict[str, list[float | None]]
    cells: list[int]
    n_cells: int


def tiles_of(table: Compared) -> Tiles:
    """Lay the compared cells of a run out as a map.

    As many axes as there is room for stand up the side, in the order of the tables: with all of them a tile is one
    cell of a grid. Of columns those that have several values in every cell.
    """
    levels = {axis: _sorted(each) for axis, each in table.levels.items()}
    along, *up = levels
    if along == "balls":
        up = [axis for axis in up if len(levels[axis].values) > 1 and table.rows[axis].notna().all()]
        up = up or ["arrangement"]
    while len(up) > 1 and math.prod(len(levels[axis].values) for axis in (along, *up)) > TILES:
        up.pop()
    axes = (along, *up)
    if math.prod(len(levels[axis].values) for axis in axes) > TILES:
        few = {axis: _coarse(table, axis) for axis in axes if len(levels[axis].values) > _FEW}
        levels |= few
    shape = tuple(len(levels[axis].values) for axis in axes)
    where = np.ravel_multi_index([levels[axis].codes(_values(table, axis)) for axis in axes], shape)
    cell = column(table.path, "cell").astype(np.int64)
    d = table.measure("velocity_divergence")
    regular = table.regular
    rank = np.where(regular, d, -1.0)  # those that are kept apart come last
    order = np.lexsort((-rank, where))
    tiles, first = np.unique(where[order], return_index=True)
    frame = pd.DataFrame({"tile": where[regular], "solver": table.rows.solver[regular], "d": d[regular]})
    medians = frame.groupby(["tile", "solver"], observed=True).d.median().unstack().reindex(tiles)
    places = np.unravel_index(tiles, shape)
    rows, above = np.unique(np.ravel_multi_index(places[1:], shape[1:]), return_inverse=True)
    values = np.array(np.unravel_index(rows, shape[1:])).T
    return Tiles(
        along=along,
        up=tuple(up),
        rest=tuple(axis for axis, each in levels.items() if axis not in axes and len(each.values) > 1),
        across_labels=[number(value) for value in levels[along].values],
        up_labels=[
            " · ".join(_label(levels[axis].values[code]) for axis, code in zip(up, row, strict=True))
            for row in values
        ],
        across=places[0].tolist(),
        above=above.tolist(),
        medians={
            name: [None if math.isnan(value) else value for value in medians[name]]
            if name in medians
            else [None] * len(tiles)
            for name in table.solvers
        },
        cells=cell[order][first].tolist(),
        n_cells=len(cell) // max(1, len(table.solvers)),
    )


def _values(table: Compared, axis: str) -> np.ndarray:
    return texts(table.path, axis) if axis == "arrangement" else np.array(column(table.path, axis))


def _label(value: float | str) -> str:
    return value if isinstance(value, str) else number(value)


def _sorted(levels: Levels) -> Levels:
    return levels if levels.edges is not None else Levels(sorted(levels.values))


def _coarse(table: Compared, axis: str) -> Levels:
    return levels_of(column(table.path, axis))
