"""A finished run as labelled arrays (`xarray`), for those who analyse n-dimensional grids."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import pyarrow.parquet as pq

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.measures.layout import layout_of
from impact_xval.experiments.tables.folder import RunFolder, finished_collisions

if TYPE_CHECKING:
    import xarray as xr

#: Columns of a data set unless others are asked for.
DEFAULT = (
    *("status", "v1", "v2", "impulse1", "impulse2", "n_states", "grazing_margin"),
    *("velocity_divergence", "states_equal", "curve_distance"),
)


def to_xarray(folder: RunFolder | Path | str, columns: Sequence[str] = DEFAULT) -> xr.Dataset:
    """Return the results of a finished run as arrays over its axes.

    Parameters
    ----------
    folder : RunFolder or path
        A finished run of two balls.
    columns : sequence of str
        Columns of the tables of cells and of divergence. Truths and whole numbers become floats.

    Returns
    -------
    xarray.Dataset
        Dimensions ``solver``, ``stiffness_ratio``, ``mass_ratio``, ``e1`` and ``e2`` of a grid; ``solver``
        and ``cell`` of any other design, with the parameters as coordinates along ``cell``. Units and
        meanings are attributes of each variable.

    Raises
    ------
    UserError
        If the run is not finished, or its tables are damaged.
    ValueError
        If a column is none of the tables'; the message lists those.
    """
    run = folder if isinstance(folder, RunFolder) else finished_collisions(Path(folder))
    config = run.config()
    tables = layout_of(config).tables
    of_cells, known = tables["cells"].columns, tables["cells"].columns | tables["divergence"].columns
    for name in columns:
        if name not in known:
            raise ValueError(f"columns: {name!r} is unknown; known: {', '.join(known)}")
    grid = config.sample is None and config.cells is None
    axes: dict[str, Any] = config.grid.axes() if grid else {}
    keys, compared = ["solver", "cell"], [name for name in columns if name not in of_cells]
    named = dict.fromkeys([*keys, *AXES, *columns])
    rows = _read(run, "cells", [name for name in named if name in of_cells])
    if compared:
        rows = rows.merge(_read(run, "divergence", [*keys, *compared]), how="left", on=keys)
    for name in columns:
        if known[name][0] in ("int", "bool"):
            rows[name] = rows[name].astype(float)
    order = {"solver": list(config.solvers), **(axes or {"cell": rows.cell.unique()})}
    found = rows.set_index(list(order))[list(columns)].to_xarray().reindex(order)
    if not axes:
        of_cell = rows.drop_duplicates("cell")
        found = found.assign_coords({axis: ("cell", of_cell[axis]) for axis in AXES})
    for name, array in found.variables.items():
        if name != "solver":
            array.attrs = {"units": known[name][1], "long_name": known[name][2]}
    return found.assign_attrs(name=config.name, identity=str(run.manifest().get("identity")))


def _read(run: RunFolder, table: str, columns: Sequence[str]) -> pd.DataFrame:
    return pq.read_table(run.table_path(f"{table}.parquet"), columns=list(columns)).to_pandas()
