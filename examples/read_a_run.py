"""Print how far each solver of a finished run is from the model, by pandas, by xarray and by DuckDB.

Run as ``python examples/read_a_run.py [FOLDER]``. The default folder is ``runs/default``. The parts for xarray and
DuckDB need `pip install xarray duckdb`; a part whose package is missing is left out. docs/experiments.md describes the
columns and their units.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

import pandas as pd

run = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/default")
AXES = ["stiffness_ratio", "mass_ratio", "e1", "e2"]


def with_pandas() -> None:
    """Print the median D of each solver from a whole table, which has one row for each cell and compared solver."""
    print("pandas: median of D by solver")
    columns = ["solver", "marked", "velocity_divergence"]
    divergence = pd.read_parquet(run / "divergence.parquet", columns=columns)
    divergence = divergence[divergence.marked.isna()]  # marked rows are next to a jump of the outcome
    print(divergence.groupby("solver", observed=True)["velocity_divergence"].median().to_string())


def with_xarray() -> None:
    """Print the median D, whole and over k2/k1, from an array with the axes of the grid."""
    print("\nxarray: the same from an array with the axes of the grid, and its course over k2/k1")
    columns = ["solver", "marked", *AXES, "velocity_divergence"]
    cells = pd.read_parquet(run / "divergence.parquet", columns=columns)
    data = cells[cells.marked.isna()].set_index(["solver", *AXES]).velocity_divergence.to_xarray()
    for solver, D in data.groupby("solver"):
        over_ratio = D.median(["solver", "mass_ratio", "e1", "e2"])
        print(f"{solver:24} {float(D.median()):.6f}  {over_ratio.values.round(4)}")


def with_duckdb() -> None:
    """Print the median and the largest D by a query, which reads only the columns that it needs."""
    import duckdb

    print("\nDuckDB: the same, and the largest with its cell, reading no other columns of the file")
    print(
        duckdb.sql(f"""
            SELECT solver, median(velocity_divergence) AS median, max(velocity_divergence) AS largest,
                   arg_max(cell, velocity_divergence) AS cell, count(*) FILTER (status <> 'ok') AS not_ok
            FROM '{run}/divergence.parquet' WHERE marked IS NULL GROUP BY solver ORDER BY solver
        """)
    )


if __name__ == "__main__":
    with_pandas()
    for needed, part in (("xarray", with_xarray), ("duckdb", with_duckdb)):
        if find_spec(needed):
            part()
        else:
            print(f"\n{needed} is not installed: pip install {needed}")
