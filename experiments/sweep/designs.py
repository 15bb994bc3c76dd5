"""Cells that are no grid: drawn from a box (`scipy.stats.qmc`), or listed in a CSV or Parquet file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from impact_xval.experiments.config.axes import AXES, LEGAL, MAX_CELLS, Sample, value_problem
from impact_xval.experiments.config.columns import Columns
from impact_xval.experiments.config.configuration import Config
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.grid import CellGrid, CellList, Cells, Chunked
from impact_xval.experiments.tables.store import RunFolder
from impact_xval.experiments.tables.streams import column


def experiment_cells(config: Config) -> Chunked[Any]:
    """Return the cells of an experiment of any kind.

    Raises
    ------
    UserError
        As `cells_of`.
    """
    return cells_of(config) if config.column is None else Columns(config)


def cells_of(config: Config) -> Cells:
    """Return the cells of an experiment with collisions of two balls.

    Raises
    ------
    UserError
        If they are in a file that cannot be read, or holds anything illegal.
    """
    if config.sample is not None:
        return CellList(config, draw(config.sample))
    if config.cells is not None:
        values = read_cells(Path(config.cells))
        _within_double_precision(config, values, config.cells)
        return CellList(config, values)
    return CellGrid(config)


def cells_of_run(folder: RunFolder, config: Config) -> Cells:
    """Return the cells of a finished run; those of a list as its table has them, wherever their file is now."""
    if config.cells is None:
        return cells_of(config)
    path = folder.table_path("cells.parquet")
    values = np.column_stack([column(path, name)[:: len(config.solvers)] for name in AXES])
    return CellList(config, values)


def draw(sample: Sample) -> NDArray[np.float64]:
    """Draw cells from a box: Sobol points (scrambled), a Latin hypercube, or independent ones.

    Points of a Sobol sequence spread best where their number is a power of two; other numbers are its
    beginning.

    Returns
    -------
    ndarray, shape (n, 4)
        Stiffness ratio, mass ratio, e1, e2; the same for the same seed.
    """
    d = len(sample.free())
    return sample.place(unit_points(sample.method, sample.n, d, sample.seed))


def unit_points(method: str, n: int, d: int, seed: int) -> NDArray[np.float64]:
    """Draw n points of the unit cube of d dimensions, shape (n, d)."""
    from scipy.stats import qmc

    if d == 0:
        return np.empty((n, 0))
    if method == "sobol":
        return qmc.Sobol(d, rng=seed).random_base2(math.ceil(math.log2(n)))[:n]
    if method == "latin-hypercube":
        return qmc.LatinHypercube(d, rng=seed).random(n)
    return np.random.default_rng(seed).random((n, d))


def read_cells(path: Path) -> NDArray[np.float64]:
    """Read cells from a file, one a row; columns other than those of `AXES` are ignored.

    Raises
    ------
    UserError
        One line with the file, the column, the row (from 1, a header not counted) and what is legal.
    """
    table = _read(path)
    missing = [name for name in AXES if name not in table.column_names]
    if missing:
        raise UserError(
            f"{path}: column {missing[0]} is missing; legal: columns {', '.join(AXES)} (others are ignored)"
        )
    if not 1 <= table.num_rows <= MAX_CELLS:
        raise UserError(f"{path}: {table.num_rows} rows; legal: 1 to {MAX_CELLS}")
    return np.column_stack([_checked(path, name, table.column(name)) for name in AXES])


def _read(path: Path) -> pa.Table:
    try:
        if path.suffix.lower() in (".parquet", ".pq"):
            names = [name for name in AXES if name in pq.read_schema(path).names]
            return pq.read_table(path, columns=names)
        return pacsv.read_csv(path)
    except FileNotFoundError:
        raise UserError(f"cells = {str(path)!r}: no such file; legal: a CSV or Parquet file") from None
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        detail = " ".join(str(error).split())[:160]
        raise UserError(f"{path}: cannot be read: {detail}; legal: a CSV or Parquet file") from None


def _checked(path: Path, name: str, column: pa.ChunkedArray) -> NDArray[np.float64]:
    if column.null_count:
        row = pc.index(column.is_null(), True).as_py()
        raise UserError(f"{path}: row {row + 1}: {name} is empty; legal: a number")
    try:
        values = column.cast(pa.float64()).to_numpy().astype(float)
    except pa.ArrowException:
        raise UserError(f"{path}: {name} is not a column of numbers ({column.type})") from None
    legal = (values >= LEGAL[name].low) & (values <= LEGAL[name].high)
    if not legal.all():
        row = int(np.argmin(legal))
        raise UserError(f"{path}: row {row + 1}: {name} = {value_problem(LEGAL[name], float(values[row]))}")
    return values


def _within_double_precision(config: Config, values: NDArray[np.float64], where: str) -> None:
    for i, name in enumerate(("stiffness_ratio", "mass_ratio")):
        found = config.product_problem(name, values[:, i])
        if found:
            raise UserError(f"{where}: row {found[0] + 1}: {found[1]}")
    masses = values[:, list(AXES).index("mass_ratio")]
    for row in map(int, (np.argmin(masses), np.argmax(masses))):
        problem = config.gravity_problem(float(masses[row]))
        if problem:
            raise UserError(f"{where}: row {row + 1}: {problem}")
