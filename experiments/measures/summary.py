"""Statistics of a finished run, computed from its tables.

They are statistics of the divergence by solver and by axis, the cells with the largest divergence, the agreement of
state paths, the convergence of engines, and statistics of the contributions to the divergence. The pages of a run and
``summary.csv`` show these statistics.

A row is marked if it lies next to a jump of the outcome. The outcome may be the model's, or that of the exact law of
the row's solver. Next to a jump an arbitrarily small difference of parameters may lead to another outcome, so that
marked rows say little about physics. All other rows are called regular. All statistics keep marked and regular rows
apart.
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

#: Measures whose absolute values are summarised, for each kind of run: two balls, chains of N balls, contact graphs.
SUMMARISED = ("velocity_divergence", "dv1", "dv2", "dimpulse1", "dimpulse2")
SUMMARISED += ("dretained_energy", "impulse_curve_distance", "states_edit_distance")
SUMMARISED_OF_CHAINS = ("velocity_divergence", "largest_dv", "dretained_energy", "limit_distance")

SUMMARISED_OF_GRAPHS = (*SUMMARISED_OF_CHAINS, "asymmetry")

#: Measures that are true or false in each row. The mean of such a measure is the share of rows in which it is true.
_SHARES = ("states_equal", FULL_PATHS, OWN_LAW)

#: Largest ratio of an engine's true error to its estimated error for which the estimate is called honest.
HONEST = 3.0

#: Name of an axis whose values are three regions of k2/k1; and the three regions, by the lower edge of each. In the
#: regions the table contact is much softer than the contact of the balls, of similar stiffness, or much stiffer.
BAND = "stiffness_band"
BANDS = {0.0: "k2/k1 < 0.1", 0.1: "0.1 <= k2/k1 <= 10", 10.0: "k2/k1 > 10"}

#: Columns of `LadderSummary.statistics`.
_OF_LADDERS = ["solver", "axis", "value", "contribution", "n", "mean", "median", "p95", "max"]
_OF_LADDERS += ["total", "share", "low", "high"]


class Summary:
    """Statistics of a finished run, computed from its stored tables.

    The tables may be larger than the memory.
    """

    def __init__(self, folder: RunFolder) -> None:
        self.config = config = folder.config()
        pair, cells, outcomes = config.kind == "pair", folder.table_path("cells.parquet"), folder.tally()
        #: The solvers that were compared with the model, grouped by the law that they were asked for.
        self.solvers = sort_by_law(name for name in config.solvers if name != REFERENCE)
        table = load_divergence(folder, config)
        #: Levels of every axis, by which the statistics are grouped. `axes` has the values of the levels, but only for
        #: axes that have several levels.
        self.levels = table.levels
        self.axes = {axis: each.values for axis, each in self.levels.items() if len(each.values) > 1}
        #: Statistics with the columns `STATISTICS`. In the column ``cells`` stands "all", "regular" or "marked". In the
        #: column ``axis`` stands the name of an axis, or "all" for statistics over all its levels. Statistics are of
        #: absolute values. A measure in `_SHARES` has only a number and a mean.
        self.statistics = rows = _statistics(table, config.kind)
        values = rows.value.where(rows.axis != "all", "")
        keys = zip(rows.solver, rows.measure, rows.axis, rows.cells, values, strict=True)
        self._places = {key: place for place, key in enumerate(keys)}
        #: For each solver, the regular cells in which it has its largest divergence D from the model. They are rows of
        #: the table of divergence.
        self.worst = _worst_rows(table, 5 if pair else 3)
        counts = pd.DataFrame.from_dict(statuses_of(outcomes), orient="index").fillna(0).astype(int)
        names = sorted(counts.columns, key=lambda name: ([name != each for each in RESULT_STATUSES], name))
        #: Number of cells by solver (index) and status (columns). Statuses of cells with a result come first.
        self.statuses = counts.reindex(index=sort_by_law(config.solvers), columns=names, fill_value=0)
        #: Reasons why cells have no result, and the number of cells with each reason. The most frequent reason comes
        #: first. Columns: ``solver, status, reason, n``.
        self.reasons: Frame = pd.DataFrame(
            count_reasons(outcomes), columns=["solver", "status", "reason", "n"]
        )
        self.between = pairwise_divergence(cells, config) if pair else pd.DataFrame()
        self.estimates = limit_estimates(cells, config.solvers, config.mapping, marked=pair)
        self.ladder = summarise_ladder(folder, config)
        # The rows of a cell are in the order of the solvers, the model first. If the row of the model is marked, all
        # rows of the cell are marked.
        marked = read_where_present(cells, "marked").reshape(-1, len(config.solvers))
        result = (read_codes(cells, "status", RESULT_STATUSES) >= 0).reshape(marked.shape)
        beyond = (marked & result & ~marked[:, :1]).sum(axis=0).tolist()
        #: Number of all cells, and number of cells in which the model's row is marked.
        self.n_cells, self.n_marked = len(marked), int(marked[:, 0].sum())
        #: For contact graphs, by solver and including the model: the largest asymmetry of a result in a symmetric
        #: graph, and the number of results in symmetric graphs. Empty for other runs.
        self.asymmetries = largest_asymmetries(cells, config.solvers) if config.kind == "graph" else {}
        #: Distances D between rigid engines and the rigid laws of the run, one row per engine and law, with the
        #: columns ``solver, law, n, median, p95, max``. Empty if the cells are no contact graphs.
        self.from_rigid_laws = (
            distances_from_rigid_laws(cells, config.solvers) if config.kind == "graph" else pd.DataFrame()
        )
        #: For each solver, the number of cells in which the solver's result is marked, because it lies next to a jump,
        #: while the model's result is not marked. Solvers without such cells are missing.
        self.marked_beyond = {name: n for name, n in zip(config.solvers, beyond, strict=True) if n}

    def get(
        self,
        solver: str,
        measure: str,
        axis: str = "all",
        value: AxisValue = "",
        cells: str = "regular",
    ) -> FrameRow:
        """Return the row of `statistics` for a solver, a measure, a level of an axis, and a group of cells.

        If no cell of the group was compared with the model, n is 0 and the other statistics are NaN.
        """
        place = self._places.get((solver, measure, axis, cells, "" if axis == "all" else value))
        if place is not None:
            return self.statistics.iloc[place]
        return pd.Series({"n": 0} | dict.fromkeys(("mean", "median", "p95", "max"), np.nan), dtype=object)


def summarise(folder: RunFolder) -> Summary:
    """Compute the statistics of a finished run."""
    return Summary(folder)


def count_reasons(outcomes: Tally) -> list[tuple[str, str, str, int]]:
    """Return the reasons why rows have no result, the most frequent first.

    Each entry is a tuple of solver, status, reason, and number of rows.
    """
    rows = [(*key, n) for key, n in outcomes.items() if key[1] not in RESULT_STATUSES]
    return sorted(rows, key=lambda row: (-row[3], row[0], row[2], row[1]))


def _statistics(table: DivergenceTable, kind: CellKind) -> Frame:
    """Return the statistics of every measure by solver, by axis, and by group of cells (`Summary.statistics`).

    Runs of two balls have statistics by axis for regular cells only. Their statistics include the shares of rows with
    equal state paths.
    """
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
    """Return, for each solver, the `count` regular rows of the table of divergence with its largest D.

    The rows are sorted by solver. The rows of a solver begin with the largest D.
    """
    rows = table.rows.assign(d=table.measure("velocity_divergence"))[table.regular]
    largest = rows.sort_values(["solver", "d"], ascending=[True, False], kind="stable")
    picked = largest.groupby("solver", observed=True).head(count).index
    return rows_at(table.path, picked.tolist()).to_pandas()


def pairwise_divergence(path: Path, config: Config) -> Frame:
    """Return statistics of the divergence D between every two solvers other than the model, in a run of two balls.

    The statistics cover the n cells that both solvers solved, without marked rows. Columns: ``solver, other, n, median,
    p95, max``. If two solvers differ from the model in the same way, the D between them is near zero.
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
    """Return two numbers for each solver: its largest asymmetry per abs(v0), and how many symmetric graphs it solved.

    Solvers that solved no symmetric graph are missing.
    """
    done = read_codes(path, "status", RESULT_STATUSES) >= 0
    values = np.where(done, read_column(path, "asymmetry"), np.nan).reshape(-1, len(solvers))
    found: dict[str, tuple[float, int]] = {}
    for name, column in zip(solvers, values.T, strict=True):
        known = column[~np.isnan(column)]
        if len(known):
            found[name] = float(known.max()), len(known)
    return found


def distances_from_rigid_laws(path: Path, solvers: Sequence[str]) -> Frame:
    """Compute how far each rigid engine is from each rigid law in a run of contact graphs.

    The distances are taken over the graphs that both the engine and the law solved.

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
    """Return statistics of each engine's limit at a time step of zero, from the table of cells at `path`.

    The statistics say how far the engine at its step is from the limit, and how well the limit is known. There is one
    row per engine. An error or a distance in a cell is the largest one of any ball's velocity, per abs(v0). Columns:

    * ``solver``: the engine;
    * ``asked``: the exact solver of the law that the engine was asked for, or "" without such a solver;
    * ``n``: the number of cells with a limit; ``converged``: the number of these cells in which the engine converged;
    * ``order``: the median order of convergence;
    * ``regularisation``: the largest part of an error that no time step removes, however short;
    * ``error_median``, ``error_p95``, ``error_max``: statistics of the estimated errors of the limits;
    * ``step_median``, ...: the same statistics of the distances between the limits and the velocities at the step;
    * ``asked_median``, ...: the same statistics of the distances between the limits and the solver ``asked``, if that
      solver is in the run;
    * ``held``: the number of distances from the solver ``asked``; ``honest``: the share of these distances that are at
      most `HONEST` times the estimated error.

    Marked rows are counted only if the argument `marked` is true.
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
        # Without dropna, pandas 2.2 would warn where the orders of all rows are NaN.
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
    """Statistics of the contributions to the divergence of each engine in a run (docs/ladder.md)."""

    def __init__(self, statistics: Frame) -> None:
        #: One row per engine, region of cells, and contribution. The columns ``axis`` and ``value`` give the region.
        #: The axis is "all", an axis of the cells, or "stiffness_band". ``n`` is the number of cells that have the
        #: contribution; ``mean, median, p95, max`` are statistics of its kinetic norm. ``total`` is the mean D of the
        #: region, and ``share`` is the share of the contribution in this mean D. ``low`` and ``high`` are the least and
        #: the largest share over all orders in which the causes can be taken. Both equal ``share`` if the contribution
        #: is not a cause.
        self.statistics = statistics
        #: The engines, in the order of the tables, and the axes by which cells are grouped into regions.
        self.solvers, self.axes = (list(dict.fromkeys(statistics[name])) for name in ("solver", "axis"))
        #: The contributions that at least one cell has, in the order of `ladder.CONTRIBUTIONS`.
        self.present = [c for c in CONTRIBUTIONS if c.name in set(statistics.contribution)]
        #: Number of orders in which the causes can be taken, as a word. Without gravity there are two causes and two
        #: orders.
        self.orders = "six" if any(c.needs_gravity for c in self.present) else "two"
        arrangements = statistics.value[statistics.axis == "arrangement"].unique()
        #: Regions of cells that the pages show. Each region is an axis and a value. The keys are the names of the
        #: regions for a reader.
        self.regions: dict[str, tuple[str, AxisValue]] = (
            {label: (BAND, edge) for edge, label in BANDS.items()}
            if BAND in self.axes
            else {f"arrangement = {name}": ("arrangement", name) for name in arrangements}
        )

    def region(self, solver: str, axis: str = "all", value: AxisValue = np.nan) -> Frame:
        """Return the statistics of one engine in one region of cells, indexed by contribution.

        The table is empty if no cell of the region has a split divergence.
        """
        table = self.statistics
        found = table[(table.solver == solver) & (table.axis == axis)]
        if axis != "all":
            found = found[found.value == value]
        return found.set_index("contribution")


def band_of(stiffness_ratio: ArrayLike) -> Floats:
    """Return, for each stiffness ratio k2/k1, the lower edge of its region in `BANDS`."""
    ratio = np.asarray(stiffness_ratio, dtype=float)
    return np.where(ratio < 0.1, 0.0, np.where(ratio <= 10.0, 0.1, 10.0))


def summarise_ladder(folder: RunFolder, config: Config) -> LadderSummary:
    """Return the statistics of the contributions to the divergence of each engine in a finished run.

    Only the rows of one engine are in memory at a time.
    """
    path, pair, frames = folder.table_path("ladder.parquet"), config.kind == "pair", []
    columns = [f"{c.name}_{number}" for c in contributions_of(gravity=pair) for number in ("norm", "share")]
    columns += [f"{name}_along" for name in corner_names(gravity=pair).values()]
    columns += [*AXES_OF[config.kind], "velocity_divergence"]
    regular = (pc.field("status") == "ok") & pc.field("marked").is_null()
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
    """Return, for each axis, the value of every row on this axis, by which rows are grouped into regions.

    In runs of chains and graphs only axes with several values are returned.
    """
    regions: dict[str, np.ndarray] = {"all": np.zeros(len(rows))}
    if config.kind != "pair":
        # An axis such as `strike`, which only cradles have, is NaN in other rows. Such an axis is left out.
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
    """Return the statistics of every contribution in every region of one axis.

    The result has one row for each value of the axis and each contribution. `region` holds the value of every row of
    the table ``ladder`` on the axis.
    """
    contributions = contributions_of(gravity=gravity)
    names = [c.name for c in contributions]
    causes = [c.name for c in contributions if c.is_cause]
    total = rows.velocity_divergence
    norms = rows[[f"{name}_norm" for name in names]].set_axis(names, axis=1)
    along = rows[[f"{name}_share" for name in names]].set_axis(names, axis=1).mul(total, axis=0)
    sums = total.groupby(region).sum()
    whole = sums.where(sums > 0)
    share = along.groupby(region).sum().div(whole, axis=0)
    # A component along the total difference is linear in the velocities. So the components of the exact solutions can
    # be summed over a region first. The sum is then split among the causes.
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
    """Return the statistics of contributions in the columns of ``summary.csv``.

    The tables hold the kinetic norms, the shares, and the least and largest shares over all orders of the causes.
    """
    table = ladder.statistics.assign(cells="regular")
    frames = [table.assign(measure="norm_" + table.contribution)]
    for measure, statistic in (("share", "share"), ("share_low", "low"), ("share_high", "high")):
        shares = table[["solver", "cells", "axis", "value", "n"]]
        frames.append(shares.assign(measure=f"{measure}_" + table.contribution, mean=table[statistic]))
    return [frame.reindex(columns=STATISTICS) for frame in frames]
