"""What a run of columns found: statistics by solver and axis, engines beside the exact solver of their law.

Marked rows are kept apart, as in `measures.summary`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from impact_xval.compliant_baselines.registry import law_of
from impact_xval.experiments.config.arrangements import COLUMN_AXES
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.measures.aggregates import Frame, reasons_of
from impact_xval.experiments.measures.ladder_summary import LadderSummary, summarise_ladder
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.measures.summary import marks_of, status_frame
from impact_xval.experiments.tables.store import RunFolder

#: Measures that are summarised, by their size, and how a reader knows them.
SUMMARISED = {
    "velocity_divergence": "D",
    "largest_dv": "largest |dv|",
    "dretained_energy": "|d energy|",
    "limit_distance": "limit's distance",
}

_WORST = 3


@dataclass(frozen=True, slots=True, eq=False)
class ColumnSummary:
    """Statistics of a run of columns.

    Attributes
    ----------
    config : Config
        The experiment.
    regular : DataFrame
        The rows of the divergence table that are compared and not marked.
    axes : dict of list
        Values of those of `COLUMN_AXES` that have several.
    statistics : DataFrame
        ``solver, cells ("regular" or "marked"), axis ("all" or an axis), value, measure, n, mean, median, p95, max``;
        measures are taken by size.
    worst : DataFrame
        The regular columns with the largest D of every solver, as rows of the divergence table.
    engines : list of dict
        Of every engine with a limit dt -> 0 and the exact solver of its law: ``solver, law, n, median, max`` of the
        limit's distance, ``error``, the median that it estimates, ``within`` and ``within3``, the shares of limits
        within their estimates and three times them.
    ladder : LadderSummary
        What the divergence of the engines is made of.
    statuses : DataFrame
        Number of columns by solver (index) and status (columns).
    reasons : DataFrame
        ``solver, status, reason, n``: the most frequent reasons first.
    n_cells, n_marked : int
        Columns of the run, and those in which the model is marked.
    marked_beyond : dict of int
        As of `Summary`.
    """

    config: Config
    regular: Frame
    axes: dict[str, list[Any]]
    statistics: Frame
    worst: Frame
    engines: list[dict[str, Any]]
    ladder: LadderSummary
    statuses: Frame
    reasons: Frame
    n_cells: int
    n_marked: int
    marked_beyond: dict[str, int]

    @property
    def solvers(self) -> list[str]:
        """The solvers that were compared with the reference, grouped by the law they were asked for."""
        return in_order_of_laws(name for name in self.config.solvers if name != REFERENCE)

    def get(
        self, solver: str, measure: str, axis: str = "all", value: Any = "", cells: str = "regular"
    ) -> Any:
        """Return one row of the statistics; NaN numbers and n = 0 where nothing was compared."""
        t = self.statistics
        row = t[
            (t.solver == solver)
            & (t.measure == measure)
            & (t.axis == axis)
            & (t.value == value)
            & (t.cells == cells)
        ]
        if len(row):
            return row.iloc[0]
        return pd.Series({"n": 0} | dict.fromkeys(("mean", "median", "p95", "max"), np.nan), dtype=object)


def summarise_columns(folder: RunFolder) -> ColumnSummary:
    """Compute the statistics of a finished run of columns from its stored tables."""
    config = folder.config()
    cells = folder.table_path("cells.parquet")
    n_marked, marked_beyond = marks_of(cells, config.solvers)
    table = folder.read_table("divergence.parquet").to_pandas()
    outcomes = folder.tally()
    compared, marked = table.velocity_divergence.notna(), table.marked.notna()
    regular = table[compared & ~marked]
    worst = regular.sort_values(["velocity_divergence", "cell"], ascending=[False, True], kind="stable")
    return ColumnSummary(
        config=config,
        regular=regular,
        axes={
            name: values for name in COLUMN_AXES if len(values := sorted(table[name].dropna().unique())) > 1
        },
        statistics=pd.concat(
            [_statistics(regular, "regular"), _statistics(table[compared & marked], "marked")],
            ignore_index=True,
        ),
        worst=worst.groupby("solver", sort=False).head(_WORST),
        engines=_engines(table[~marked], config),  # also where the model has no result
        ladder=summarise_ladder(folder, config),
        statuses=status_frame(outcomes, config),
        reasons=pd.DataFrame(reasons_of(outcomes), columns=["solver", "status", "reason", "n"]),
        n_cells=sum(n for (name, _, _), n in outcomes.items() if name == REFERENCE),
        n_marked=n_marked,
        marked_beyond=marked_beyond,
    )


def _statistics(rows: Frame, cells: str) -> Frame:
    """Statistics of every measure by solver, over all rows and by the values of every axis."""
    pieces = []
    for axis in ("all", *COLUMN_AXES):
        keys = ["solver"] if axis == "all" else ["solver", axis]
        for measure in SUMMARISED:
            grouped = rows[measure].abs().groupby([rows[key] for key in keys])
            found = grouped.agg(["count", "mean", "median", _p95, "max"]).reset_index()
            found = found.rename(columns={"count": "n", "_p95": "p95"})
            found.insert(1, "cells", cells)
            found.insert(2, "axis", axis)
            value = "" if axis == "all" else found.pop(axis).astype(object)
            found.insert(3, "value", value)
            found.insert(4, "measure", measure)
            pieces.append(found[found.n > 0])
    return pd.concat(pieces, ignore_index=True)


def _p95(values: Frame) -> float:
    return values.quantile(0.95)


def _engines(rows: Frame, config: Config) -> list[dict[str, Any]]:
    found = []
    for name in in_order_of_laws(config.solvers):
        some = rows[(rows.solver == name) & rows.limit_distance.notna() & rows.limit_error.notna()]
        if len(some):
            distance, error = some.limit_distance, some.limit_error
            found.append(
                {
                    "solver": name,
                    "law": law_of(name) or "-",
                    "n": len(some),
                    "median": distance.median(),
                    "max": distance.max(),
                    "error": error.median(),
                    "within": float((distance <= error).mean()),
                    "within3": float((distance <= 3 * error).mean()),
                }
            )
    return found
