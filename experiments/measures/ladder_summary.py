"""What the divergence of the engines is made of, over many cells: by engine and by region.

The shares of an engine and region (`ladder`) sum to 1. Marked cells are left out, as in the rest of a summary.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pyarrow.compute as pc

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.config.arrangements import COLUMN_AXES
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.aggregates import STATISTICS, Frame, axis_levels, statistics_of
from impact_xval.experiments.measures.corners import corner_names
from impact_xval.experiments.measures.ladder import (
    CAUSES,
    CONTRIBUTIONS,
    NOTHING,
    by_order,
    contributions_of,
)
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.parquet import selected

#: Regions of k2/k1, by their lower edge: what is much softer, comparable, much stiffer is the table.
BAND = "stiffness_band"
BANDS = {0.0: "k2/k1 < 0.1", 0.1: "0.1 <= k2/k1 <= 10", 10.0: "k2/k1 > 10"}

_COLUMNS = ["solver", "axis", "value", "contribution", "n", "mean", "median", "p95", "max"]
_COLUMNS += ["total", "share", "low", "high"]


class LadderSummary:
    """Statistics of the ladders of a run."""

    def __init__(self, statistics: Frame) -> None:
        #: ``solver, axis ("all", an axis of the cells or "stiffness_band"), value, contribution``; ``n`` cells have the
        #: contribution, ``mean, median, p95, max`` are of its norm; ``total`` is the mean D of the region, ``share``
        #: its share of that, ``low`` and ``high`` the least and largest that the orders of the causes give (the share
        #: itself for one that is no cause).
        self.statistics = statistics
        #: The engines, in the order of the tables, and what results are grouped by.
        self.solvers, self.axes = (list(dict.fromkeys(statistics[name])) for name in ("solver", "axis"))
        #: The contributions that some cell has, in their order.
        self.present = [c for c in CONTRIBUTIONS if c.name in set(statistics.contribution)]
        #: In how many orders the causes can be taken: without gravity there are two of them.
        self.orders = "six" if CAUSES[-1] in self.present else "two"
        arrangements = statistics.value[statistics.axis == "arrangement"].unique()
        #: Parts of the cells that are told apart: an axis and its value, by what a reader knows them by.
        self.regions: dict[str, tuple[str, Any]] = (
            {label: (BAND, edge) for edge, label in BANDS.items()}
            if BAND in self.axes
            else {f"arrangement = {name}": ("arrangement", name) for name in arrangements}
        )

    def region(self, solver: str, axis: str = "all", value: Any = np.nan) -> Frame:
        """Return the rows of one engine and region, indexed by contribution; empty where nothing was compared."""
        table = self.statistics
        found = table[(table.solver == solver) & (table.axis == axis)]
        if axis != "all":
            found = found[found.value == value]
        return found.set_index("contribution")


def band_of(stiffness_ratio: Any) -> Any:
    """Lower edge of the band of each k2/k1."""
    ratio = np.asarray(stiffness_ratio, dtype=float)
    return np.where(ratio < 0.1, 0.0, np.where(ratio <= 10.0, 0.1, 10.0))


def summarise_ladder(folder: RunFolder, config: Config) -> LadderSummary:
    """Compute the statistics of the ladders of a finished run, the rows of an engine in memory at a time."""
    path, pair, frames = folder.table_path("ladder.parquet"), config.column is None, []
    columns = [f"{c.name}_{number}" for c in contributions_of(gravity=pair) for number in ("norm", "share")]
    columns += [f"{name}_along" for name in corner_names(gravity=pair).values()]
    columns += [*(AXES if pair else COLUMN_AXES), "velocity_divergence"]
    regular = (pc.field("status") == "ok") & pc.field("marked").is_null()  # others count in no statistic
    for solver in filter(is_engine, config.solvers):
        rows = selected(path, columns, regular & (pc.field("solver") == solver)).to_pandas()
        for axis, region in (_regions(rows, config) if len(rows) else {}).items():
            found = _by_region(rows, pd.Series(region, name="value"), gravity=pair)
            frames.append(found.assign(solver=solver, axis=axis))
    if not frames:
        return LadderSummary(pd.DataFrame(columns=_COLUMNS))
    statistics = pd.concat(frames, ignore_index=True)
    statistics.loc[statistics.axis == "all", "value"] = np.nan
    return LadderSummary(statistics.loc[statistics.n > 0, _COLUMNS].reset_index(drop=True))


def _regions(rows: Frame, config: Config) -> dict[str, Any]:
    """By axis, the value by which every row is grouped; of columns only by axes that have several."""
    regions: dict[str, Any] = {"all": np.zeros(len(rows))}
    if config.column is not None:
        # strikers are of cradles alone
        several = [axis for axis in COLUMN_AXES if rows[axis].nunique() > 1 and rows[axis].notna().all()]
        return regions | {axis: np.asarray(rows[axis]) for axis in several}
    for axis in AXES:
        x = rows[axis].to_numpy()
        if axis == "stiffness_ratio":
            regions[BAND] = band_of(x)
        levels = axis_levels(config, axis, x)
        regions[axis] = np.array(levels.values)[levels.codes(x)]
    return regions


def _by_region(rows: Frame, region: Frame, *, gravity: bool) -> Frame:
    """Compute the statistics of every contribution in every region, by value, then by contribution."""
    names = [c.name for c in contributions_of(gravity=gravity)]
    total = rows.velocity_divergence
    norms = rows[[f"{name}_norm" for name in names]].set_axis(names, axis=1)
    along = rows[[f"{name}_share" for name in names]].set_axis(names, axis=1).mul(total, axis=0)
    sums = total.groupby(region).sum()
    whole = sums.where(sums > 0)
    share = along.groupby(region).sum().div(whole, axis=0)
    # Components along the total are linear: those of the corners are summed over a region before they are split.
    corners = rows[[f"{name}_along" for name in corner_names(gravity=gravity).values()]]
    cube = corners.where(total >= NOTHING, 0.0).groupby(region).sum().to_numpy().T
    by_orders = by_order(cube.reshape(2, 2, -1, len(whole))) / whole.to_numpy()
    causes = names[: by_orders.shape[1]]  # they come first
    of_each = {
        **statistics_of(norms.groupby(region)),
        "share": share,
        "low": share.assign(**dict(zip(causes, by_orders.min(axis=0), strict=True))),
        "high": share.assign(**dict(zip(causes, by_orders.max(axis=0), strict=True))),
    }
    found = pd.concat(of_each, axis=1, names=["statistic", "contribution"]).stack(future_stack=True)
    return found.join(total.groupby(region).mean().rename("total")).reset_index()


def csv_rows(ladder: LadderSummary) -> list[Frame]:
    """Return the statistics in the columns of ``summary.csv``: a norm, a share and its range, by cause and region."""
    table = ladder.statistics.assign(cells="regular")
    frames = [table.assign(measure="norm_" + table.contribution)]
    for measure, statistic in (("share", "share"), ("share_low", "low"), ("share_high", "high")):
        shares = table[["solver", "cells", "axis", "value", "n"]]
        frames.append(shares.assign(measure=f"{measure}_" + table.contribution, mean=table[statistic]))
    return [frame.reindex(columns=STATISTICS) for frame in frames]
