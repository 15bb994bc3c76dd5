"""A finished run as labelled arrays (`xarray`), for those who analyse n-dimensional grids."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.layout import layout_of
from impact_xval.experiments.tables.folder import RunFolder, finished_collisions
from impact_xval.experiments.tables.parquet import column, texts
from impact_xval.experiments.tables.schema import Column

if TYPE_CHECKING:
    import xarray as xr

#: Columns of a data set unless others are asked for.
DEFAULT = (
    "status",
    "v1",
    "v2",
    "impulse1",
    "impulse2",
    "n_states",
    "grazing_margin",
    "velocity_divergence",
    "states_equal",
    "curve_distance",
)


def to_xarray(folder: RunFolder | Path | str, columns: Sequence[str] = DEFAULT) -> xr.Dataset:
    """Return the results of a finished run as arrays over its axes.

    Parameters
    ----------
    folder : RunFolder or path
        A finished run.
    columns : sequence of str
        Columns of the tables of cells and of divergence; a measure of divergence of the model from itself is
        missing (NaN). Truths become 1.0 and 0.0, whole numbers floats; a text column holds the text.

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
    import xarray as xr

    run = folder if isinstance(folder, RunFolder) else finished_collisions(Path(folder))
    config = run.config()
    tables = layout_of(config).tables
    of_cells, known = tables["cells"].columns, tables["cells"].columns | tables["divergence"].columns
    for name in columns:
        if name not in known:
            raise ValueError(f"columns: {name!r} is unknown; known: {', '.join(known)}")
    cells = run.table_path("cells.parquet")
    divergence = run.table_path("divergence.parquet")
    n_solvers = len(config.solvers)
    dims, coords, shape = _axes(cells, config, n_solvers, known)
    variables = {}
    for name in columns:
        if name in of_cells:
            values = _read(cells, name, known).reshape(-1, n_solvers).T
        else:
            compared = _read(divergence, name, known).reshape(-1, n_solvers - 1).T
            first = np.full((1, compared.shape[1]), np.nan if compared.dtype != object else None)
            values = np.concatenate([first.astype(compared.dtype), compared])
        _, unit, meaning = known[name]
        attributes = {"units": unit, "long_name": meaning}
        variables[name] = (("solver", *dims), values.reshape(n_solvers, *shape), attributes)
    return xr.Dataset(
        variables,
        coords={"solver": list(config.solvers), **coords},
        attrs={"name": config.name, "identity": str(run.manifest().get("identity"))},
    )


def _axes(
    cells: Path, config: Config, n_solvers: int, known: dict[str, Column]
) -> tuple[tuple[str, ...], dict[str, Any], tuple[int, ...]]:
    def described(name: str, dim: str, values: Any) -> Any:
        return (dim, values, {"units": known[name][1], "long_name": known[name][2]})

    if config.sample is None and config.cells is None:
        axes = config.grid.axes()
        coords = {name: described(name, name, values) for name, values in axes.items()}
        return tuple(axes), coords, tuple(map(len, axes.values()))
    along = {name: _read(cells, name, known)[::n_solvers] for name in ("cell", *AXES)}
    coords = {name: described(name, "cell", values) for name, values in along.items()}
    coords["cell"] = described("cell", "cell", along["cell"].astype(int))
    return ("cell",), coords, (len(along["cell"]),)


def _read(path: Path, name: str, known: dict[str, Column]) -> np.ndarray:
    """Read a column: text as it is, all else as float64."""
    return texts(path, name) if known[name][0] == "text" else column(path, name)
