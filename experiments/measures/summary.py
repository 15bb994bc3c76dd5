"""Statistics of a finished run: by solver and axis, worst cells, agreement of paths, convergence estimates.

Marked rows, beside a jump of the model or of the exact law of their solver, are kept apart
everywhere: there an arbitrarily small difference may end in another outcome, so they say little about
physics.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import ArrayLike

from impact_xval.compliant_baselines.registry import exact_solver_for, is_engine, kind_of, sort_by_law
from impact_xval.compliant_baselines.rigid.laws import LAWS as RIGID_LAWS
from impact_xval.compliant_baselines.solver import MappingName
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import AXES_OF, REFERENCE, CellKind, Config
from impact_xval.experiments.measures.aggregates import (
    FULL_PATHS,
    OWN_LAW,
    STATISTICS,
    DivergenceTable,
    axis_levels,
    cuts,
    load_divergence,
    statistics_of,
)
from impact_xval.experiments.measures.corners import corner_names
from impact_xval.experiments.measures.ladder import (
    CONTRIBUTIONS,
    NOTHING,
    changes_by_order,
    contributions_of,
)
from impact_xval.experiments.tables.folder import RunFolder, Tally, statuses_of
from impact_xval.experiments.tables.frames import AxisValue, Frame, FrameRow, Record
from impact_xval.experiments.tables.parquet import (
    read_codes,
    read_column,
    read_selected,
    read_where_present,
    rows_at,
)
from impact_xval.model.arrays import Floats
from impact_xval.model.status import RESULT_STATUSES

#: Measures that are summarised, by their size: of two balls, of chains of N, and of graphs.
SUMMARISED = ("velocity_divergence", "dv1", "dv2", "dimpulse1", "dimpulse2")
SUMMARISED += ("dretained_energy", "impulse_curve_distance", "states_edit_distance")
SUMMARISED_OF_CHAINS = ("velocity_divergence", "largest_dv", "dretained_energy", "limit_distance")

SUMMARISED_OF_GRAPHS = (*SUMMARISED_OF_CHAINS, "asymmetry")

_SHARES = ("states_equal", FULL_PATHS, OWN_LAW)

#: An estimate is honest where the true error is at most this many times as large.
HONEST = 3.0

#: Regions of k2/k1, by their lower edge: what is much softer, comparable, much stiffer is the table.
BAND = "stiffness_band"
BANDS = {0.0: "k2/k1 < 0.1", 0.1: "0.1 <= k2/k1 <= 10", 10.0: "k2/k1 > 10"}

_OF_LADDERS = ["solver", "axis", "value", "contribution", "n", "mean", "median", "p95", "max"]
_OF_LADDERS += ["total", "share", "low", "high"]


class Summary:
    """Statistics of a finished run, computed from its stored tables, whatever their size."""

    def __init__(self, folder: RunFolder) -> None:
        self.config = config = folder.config()
        pair, cells, outcomes = config.kind == "pair", folder.table_path("cells.parquet"), folder.tally()
        #: The solvers that were compared with the reference, grouped by the law they were asked for.
        self.solvers = sort_by_law(name for name in config.solvers if name != REFERENCE)
        table = load_divergence(folder, config)
        #: Values by which the statistics are grouped, by axis; levels of the axes that have several.
        self.levels = table.levels
        self.axes = {axis: each.values for axis, each in self.levels.items() if len(each.values) > 1}
        #: `STATISTICS`: cells are "all", "regular" or "marked", an axis may be "all"; measures are taken by size, those
        #: of `_SHARES` have only a mean.
        self.statistics = rows = _statistics(table, config.kind)
        values = rows.value.where(rows.axis != "all", "")
        keys = zip(rows.solver, rows.measure, rows.axis, rows.cells, values, strict=True)
        self._places = {key: place for place, key in enumerate(keys)}
        #: The regular cells with the largest D of every solver, as rows of the divergence table.
        self.worst = _worst_rows(table, 5 if pair else 3)
        counts = pd.DataFrame.from_dict(statuses_of(outcomes), orient="index").fillna(0).astype(int)
        names = sorted(counts.columns, key=lambda name: ([name != each for each in RESULT_STATUSES], name))
        #: Number of cells by solver (index) and status (columns), the results first.
        self.statuses = counts.reindex(index=sort_by_law(config.solvers), columns=names, fill_value=0)
        #: ``solver, status, reason, n``: the most frequent reasons first.
        self.reasons: Frame = pd.DataFrame(
            count_reasons(outcomes), columns=["solver", "status", "reason", "n"]
        )
        self.between = pairwise_divergence(cells, config) if pair else pd.DataFrame()
        self.estimates = limit_estimates(cells, config.solvers, config.mapping, marked=pair)
        self.ladder = summarise_ladder(folder, config)
        # Rows of a cell are in the order of the solvers, the model first; where that is marked they all are.
        marked = read_where_present(cells, "marked").reshape(-1, len(config.solvers))
        result = (read_codes(cells, "status", RESULT_STATUSES) >= 0).reshape(marked.shape)
        beyond = (marked & result & ~marked[:, :1]).sum(axis=0).tolist()
        #: Cells, and those of them in which the model is marked.
        self.n_cells, self.n_marked = len(marked), int(marked[:, 0].sum())
        #: By solver, the model among them, the largest asymmetry of its results in symmetric graphs, and their number.
        self.asymmetries = largest_asymmetries(cells, config.solvers) if config.kind == "graph" else {}
        #: ``solver, law, n, median, p95, max``: distances between rigid engines and the rigid laws of the run.
        self.from_rigid_laws = (
            distances_from_rigid_laws(cells, config.solvers) if config.kind == "graph" else pd.DataFrame()
        )
        #: Of solvers the number of results that are marked where that of the model is not, where there are any.
        self.marked_beyond = {name: n for name, n in zip(config.solvers, beyond, strict=True) if n}

    def get(
        self,
        solver: str,
        measure: str,
        axis: str = "all",
        value: AxisValue = "",
        cells: str = "regular",
    ) -> FrameRow:
        """Return one row of the statistics; NaN numbers and n = 0 where nothing was compared."""
        place = self._places.get((solver, measure, axis, cells, "" if axis == "all" else value))
        if place is not None:
            return self.statistics.iloc[place]
        return pd.Series({"n": 0} | dict.fromkeys(("mean", "median", "p95", "max"), np.nan), dtype=object)


def summarise(folder: RunFolder) -> Summary:
    """Compute the statistics of a finished run."""
    return Summary(folder)


def count_reasons(outcomes: Tally) -> list[tuple[str, str, str, int]]:
    """Return why rows have no result: solver, status, reason and number, the most frequent reasons first."""
    rows = [(*key, n) for key, n in outcomes.items() if key[1] not in RESULT_STATUSES]
    return sorted(rows, key=lambda row: (-row[3], row[0], row[2], row[1]))


def _statistics(table: DivergenceTable, kind: CellKind) -> Frame:
    """Compute `Summary.statistics`: of two balls by axis for regular cells only, and shares of equal paths."""
    frames = []
    pair = kind == "pair"
    measures = {
        "pair": (*SUMMARISED, *_SHARES),
        "chain": SUMMARISED_OF_CHAINS,
        "graph": SUMMARISED_OF_GRAPHS,
    }
    parts = {
        "all": table.rows.compared,
        "regular": table.regular,
        "marked": table.rows.compared & table.rows.marked,
    }
    for measure in measures[kind]:
        sized = table.rows.assign(size=np.abs(table.measure(measure)))
        for cells, kept in parts.items():
            rows = sized[kept]
            for axis in ("all", *table.levels) if cells == "regular" or not pair else ("all",):
                keys = ["solver", *([] if axis == "all" else [axis])]
                groups = rows.groupby(keys, observed=True)["size"]
                shares = {"n": groups.count(), "mean": groups.mean()}
                found = pd.DataFrame(shares if measure in _SHARES else statistics_of(groups)).reset_index()
                found = found.rename(columns={axis: "value"})
                frames.append(found.assign(cells=cells, axis=axis, measure=measure))
    kinds = {"solver": str, "value": float if pair else object, "median": float}
    filled = [frame.reindex(columns=STATISTICS).astype(kinds) for frame in frames if len(frame)]
    return pd.concat(filled, ignore_index=True) if filled else pd.DataFrame(columns=STATISTICS)


def _worst_rows(table: DivergenceTable, count: int) -> Frame:
    """Read the regular rows with the largest D of every solver, by solver, then from the largest."""
    rows = table.rows.assign(d=table.measure("velocity_divergence"))[table.regular]
    largest = rows.sort_values(["solver", "d"], ascending=[True, False], kind="stable")
    picked = largest.groupby("solver", observed=True).head(count).index
    return rows_at(table.path, picked.tolist()).to_pandas()


def pairwise_divergence(path: Path, config: Config) -> Frame:
    """Compute D between every two compliant solvers, over the cells of pairs that both solved; no marked rows.

    Columns: ``solver, other, n, median, p95, max``. D is near zero where two solvers differ from the model by the same.
    """
    done = (read_codes(path, "status", RESULT_STATUSES) >= 0) & ~read_where_present(path, "marked")
    speed = np.where(done, np.abs(read_column(path, "v0")), np.nan)
    u1 = (read_column(path, "v1") / speed).reshape(-1, len(config.solvers))
    u2 = (np.sqrt(read_column(path, "mass_ratio")) * read_column(path, "v2") / speed).reshape(u1.shape)
    rows = []
    for (a, name), (b, other) in combinations(enumerate(config.solvers), 2):
        d = pd.Series(np.hypot(u1[:, a] - u1[:, b], u2[:, a] - u2[:, b])).dropna()
        if REFERENCE not in (name, other) and len(d):
            rows.append({"solver": name, "other": other, "n": len(d), **cuts(d)})
    return pd.DataFrame(rows, columns=["solver", "other", "n", "median", "p95", "max"])


def largest_asymmetries(path: Path, solvers: Sequence[str]) -> dict[str, tuple[float, int]]:
    """Return the largest asymmetry of each solver, per abs(v0), and the number of symmetric graphs that it solved."""
    done = read_codes(path, "status", RESULT_STATUSES) >= 0
    values = np.where(done, read_column(path, "asymmetry"), np.nan).reshape(-1, len(solvers))
    found: dict[str, tuple[float, int]] = {}
    for name, column in zip(solvers, values.T, strict=True):
        known = column[~np.isnan(column)]
        if len(known):
            found[name] = float(known.max()), len(known)
    return found


def distances_from_rigid_laws(path: Path, solvers: Sequence[str]) -> Frame:
    """Compute how far each rigid engine is from each rigid law of a run of graphs, over the graphs that both solved.

    A distance is the largest difference of a component of velocity, per abs(v0). Columns: ``solver, law, n, median,
    p95, max``.
    """
    components = [name for name in pq.read_schema(path).names if re.fullmatch(r"v[1-9]\d*[xz]", name)]
    done = (read_codes(path, "status", RESULT_STATUSES) >= 0) & ~read_where_present(path, "marked")
    speed = np.where(done, np.abs(read_column(path, "v0")), np.nan)
    velocities = np.array([read_column(path, name) / speed for name in components])
    velocities = velocities.reshape(len(components), -1, len(solvers))
    is_solved = np.asarray(~np.isnan(velocities).all(axis=0))
    rows: list[Record] = []
    for place, name in enumerate(solvers):
        if kind_of(name) != "rigid" or not is_engine(name):
            continue
        for place_of_law, law in enumerate(solvers):
            if law not in RIGID_LAWS:
                continue
            both = is_solved[:, place] & is_solved[:, place_of_law]
            differences = np.abs(velocities[:, both, place] - velocities[:, both, place_of_law])
            if both.any():
                distances = pd.Series(np.nanmax(differences, axis=0))
                rows.append({"solver": name, "law": law, "n": len(distances), **cuts(distances)})
    return pd.DataFrame(rows, columns=["solver", "law", "n", "median", "p95", "max"])


def limit_estimates(
    path: Path, solvers: Sequence[str], mapping: MappingName = "calibrated", *, marked: bool = True
) -> Frame:
    """Compute how far each engine is from its limit dt -> 0, and how well that is known, from the table of cells.

    One row per engine. Errors and distances are of velocities per abs(v0), the largest of all balls. Columns:

    * ``solver``; ``asked``, the exact solver of the law that the engine was asked for, "" without one;
    * ``n``, the number of limits; ``converged``, the number of those that converged;
    * ``order``, the median; ``regularisation``, the largest;
    * ``error_median``, ``error_p95``, ``error_max``: of the estimated errors; ``step_...``: of the distances between
      the limits and the velocities at the step; ``asked_...``: of the distances between the limits and the exact
      solver, where that is in the run;
    * ``held``, the number of these last distances; ``honest``, the share of them that are at most `HONEST` times the
      estimate.

    Without `marked` the marked rows are left out.
    """
    limits = [name for name in pq.read_schema(path).names if re.fullmatch(r"v\d+[xz]?_limit", name)]
    velocities = [name.removesuffix("_limit") for name in limits]
    known = ["solver", "status", "v0", "limit_error", "limit_distance", "order", "regularisation"]
    rows = []
    for name in solvers:
        keep = (pc.field("solver") == name) & pc.field(limits[0]).is_valid()
        if not marked:
            keep &= pc.field("marked").is_null()
        table = read_selected(path, [*known, *limits, *velocities], keep).to_pandas()
        if not len(table):
            continue
        good = table[table.status.isin(RESULT_STATUSES)]
        at_step = good[velocities].div(good.v0.abs(), axis=0).set_axis(limits, axis=1)
        error = good.limit_distance.dropna()
        stated = good.limit_error[error.index]
        row = {
            "solver": name,
            "asked": exact_solver_for(name, mapping),
            "n": len(table),
            "converged": len(good),
        }
        # pandas 2.2 warns of a median of nothing but NaN.
        row |= {"order": table.order.dropna().median(), "regularisation": good.regularisation.max()}
        distances = {
            "error": good.limit_error,
            "step": (at_step - good[limits]).abs().max(axis=1),
            "asked": error,
        }
        row |= {f"{kind}_{cut}": x for kind, values in distances.items() for cut, x in cuts(values).items()}
        rows.append(row | {"held": len(error), "honest": (error <= HONEST * stated).mean()})
    return pd.DataFrame(rows)


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
        self.orders = "six" if any(c.needs_gravity for c in self.present) else "two"
        arrangements = statistics.value[statistics.axis == "arrangement"].unique()
        #: Parts of the cells that are told apart: an axis and its value, by what a reader knows them by.
        self.regions: dict[str, tuple[str, AxisValue]] = (
            {label: (BAND, edge) for edge, label in BANDS.items()}
            if BAND in self.axes
            else {f"arrangement = {name}": ("arrangement", name) for name in arrangements}
        )

    def region(self, solver: str, axis: str = "all", value: AxisValue = np.nan) -> Frame:
        """Return the rows of one engine and region, indexed by contribution; empty where nothing was compared."""
        table = self.statistics
        found = table[(table.solver == solver) & (table.axis == axis)]
        if axis != "all":
            found = found[found.value == value]
        return found.set_index("contribution")


def band_of(stiffness_ratio: ArrayLike) -> Floats:
    """Return the lower edge of the band of each k2/k1."""
    ratio = np.asarray(stiffness_ratio, dtype=float)
    return np.where(ratio < 0.1, 0.0, np.where(ratio <= 10.0, 0.1, 10.0))


def summarise_ladder(folder: RunFolder, config: Config) -> LadderSummary:
    """Compute the statistics of the ladders of a finished run, the rows of an engine in memory at a time."""
    path, pair, frames = folder.table_path("ladder.parquet"), config.kind == "pair", []
    columns = [f"{c.name}_{number}" for c in contributions_of(gravity=pair) for number in ("norm", "share")]
    columns += [f"{name}_along" for name in corner_names(gravity=pair).values()]
    columns += [*AXES_OF[config.kind], "velocity_divergence"]
    regular = (pc.field("status") == "ok") & pc.field("marked").is_null()  # others count in no statistic
    for solver in filter(is_engine, config.solvers):
        rows = read_selected(path, columns, regular & (pc.field("solver") == solver)).to_pandas()
        for axis, region in (_region_values(rows, config) if len(rows) else {}).items():
            found = _statistics_by_region(rows, pd.Series(region, name="value"), gravity=pair)
            frames.append(found.assign(solver=solver, axis=axis))
    if not frames:
        return LadderSummary(pd.DataFrame(columns=_OF_LADDERS))
    statistics = pd.concat(frames, ignore_index=True)
    statistics.loc[statistics.axis == "all", "value"] = np.nan
    return LadderSummary(statistics.loc[statistics.n > 0, _OF_LADDERS].reset_index(drop=True))


def _region_values(rows: Frame, config: Config) -> dict[str, np.ndarray]:
    """Return by axis the value by which every row is grouped; for chains only axes with several values."""
    regions: dict[str, np.ndarray] = {"all": np.zeros(len(rows))}
    if config.kind != "pair":
        # strikers are of cradles alone
        several = [
            axis for axis in AXES_OF[config.kind] if rows[axis].nunique() > 1 and rows[axis].notna().all()
        ]
        return regions | {axis: np.asarray(rows[axis]) for axis in several}
    for axis in AXES:
        x = rows[axis].to_numpy()
        if axis == "stiffness_ratio":
            regions[BAND] = band_of(x)
        levels = axis_levels(config, axis, x)
        regions[axis] = np.array(levels.values)[levels.codes(x)]
    return regions


def _statistics_by_region(rows: Frame, region: Frame, *, gravity: bool) -> Frame:
    """Compute the statistics of every contribution in every region, by value, then by contribution."""
    contributions = contributions_of(gravity=gravity)
    names = [c.name for c in contributions]
    causes = [c.name for c in contributions if c.is_cause]
    total = rows.velocity_divergence
    norms = rows[[f"{name}_norm" for name in names]].set_axis(names, axis=1)
    along = rows[[f"{name}_share" for name in names]].set_axis(names, axis=1).mul(total, axis=0)
    sums = total.groupby(region).sum()
    whole = sums.where(sums > 0)
    share = along.groupby(region).sum().div(whole, axis=0)
    # Components along the total are linear: those of the corners are summed over a region before they are split.
    corners = corner_names(gravity=gravity)
    along_corners = rows[[f"{name}_along" for name in corners.values()]].where(total >= NOTHING, 0.0)
    sums_of_corners = along_corners.groupby(region).sum()
    cube = np.empty((2, 2, 1 + gravity, len(whole)))
    for index, name in corners.items():
        cube[index] = sums_of_corners[f"{name}_along"]
    shares_by_order = changes_by_order(cube) / whole.to_numpy()
    statistics = {
        **statistics_of(norms.groupby(region)),
        "share": share,
        "low": share.assign(**dict(zip(causes, shares_by_order.min(axis=0), strict=True))),
        "high": share.assign(**dict(zip(causes, shares_by_order.max(axis=0), strict=True))),
    }
    table = pd.concat(statistics, axis=1, names=["statistic", "contribution"]).stack(future_stack=True)
    return table.join(total.groupby(region).mean().rename("total")).reset_index()


def ladder_statistics_for_csv(ladder: LadderSummary) -> list[Frame]:
    """Return the statistics of ladders as rows of ``summary.csv``: norms, shares and their ranges."""
    table = ladder.statistics.assign(cells="regular")
    frames = [table.assign(measure="norm_" + table.contribution)]
    for measure, statistic in (("share", "share"), ("share_low", "low"), ("share_high", "high")):
        shares = table[["solver", "cells", "axis", "value", "n"]]
        frames.append(shares.assign(measure=f"{measure}_" + table.contribution, mean=table[statistic]))
    return [frame.reindex(columns=STATISTICS) for frame in frames]
