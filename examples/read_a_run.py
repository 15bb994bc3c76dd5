"""How far each solver of a finished run is from the model: with pandas, with xarray and with DuckDB.

Run as ``python examples/read_a_run.py [FOLDER]``, by default on ``runs/default``. It needs `pip install duckdb` and
`pip install 'impact-xval[arrays]'`. docs/experiments.md says where the columns and their units are.
"""

import sys
from pathlib import Path

import duckdb
import pandas as pd

from impact_xval.experiments.measures.arrays import to_xarray

run = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/default")

# A row of divergence.parquet is a cell and a compared solver; velocities and impulses are in cells.parquet.
print("pandas: median of D by solver")
divergence = pd.read_parquet(run / "divergence.parquet", columns=["solver", "cell", "velocity_divergence"])
print(divergence.groupby("solver", observed=True)["velocity_divergence"].median().to_string())

print("\nxarray: the same from an array with the axes of the grid, and its course over k2/k1")
data = to_xarray(run, ["velocity_divergence"]).velocity_divergence
for solver, D in data.groupby("solver"):
    if D.notnull().any():  # the model is not compared with itself
        over_ratio = D.median([axis for axis in D.dims if axis != "stiffness_ratio"])
        print(f"{solver:24} {float(D.median()):.6f}  {over_ratio.values.round(4)}")

print("\nDuckDB: the same, and the largest with its cell, reading no other columns of the file")
print(
    duckdb.sql(f"""
        SELECT solver, median(velocity_divergence) AS median, max(velocity_divergence) AS largest,
               arg_max(cell, velocity_divergence) AS cell, count(*) FILTER (status <> 'ok') AS not_ok
        FROM '{run}/divergence.parquet' GROUP BY solver ORDER BY solver
    """)
)
