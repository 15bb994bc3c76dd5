"""Ladders of rows that a test makes or changes."""

import pandas as pd
import pyarrow.compute as pc

from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.ladder_rows import ladders

KNOWN = ["cell", "solver", "stiffness_ratio", "mass_ratio", "e1"]


def ladder_rows(config, cells, block, engines=("mujoco",)):
    """Ladders of the rows of a table of cells, of which `block` holds those that are there; by cell, then by solver."""
    model = cells.filter(pc.field("solver") == REFERENCE)
    rows = {name: cells.filter(pc.field("solver") == name) for name in engines}
    found = ladders(config, block, model, rows)
    frames = [
        rows[name].to_pandas().filter(KNOWN).assign(**found[name], place=i) for i, name in enumerate(engines)
    ]
    table = pd.concat(frames).sort_values(["cell", "place"], kind="stable").drop(columns="place")
    return table.reset_index(drop=True)
