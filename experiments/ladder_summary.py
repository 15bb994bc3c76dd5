"""What the divergence of the engines is made of, over many cells: by engine and by region.

The share of a rung over a region is the sum of its components along the total over the sum of D (`ladder`): the
shares of an engine and region sum to 1. Grazing cells are left out, as in the rest of a summary.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from compliant_baselines.bistiffness import bistiffness_batch
from experiments.config import REFERENCE, Config
from experiments.ladder import ENGINE_FREE, KELVIN_VOIGT, LAWS, MAPPING, RUNGS
from experiments.ladder_table import LADDER, LADDER_SCHEMA
from experiments.levels import Levels, levels_of
from experiments.store import RunFolder

#: A pandas DataFrame or Series; see `summary.Frame`.
Frame = Any

AXES = ("stiffness_ratio", "mass_ratio", "e1", "e2")

#: Regions of k2/k1, by their lower edge: what is much softer, comparable, much stiffer is the table.
BAND = "stiffness_band"
BANDS = {0.0: "k2/k1 < 0.1", 0.1: "0.1 <= k2/k1 <= 10", 10.0: "k2/k1 > 10"}

#: Largest run whose cells are asked "what if" for a summary: some ten seconds.
MOST_ALTERNATIVES = 200_000


@dataclass(frozen=True, slots=True)
class LadderSummary:
    """Statistics of the ladders of a run.

    Attributes
    ----------
    statistics : DataFrame
        ``solver, axis ("all", an axis of the grid or "stiffness_band"), value, rung, n, total, share, mean, median,
        p95, max, dominant, doubt``: `n` cells have the rung, `total` is the mean D of the region, `share` the rung's
        share of it, `mean` to `max` are of its norm, it has the largest share in the fraction `dominant` of the cells,
        and `doubt` is the median of the estimated error of the engine's limit, where there is one.
    alternatives : DataFrame
        "What if" without an engine, no gravity: ``law, value (a band's lower edge, NaN for all), n, median, p95`` of D
        from the model, ``closer``, the fraction of cells in which that D is less than kelvin-voigt's, and
        ``dissipation``, the median norm of law minus bistiffness. Empty for grids that are too large.
    """

    statistics: Frame
    alternatives: Frame

    @property
    def solvers(self) -> list[str]:
        """The engines, in the order of the tables."""
        return list(dict.fromkeys(self.statistics.solver))

    def region(self, solver: str, axis: str = "all", value: float = np.nan) -> Frame:
        """Return the rows of one engine and region, indexed by rung; empty where nothing was compared."""
        table = self.statistics
        found = table[(table.solver == solver) & (table.axis == axis)]
        if axis != "all":
            found = found[found.value == value]
        return found.set_index("rung")


def band_of(stiffness_ratio: Any) -> Any:
    """Lower edge of the band of each k2/k1."""
    ratio = np.asarray(stiffness_ratio, dtype=float)
    return np.where(ratio < 0.1, 0.0, np.where(ratio <= 10.0, 0.1, 10.0))


def summarise_ladder(folder: RunFolder, config: Config) -> LadderSummary:
    """Compute the statistics of the ladders of a finished run."""
    path = folder.table_path(LADDER, LADDER_SCHEMA)
    needed = ("solver", "status", "model_grazing_margin", "velocity_divergence", "limit_error", "dominant")
    measured = (f"{rung.name}_{part}" for rung in RUNGS for part in ("norm", "share"))
    names = [name for name in (*needed, *AXES, *measured) if name in LADDER_SCHEMA.names]
    table = pq.read_table(path, columns=names, read_dictionary=["solver", "status", "dominant"]).to_pandas(
        split_blocks=True, self_destruct=True
    )
    if config.sample is not None or config.cells is not None:  # scattered cells: grouped by bins
        for axis in AXES:
            x = table[axis].to_numpy()
            levels = levels_of(x) if len(x) else Levels([])
            table[axis] = np.array(levels.values)[levels.codes(x)]
    return LadderSummary(statistics_of(table, config), _alternatives(folder, config))


def statistics_of(table: Frame, config: Config) -> Frame:
    """Compute `LadderSummary.statistics` from a table of ladders."""
    table = table[(table.status == "ok") & ~(table.model_grazing_margin < config.grazing_threshold)]
    table = table.assign(**{BAND: band_of(table.stiffness_ratio)})
    frames = [
        _region_statistics(part, solver, axis, value)
        for solver in config.solvers
        if solver not in ENGINE_FREE
        for axis in ("all", BAND, *AXES)
        for value, part in _regions(table[table.solver == solver], axis)
    ]
    columns = ["solver", "axis", "value", "rung", "n", "total", "share", "mean", "median", "p95", "max"]
    columns += ["dominant", "doubt"]
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=columns)


def _regions(table: Frame, axis: str) -> list[tuple[float, Frame]]:
    if not len(table):
        return []
    if axis == "all":
        return [(np.nan, table)]
    return [(float(value), part) for value, part in table.groupby(axis)]


def _region_statistics(part: Frame, solver: str, axis: str, value: float) -> Frame:
    total = part.velocity_divergence.sum()
    rows = []
    for rung in RUNGS:
        if f"{rung.name}_norm" not in part:
            continue
        norm = part[f"{rung.name}_norm"].dropna()
        if not len(norm):
            continue
        along = (part[f"{rung.name}_share"] * part.velocity_divergence).sum()
        rows.append(
            {
                "solver": solver,
                "axis": axis,
                "value": value,
                "rung": rung.name,
                "n": len(norm),
                "total": total / len(part),
                "share": along / total if total else np.nan,
                "mean": norm.mean(),
                "median": norm.median(),
                "p95": norm.quantile(0.95),
                "max": norm.max(),
                "dominant": float((part.dominant == rung.name).mean()),
                "doubt": part.limit_error[part[f"{MAPPING.name}_norm"].notna()].median(),
            }
        )
    return pd.DataFrame(rows)


def _alternatives(folder: RunFolder, config: Config) -> Frame:
    """Ask every law what it would do, over the cells of a run."""
    columns = ["law", "value", "n", "median", "p95", "closer", "dissipation"]
    path = folder.root / "cells.parquet"
    if pq.read_metadata(path).num_rows > MOST_ALTERNATIVES * len(config.solvers):
        return pd.DataFrame(columns=columns)
    read = ("stiffness_ratio", "mass_ratio", "e1", "e2", "v0", "v1", "v2", "grazing_margin")
    table = pq.read_table(path, columns=list(read), filters=[("solver", "==", REFERENCE)])
    kappa, mass_ratio, e1, e2, v0, v1, v2, margin = (table[name].to_numpy().astype(float) for name in read)
    cells, band = (kappa, mass_ratio, e1, e2), band_of(kappa)
    model = SimpleNamespace(v1=v1 / abs(v0), v2=v2 / abs(v0))
    stiff = bistiffness_batch(*cells)
    regular = ~(margin < config.grazing_threshold)

    def distance(a: Any, b: Any) -> Any:
        return np.hypot(a.v1 - b.v1, np.sqrt(mass_ratio) * (a.v2 - b.v2))

    answers = {law: answer(*cells) for law, answer in LAWS.items()}
    kept = distance(answers[KELVIN_VOIGT], model)
    rows = []
    for law, answer in answers.items():
        away, left = distance(answer, model), distance(answer, stiff)
        for value in (np.nan, *BANDS):
            here = regular & np.isfinite(away) & np.isfinite(left) & np.isfinite(kept)
            here &= np.isnan(value) | (band == value)
            if np.any(here):
                median, p95 = np.quantile(away[here], [0.5, 0.95])
                closer = np.mean(away[here] < kept[here])
                rows.append((law, value, int(here.sum()), median, p95, closer, np.median(left[here])))
    return pd.DataFrame(rows, columns=columns)
