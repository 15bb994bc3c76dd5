"""Where the hypothesis is good enough: its error over k2/k1 and m2/m1, by solver."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from impact_xval.experiments.hypothesis.cases import distance, nearer_limit
from impact_xval.experiments.hypothesis.config import MapConfig
from impact_xval.experiments.hypothesis.solvers import SolverUnderTest
from impact_xval.model.collision import RESULT_STATUSES

Floats = NDArray[np.float64]

#: Errors that are told apart: 1, 5 and 20 % of the impact's kinetic norm.
LEVELS = (0.01, 0.05, 0.2)


def axes(config: MapConfig, one: SolverUnderTest) -> tuple[Floats, Floats]:
    """Return k2/k1 and m2/m1 of a map; neither axis has a value at k2/k1 = 1, where the limits change over."""
    engine = one.kind == "stepped"
    size = config.engine_size if engine else config.size
    size = size // 2 if one.costly else size
    size += size % 2  # even: symmetric about 1, without it
    limits = config.engine_stiffness_ratio if engine else config.stiffness_ratio
    kappa = np.round(np.geomspace(*limits, max(4, size)), 12)
    return kappa, np.geomspace(*config.mass_ratio, max(3, size // 2))


def map_ratios(kappa: Floats, masses: Floats, e1: float, e2: float) -> Floats:
    """Return k2/k1, m2/m1, e1, e2 of every cell, the mass ratio varying fastest, shape (4, n m)."""
    k, m = (a.ravel() for a in np.meshgrid(kappa, masses, indexing="ij"))
    return np.array([k, m, np.full(k.size, e1), np.full(k.size, e2)])


def error_map(solver: str, ratios: Floats, outcomes: pd.DataFrame) -> pd.DataFrame:
    """Make a map of the outcomes of `map_ratios`, a row a cell.

    Beside the ratios and the solver's status and reason there are `error`, the distance D of its outcome from the
    closed form of the nearer limit (NaN without a result), and `uncertainty`, that of the solver itself.
    """
    k, m, e1, e2 = ratios
    v1, v2 = nearer_limit(k, m, e1[0], e2[0])
    error = pd.Series(distance(m, outcomes.v1 - v1, outcomes.v2 - v2))
    return pd.DataFrame(
        {
            "solver": solver,
            "e1": e1,
            "e2": e2,
            "stiffness_ratio": k,
            "mass_ratio": m,
            "error": error.where(outcomes.status.isin(RESULT_STATUSES)),
            "uncertainty": outcomes.error,
            "status": outcomes.status,
            "reason": outcomes.reason,
        }
    )


def grid_of(found: pd.DataFrame) -> pd.DataFrame:
    """Return the errors of a map: a row a stiffness ratio, a column a mass ratio."""
    masses = found.mass_ratio.unique()
    errors = found.error.to_numpy().reshape(-1, masses.size)
    return pd.DataFrame(errors, index=found.stiffness_ratio.iloc[:: masses.size], columns=masses)


def side_of(found: pd.DataFrame, *, soft_table: bool) -> pd.DataFrame:
    """Return the errors of one side of a map, k2/k1 < 1 for a soft table: a row a contrast, rising."""
    grid = grid_of(found)
    if soft_table:
        return grid.loc[grid.index < 1].iloc[::-1].rename(index=lambda k: 1 / k)
    return grid.loc[grid.index > 1]


def contrast_needed(errors: pd.DataFrame, mass_ratio: float, level: float) -> float:
    """Least contrast from which on the error stays within a level, to the end of the map; infinite if at none.

    The nearest mass ratio of the map is taken.
    """
    column = errors.iloc[:, int(np.argmin(np.abs(np.log(errors.columns / mass_ratio))))]
    within = np.logical_and.accumulate(column.to_numpy()[::-1] <= level)[::-1]
    return float(min(column.index[within], default=math.inf))


def share_within(errors: pd.DataFrame, level: float) -> float:
    """Share of the cells of one side of a map within a level, of those with a result."""
    known = errors.to_numpy()[errors.notna()]
    return float(np.mean(known <= level)) if known.size else math.nan
