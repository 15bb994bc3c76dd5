"""A sweep of one's own, to a figure: D of two contact laws over the stiffness ratio.

``python examples/sweep_to_figure.py [FOLDER]`` writes ``runs/sweep-to-figure`` (or FOLDER), the figure
``d-over-stiffness.png`` among it.
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import pandas as pd

from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.sweep.run import run_sweep

EXPERIMENT = {
    "name": "sweep to a figure",
    "scenario": "impact",
    "solvers": ["state-transition", "kelvin-voigt", "hunt-crossley"],
    "grid": {
        "stiffness_ratio": {"log": [1e-2, 1e2, 25]},
        "mass_ratio": [1.0],
        "e1": [0.8, 0.9],
        "e2": [0.8, 0.9],
    },
}


def main(folder: Path) -> Path:
    """Run the sweep into a folder that is not there yet, and draw its figure."""
    run_sweep(parse_config(EXPERIMENT), folder, workers=1)
    rows = pd.read_parquet(folder / "divergence.parquet")
    good = rows[rows.marked.isna() & rows.velocity_divergence.notna()]
    table = good.pivot_table("velocity_divergence", "stiffness_ratio", "solver", aggfunc="median")
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for solver in table.columns:
        axes.loglog(table.index, table[solver], marker=".", label=solver)
    axes.set_xlabel("stiffness ratio k2/k1")
    axes.set_ylabel("D from the model, median over e1 and e2")
    axes.legend()
    path = folder / "d-over-stiffness.png"
    figure.savefig(path, dpi=150)
    plt.close(figure)
    print(table.iloc[[0, len(table) // 2, -1]].round(4).to_string())
    return path


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("runs/sweep-to-figure"))
