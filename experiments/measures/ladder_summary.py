"""What the divergence of the engines is made of, over many cells: by engine and by region.

The share of a contribution over a region is the sum of its components along the total over the sum of D (`ladder`): the
shares of an engine and region sum to 1. Its range is that of the same quotient over the six orders of the causes.
Grazing cells are left out, as in the rest of a summary.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.config.arrangements import COLUMN_AXES
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.aggregates import levels_of
from impact_xval.experiments.measures.corners import corner_names
from impact_xval.experiments.measures.ladder import (
    CAUSES,
    CONTRIBUTIONS,
    GRAVITY,
    MAPPING,
    NOTHING,
    Contribution,
    Floats,
    by_order,
)
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.parquet import codes, column, present, texts

#: A pandas DataFrame or Series; see `summary.Frame`.
Frame = Any

#: Regions of k2/k1, by their lower edge: what is much softer, comparable, much stiffer is the table.
BAND = "stiffness_band"
BANDS = {0.0: "k2/k1 < 0.1", 0.1: "0.1 <= k2/k1 <= 10", 10.0: "k2/k1 > 10"}

_LABELS = AXES | COLUMN_AXES

_REGION = ["solver", "axis", "value", "contribution"]
_NUMBERS = [
    "n",
    "total",
    "share",
    "low",
    "high",
    "mean",
    "median",
    "p95",
    "max",
    "dominant",
    "agreed",
    "doubt",
]


@dataclass(frozen=True, slots=True)
class LadderSummary:
    """Statistics of the ladders of a run.

    Attributes
    ----------
    statistics : DataFrame
        ``solver, axis ("all", an axis of the cells or "stiffness_band"), value, contribution, n, total, share, low,
        high, mean, median, p95, max, dominant, agreed, doubt``. `n` cells have the contribution, `total` is the mean D
        of the region, `share` its share of that, `low` and `high` the least and largest that the six orders of the
        causes give (the share itself for one that is no cause); `mean` to `max` are of its norm. It has the largest
        share in the fraction `dominant` of the cells; in the fraction `agreed` of the region the largest cause is the
        same by every order; `doubt` is the median of the estimated error of the engine's limit, where there is one.
    """

    statistics: Frame

    @property
    def solvers(self) -> list[str]:
        """The engines, in the order of the tables."""
        return list(dict.fromkeys(self.statistics.solver))

    @property
    def present(self) -> list[Contribution]:
        """The contributions that some cell has, in their order."""
        there = set(self.statistics.contribution)
        return [c for c in CONTRIBUTIONS if c.name in there]

    @property
    def orders(self) -> str:
        """In how many orders the causes can be taken: without gravity there are two of them."""
        return "six" if GRAVITY in self.present else "two"

    @property
    def axes(self) -> dict[str, str]:
        """The axes by whose values results are grouped, and how a reader knows them."""
        return {name: _LABELS[name] for name in dict.fromkeys(self.statistics.axis) if name in _LABELS}

    @property
    def regions(self) -> dict[str, tuple[str, Any]]:
        """Parts of the cells that are told apart: an axis and its value, by what a reader knows them by."""
        axes = set(self.statistics.axis)
        if BAND in axes:
            return {label: (BAND, edge) for edge, label in BANDS.items()}
        if "arrangement" not in axes:
            return {}
        names = self.statistics.value[self.statistics.axis == "arrangement"].unique()
        return {f"arrangement = {name}": ("arrangement", name) for name in names}

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
    """Compute the statistics of the ladders of a finished run."""
    return LadderSummary(ladder_statistics(folder.table_path("ladder.parquet"), config))


def ladder_statistics(path: Path, config: Config) -> Frame:
    """Compute `LadderSummary.statistics` from a table of ladders of any size, a column in memory at a time."""
    frames = [_engine_statistics(path, name, config) for name in config.solvers if is_engine(name)]
    frames = [frame for frame in frames if len(frame)]
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=[*_REGION, *_NUMBERS])


def _engine_statistics(path: Path, solver: str, config: Config) -> Frame:
    rows = (codes(path, "solver", [solver]) == 0) & (codes(path, "status", ["ok"]) == 0)
    rows &= ~present(path, "marked")
    if not np.any(rows):
        return pd.DataFrame()
    there = set(pq.read_schema(path).names)
    contributions = [c for c in CONTRIBUTIONS if f"{c.name}_norm" in there]
    regions = _regions(path, rows, config)
    total = column(path, "velocity_divergence")[rows]
    dominant = codes(path, "dominant", [c.name for c in contributions])[rows]
    agreed = column(path, "dominant_by_every_order")[rows]
    orders = _shares_by_order(path, rows, total, regions, contributions)
    apart = ~np.isnan(column(path, f"{MAPPING.name}_norm")[rows])
    doubt = np.where(apart, column(path, "limit_error")[rows], np.nan)
    values = pd.concat(
        pd.DataFrame(
            {
                "place": i,
                "norm": column(path, f"{contribution.name}_norm")[rows],
                "along": column(path, f"{contribution.name}_share")[rows] * total,
                "total": total,
                "dominant": dominant == i,
                "agreed": agreed,
                "doubt": doubt,
            }
        )
        for i, contribution in enumerate(contributions)
    )
    names = np.array([c.name for c in contributions])
    n_causes = sum(c in CAUSES for c in contributions)  # they come first
    frames = []
    for axis, region in regions.items():
        found = _by_region(values.assign(value=np.tile(region, len(contributions))))
        place = found.pop("place").to_numpy()
        found = found.assign(
            solver=solver, axis=axis, contribution=names[place], low=found.share, high=found.share
        )
        of_cause, (low, high) = place < n_causes, (f(orders[axis], axis=0) for f in (np.min, np.max))
        found.loc[of_cause, "low"], found.loc[of_cause, "high"] = low.ravel(), high.ravel()
        # by value, then by contribution, as they came
        frames.append(found.sort_values("value", kind="stable"))
    statistics = pd.concat(frames, ignore_index=True)
    statistics.loc[statistics.axis == "all", "value"] = np.nan
    return statistics[statistics.n > 0]


def _shares_by_order(
    path: Path,
    rows: NDArray[np.bool_],
    total: Floats,
    regions: dict[str, NDArray[Any]],
    contributions: Sequence[Contribution],
) -> dict[str, Floats]:
    """By axis, the share of every cause by order and value of the region, shape (6, causes, values).

    Components along the total are linear: those of the corners are summed over a region before they are split.
    """
    names = corner_names(gravity=GRAVITY in contributions)
    shape = tuple(1 + max(index[i] for index in names) for i in range(3))
    sums: dict[str, Floats] = {}
    for index, name in names.items():
        along = np.where(total >= NOTHING, column(path, f"{name}_along")[rows], 0.0)
        for axis, region in regions.items():
            values, place = np.unique(region, return_inverse=True)
            cube = sums.setdefault(axis, np.empty((*shape, len(values))))
            cube[index] = np.bincount(place, along)
    found = {}
    for axis, region in regions.items():
        whole = np.bincount(np.unique(region, return_inverse=True)[1], total)
        with np.errstate(invalid="ignore", divide="ignore"):
            found[axis] = np.where(whole > 0, by_order(sums[axis]) / whole, np.nan)
    return found


def _regions(path: Path, rows: NDArray[np.bool_], config: Config) -> dict[str, NDArray[Any]]:
    """By axis, the value by which every row is grouped; of columns only by axes that have several."""
    if config.column is not None:
        return {"all": np.zeros(int(rows.sum()))} | {
            axis: x
            for axis in COLUMN_AXES
            # strikers are of cradles alone
            if len(set(x := (texts if axis == "arrangement" else column)(path, axis)[rows])) > 1
            and not any(x != x)
        }
    scattered = config.sample is not None or config.cells is not None
    regions = {"all": np.zeros(int(rows.sum()))}
    for axis in AXES:
        x = column(path, axis)[rows]
        if axis == "stiffness_ratio":
            regions[BAND] = band_of(x)
        levels = levels_of(x) if scattered else None
        regions[axis] = x if levels is None else np.array(levels.values)[levels.codes(x)]
    return regions


def _by_region(values: Frame) -> Frame:
    """Compute the statistics of every contribution (`place`) in every region (`value`)."""
    groups = values.groupby(["place", "value"])
    norm = groups["norm"]
    sums = groups[["total", "along"]].sum()
    return pd.DataFrame(
        {
            "n": norm.count(),
            "total": sums.total / groups.size(),
            "share": sums.along / sums.total.where(sums.total > 0),
            "mean": norm.mean(),
            "median": norm.median(),
            "p95": norm.quantile(0.95),
            "max": norm.max(),
            "dominant": groups["dominant"].mean(),
            "agreed": groups["agreed"].mean(),
            "doubt": groups["doubt"].median(),
        }
    ).reset_index()


def csv_rows(ladder: LadderSummary) -> list[Frame]:
    """Return the statistics in the columns of ``summary.csv``: a norm, a share and its range, by cause and region."""
    table = ladder.statistics.assign(cells="regular")
    frames = [table.assign(measure="norm_" + table.contribution)]
    for measure, statistic in (("share", "share"), ("share_low", "low"), ("share_high", "high")):
        shares = table.assign(measure=f"{measure}_" + table.contribution, mean=table[statistic])
        shares[["median", "p95", "max"]] = np.nan
        frames.append(shares)
    left_out = ["contribution", "total", "share", "low", "high", "dominant", "agreed", "doubt"]
    return [frame.drop(columns=left_out) for frame in frames]
