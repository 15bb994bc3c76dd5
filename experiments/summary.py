"""What the table of divergence says: statistics by solver and axis, worst cells, agreement of paths.

Cells beside a jump of the model (grazing margin below the threshold of the configuration) are kept apart
everywhere: there an arbitrarily small difference may end in another outcome, so they say little about
physics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from experiments.certificates import certificates
from experiments.config import REFERENCE, Config
from experiments.divergence import COMPARABLE
from experiments.ladder_summary import LadderSummary, summarise_ladder
from experiments.schema import CELLS_SCHEMA, DIVERGENCE_SCHEMA
from experiments.store import RunFolder

#: A pandas DataFrame or Series. Their annotations are too wide to check code against: any selection may be
#: either.
Frame = Any

#: Axes of the grid and how a reader knows them.
AXES = {"stiffness_ratio": "k2/k1", "mass_ratio": "m2/m1", "e1": "e1", "e2": "e2"}

#: Measures that are summarised, by their size, and how a reader knows them.
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

#: Whether the state paths are equal, where the model followed its own to the end; null elsewhere.
FULL_PATHS = "states_equal_without_limit"

_SHARES = ("states_equal", FULL_PATHS)
_WORST = 5


@dataclass(frozen=True, slots=True)
class Summary:
    """Statistics of a run.

    Attributes
    ----------
    config : Config
        The experiment.
    statistics : DataFrame
        ``solver, cells ("all", "regular" or "grazing"), axis ("all" or an axis), value, measure, n, mean,
        median, p95, max``; measures are taken by size, those of `_SHARES` have only a mean.
    worst : DataFrame
        The regular cells with the largest D of every solver, as rows of the divergence table.
    statuses : DataFrame
        Number of cells by solver (index) and status (columns).
    reasons : DataFrame
        ``solver, status, reason, n``: the most frequent reasons first.
    between : DataFrame
        D between every two compliant solvers over the cells both solved: ``solver, other, n, median, p95,
        max``.
    certificates : DataFrame
        Convergence certificates by solver (`experiments.certificates`); empty without any.
    n_cells, n_grazing : int
        Cells of the grid, and those of them beside a jump.
    ladder : LadderSummary
        What the divergence of the engines is made of.
    """

    config: Config
    statistics: Frame
    worst: Frame
    statuses: Frame
    reasons: Frame
    between: Frame
    certificates: Frame
    n_cells: int
    n_grazing: int
    ladder: LadderSummary

    @property
    def solvers(self) -> list[str]:
        """The solvers that were compared with the reference, in the order of the configuration."""
        return [name for name in self.config.solvers if name != REFERENCE]

    def get(
        self, solver: str, measure: str, axis: str = "all", value: float = np.nan, cells: str = "regular"
    ) -> Frame:
        """Return one row of the statistics; NaN numbers and n = 0 where nothing was compared."""
        table = self.statistics
        found = table[
            (table.solver == solver)
            & (table.measure == measure)
            & (table.axis == axis)
            & (table.cells == cells)
        ]
        if axis != "all":
            found = found[found.value == value]
        if len(found):
            return found.iloc[0]
        return pd.Series({"n": 0, "mean": np.nan, "median": np.nan, "p95": np.nan, "max": np.nan})


def summarise(folder: RunFolder) -> Summary:
    """Compute the statistics of a finished run from its stored tables."""
    config = folder.config()
    cells = folder.read_table("cells.parquet", CELLS_SCHEMA).to_pandas()
    table = load_divergence(folder, config)
    compared = table[table.velocity_divergence.notna()]
    reference = cells[cells.solver == REFERENCE]
    return Summary(
        config=config,
        statistics=_statistics(compared),
        worst=_worst(compared, config),
        statuses=_statuses(cells, config),
        reasons=_reasons(cells),
        between=_between(cells, config),
        certificates=certificates(cells, config.solvers),
        n_cells=len(reference),
        n_grazing=int((reference.grazing_margin < config.grazing_threshold).sum()),
        ladder=summarise_ladder(folder, config),
    )


def load_divergence(folder: RunFolder, config: Config) -> Frame:
    """Read the table of divergence, with columns ``grazing`` and `FULL_PATHS` beside it."""
    table = folder.read_table("divergence.parquet", DIVERGENCE_SCHEMA).to_pandas()
    table["states_equal"] = table["states_equal"].astype("boolean")
    # Where the model took a limit, its path ends there: it cannot equal one that was followed to the end.
    table[FULL_PATHS] = table["states_equal"].where(table.model_status == "ok")
    table["grazing"] = table.model_grazing_margin < config.grazing_threshold
    return table


def _statistics(compared: Frame) -> Frame:
    frames = []
    parts = {"all": compared, "regular": compared[~compared.grazing], "grazing": compared[compared.grazing]}
    for label, part in parts.items():
        for axis in ("all", *AXES) if label == "regular" else ("all",):
            keys = ["solver"] if axis == "all" else ["solver", axis]
            for measure in (*SUMMARISED, *_SHARES):
                sizes = part[measure].astype(float).abs()
                grouped = sizes.groupby([part[key] for key in keys])
                frame = pd.DataFrame({"n": grouped.count(), "mean": grouped.mean()})
                if measure not in _SHARES:
                    frame["median"] = grouped.median()
                    frame["p95"] = grouped.quantile(0.95)
                    frame["max"] = grouped.max()
                frame = frame.reset_index().rename(columns={axis: "value"})
                frames.append(frame.assign(cells=label, axis=axis, measure=measure))
    columns = ["solver", "cells", "axis", "value", "measure", "n", "mean", "median", "p95", "max"]
    filled = [
        frame.reindex(columns=columns).astype({"value": float, "median": float})
        for frame in frames
        if len(frame)
    ]
    return pd.concat(filled, ignore_index=True) if filled else pd.DataFrame(columns=columns)


def _worst(compared: Frame, config: Config) -> Frame:
    regular = compared[~compared.grazing].sort_values(
        ["velocity_divergence", "cell"], ascending=[False, True]
    )
    picked = [regular[regular.solver == name].head(_WORST) for name in config.solvers if name != REFERENCE]
    return pd.concat(picked, ignore_index=True) if picked else regular


def _statuses(cells: Frame, config: Config) -> Frame:
    counts = cells.groupby(["solver", "status"]).size().unstack(fill_value=0)
    return counts.reindex(config.solvers, fill_value=0)


def _reasons(cells: Frame) -> Frame:
    failed = cells[~cells.status.isin(COMPARABLE)]
    counted = failed.groupby(["solver", "status", "reason"]).size().rename("n").reset_index()
    return counted.sort_values(["n", "solver", "reason"], ascending=[False, True, True], ignore_index=True)


def _between(cells: Frame, config: Config) -> Frame:
    """D between compliant solvers: near zero where they share what makes them differ from the model."""
    names = [name for name in config.solvers if name != REFERENCE]
    solved = cells[cells.status.isin(COMPARABLE)]
    scaled = solved.assign(
        u1=solved.v1 / solved.v0.abs(), u2=np.sqrt(solved.mass_ratio) * solved.v2 / solved.v0.abs()
    )
    u1 = scaled.pivot(index="cell", columns="solver", values="u1")
    u2 = scaled.pivot(index="cell", columns="solver", values="u2")
    rows = []
    names = [name for name in names if name in u1]
    for i, name in enumerate(names):
        for other in names[i + 1 :]:
            d = np.hypot(u1[name] - u1[other], u2[name] - u2[other]).dropna()
            if len(d):
                rows.append((name, other, len(d), d.median(), d.quantile(0.95), d.max()))
    return pd.DataFrame(rows, columns=["solver", "other", "n", "median", "p95", "max"])
