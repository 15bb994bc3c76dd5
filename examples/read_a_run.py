"""How far each solver of a finished run is from the model: with pandas, with xarray and with DuckDB.

Run as ``python examples/read_a_run.py [FOLDER]``, by default on ``runs/default``. It needs `pip install duckdb xarray`.
docs/experiments.md says where the columns and their units are.
"""

import sys
from pathlib import Path

import duckdb
import pandas as pd

run = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/default")

# A row of divergence.parquet is a cell and a compared solver; velocities and impulses are in cells.parquet.
print("pandas: median of D by solver")
divergence = pd.read_parquet(run / "divergence.parquet", columns=["solver", "marked", "velocity_divergence"])
divergence = divergence[divergence.marked.isna()]  # beside a jump: no statistic has them
print(divergence.groupby("solver", observed=True)["velocity_divergence"].median().to_string())

print("\nxarray: the same from an array with the axes of the grid, and its course over k2/k1")
AXES = ["stiffness_ratio", "mass_ratio", "e1", "e2"]
cells = pd.read_parquet(
    run / "divergence.parquet", columns=["solver", "marked", *AXES, "velocity_divergence"]
)
data = cells[cells.marked.isna()].set_index(["solver", *AXES]).velocity_divergence.to_xarray()
for solver, D in data.groupby("solver"):
    over_ratio = D.median(["solver", "mass_ratio", "e1", "e2"])
    print(f"{solver:24} {float(D.median()):.6f}  {over_ratio.values.round(4)}")

print("\nDuckDB: the same, and the largest with its cell, reading no other columns of the file")
print(
    duckdb.sql(f"""
        SELECT solver, median(velocity_divergence) AS median, max(velocity_divergence) AS largest,
               arg_max(cell, velocity_divergence) AS cell, count(*) FILTER (status <> 'ok') AS not_ok
        FROM '{run}/divergence.parquet' WHERE marked IS NULL GROUP BY solver ORDER BY solver
    """)
)
