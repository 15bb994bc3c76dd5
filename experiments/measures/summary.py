"""What the table of divergence says: statistics by solver and axis, worst cells, agreement of paths.

Marked rows, beside a jump of the model or of the exact law of their solver, are kept apart
everywhere: there an arbitrarily small difference may end in another outcome, so they say little about
physics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.measures.aggregates import (
    FULL_PATHS,
    OWN_LAW,
    Compared,
    Frame,
    Levels,
    between,
    reasons_of,
    statistics,
    worst_rows,
)
from impact_xval.experiments.measures.estimates import convergence_estimates
from impact_xval.experiments.measures.ladder_summary import LadderSummary, summarise_ladder
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.tables.folder import RunFolder, Tally, statuses_of
from impact_xval.experiments.tables.parquet import codes, present
from impact_xval.model.collision import RESULT_STATUSES

__all__ = ["FULL_PATHS", "OWN_LAW", "SUMMARISED", "Frame", "Summary", "load_divergence", "summarise"]

#: Measures that are summarised, by their size, and how a reader knows them: of two balls, and of columns of N.
SUMMARISED = {
    "velocity_divergence": "D",
    "dv1": "|dv1|",
    "dv2": "|dv2|",
    "dimpulse1": "|dI1|",
    "dimpulse2": "|dI2|",
    "dretained_energy": "|d energy|",
    "curve_distance": "curve distance",
    "states_edit_distance": "path edits",
}

SUMMARISED_OF_COLUMNS = {
    "velocity_divergence": "D",
    "largest_dv": "largest |dv|",
    "dretained_energy": "|d energy|",
    "limit_distance": "limit's distance",
}

_SHARES = ("states_equal", FULL_PATHS, OWN_LAW)
_WORST = {True: 5, False: 3}


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """Statistics of a run.

    Attributes
    ----------
    config : Config
        The experiment.
    levels : dict of Levels
        Values by which the statistics are grouped, by axis; of columns also arrangements.
    statistics : DataFrame
        ``solver, cells ("all", "regular" or "marked"), axis ("all" or an axis), value, measure, n, mean,
        median, p95, max``; measures are taken by size, those of `_SHARES` have only a mean.
    worst : DataFrame
        The regular cells with the largest D of every solver, as rows of the divergence table.
    statuses : DataFrame
        Number of cells by solver (index) and status (columns).
    reasons : DataFrame
        ``solver, status, reason, n``: the most frequent reasons first.
    between : DataFrame
        D between every two compliant solvers over the cells of two balls that both solved: ``solver, other, n, median,
        p95, max``.
    estimates : DataFrame
        Convergence estimates by solver (`measures.estimates`); empty without any.
    n_cells, n_marked : int
        Cells of the grid, and those of them in which the model is marked.
    marked_beyond : dict of int
        Of solvers the number of cells in which they are marked and the model is not, where there are any.
    ladder : LadderSummary
        What the divergence of the engines is made of.
    """

    config: Config
    levels: dict[str, Levels]
    statistics: Frame
    worst: Frame
    statuses: Frame
    reasons: Frame
    between: Frame
    estimates: Frame
    n_cells: int
    n_marked: int
    marked_beyond: dict[str, int]
    ladder: LadderSummary
    _places: dict[tuple[Any, ...], int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        table = self.statistics
        keys = [table[name] for name in ("solver", "measure", "axis", "cells")]
        values = table.value.where(table.axis != "all", "")
        places = dict(zip(zip(*keys, values, strict=True), range(len(table)), strict=True))
        object.__setattr__(self, "_places", places)

    @property
    def solvers(self) -> list[str]:
        """The solvers that were compared with the reference, grouped by the law they were asked for."""
        return in_order_of_laws(name for name in self.config.solvers if name != REFERENCE)

    @property
    def axes(self) -> dict[str, list[Any]]:
        """Levels of the axes that have several."""
        return {axis: levels.values for axis, levels in self.levels.items() if len(levels.values) > 1}

    def get(
        self, solver: str, measure: str, axis: str = "all", value: Any = "", cells: str = "regular"
    ) -> Frame:
        """Return one row of the statistics; NaN numbers and n = 0 where nothing was compared."""
        place = self._places.get((solver, measure, axis, cells, "" if axis == "all" else value))
        if place is not None:
            return self.statistics.iloc[place]
        return pd.Series({"n": 0} | dict.fromkeys(("mean", "median", "p95", "max"), np.nan), dtype=object)


def summarise(folder: RunFolder) -> Summary:
    """Compute the statistics of a finished run from its stored tables, whatever their size."""
    config = folder.config()
    cells, pair = folder.table_path("cells.parquet"), config.column is None
    table = load_divergence(folder, config)
    measures, shares = (SUMMARISED, _SHARES) if pair else (SUMMARISED_OF_COLUMNS, ())
    outcomes = folder.tally()
    n_marked, marked_beyond = marks_of(cells, config.solvers)
    return Summary(
        config=config,
        levels=table.levels,
        statistics=statistics(table, tuple(measures), shares),
        worst=worst_rows(table, _WORST[pair]),
        statuses=status_frame(outcomes, config),
        reasons=pd.DataFrame(reasons_of(outcomes), columns=["solver", "status", "reason", "n"]),
        between=between(cells, config) if pair else pd.DataFrame(),
        n_cells=sum(n for (name, _, _), n in outcomes.items() if name == REFERENCE),
        n_marked=n_marked,
        marked_beyond=marked_beyond,
        estimates=convergence_estimates(cells, config.solvers, config.mapping, marked=pair),
        ladder=summarise_ladder(folder, config),
    )


def marks_of(cells: Path, solvers: Sequence[str]) -> tuple[int, dict[str, int]]:
    """Count the cells in which the model is marked, and by solver those in which it is and the model is not, if any."""
    names = [REFERENCE, *(name for name in solvers if name != REFERENCE)]
    counts = np.bincount(
        codes(cells, "solver", names)[present(cells, "marked")], minlength=len(names)
    ).tolist()
    # Where the model is marked every row of the cell is.
    beyond = {name: n - counts[0] for name, n in zip(names, counts, strict=True) if n > counts[0]}
    return counts[0], beyond


def load_divergence(folder: RunFolder, config: Config) -> Compared:
    """Read the table of divergence, column by column as it is needed."""
    return Compared.of(folder.table_path("divergence.parquet"), config)


def status_frame(outcomes: Tally, config: Config) -> Frame:
    """Count rows by solver (index) and status (columns): the results first, the others by name."""
    counts = pd.DataFrame.from_dict(statuses_of(outcomes), orient="index").fillna(0).astype(int)
    columns = sorted(counts.columns, key=lambda name: ([name != each for each in RESULT_STATUSES], name))
    return counts.reindex(index=in_order_of_laws(config.solvers), columns=columns, fill_value=0)
