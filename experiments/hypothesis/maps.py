"""Where the hypothesis is good enough: its error over k2/k1 and m2/m1, by solver."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_xval.experiments.hypothesis.cases import distance, nearer_limit
from impact_xval.experiments.hypothesis.config import MapConfig
from impact_xval.experiments.hypothesis.solvers import Outcomes, SolverUnderTest
from impact_xval.model.collision import RESULT_STATUSES

Floats = NDArray[np.float64]

#: Errors that are told apart: 1, 5 and 20 % of the impact's kinetic norm.
LEVELS = (0.01, 0.05, 0.2)


@dataclass(frozen=True, slots=True, eq=False)
class ErrorMap:
    """Error of the hypothesis for one solver at fixed restitutions.

    Attributes
    ----------
    solver : str
    e1, e2 : float
    stiffness_ratio : ndarray, shape (n,)
    mass_ratio : ndarray, shape (m,)
    error : ndarray, shape (n, m)
        Distance D of the solver's outcome from the closed form of the nearer limit; NaN without a result.
    uncertainty : ndarray, shape (n, m)
        Of the solver itself.
    status, reason : ndarray of str, shape (n, m)
        Of its outcome.
    """

    solver: str
    e1: float
    e2: float
    stiffness_ratio: Floats
    mass_ratio: Floats
    error: Floats
    uncertainty: Floats
    status: NDArray[np.str_]
    reason: NDArray[np.str_]

    def side(self, soft_table: bool) -> NDArray[np.bool_]:
        """Whether a stiffness ratio lies on the side k2/k1 < 1, or on the other, shape (n,)."""
        return self.stiffness_ratio < 1 if soft_table else self.stiffness_ratio > 1


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


def error_map(
    solver: str, e1: float, e2: float, kappa: Floats, masses: Floats, outcomes: Outcomes
) -> ErrorMap:
    """Turn the outcomes of `map_ratios` into a map."""
    k, m = map_ratios(kappa, masses, e1, e2)[:2]
    v1, v2 = nearer_limit(k, m, e1, e2)
    error = distance(m, outcomes.v1 - v1, outcomes.v2 - v2)
    error[~np.isin(outcomes.status, RESULT_STATUSES)] = math.nan
    columns: Any = (error, outcomes.error, outcomes.status, outcomes.reason)
    return ErrorMap(
        solver, e1, e2, kappa, masses, *(column.reshape(kappa.size, masses.size) for column in columns)
    )


def contrast_needed(found: ErrorMap, mass_ratio: float, level: float, *, soft_table: bool) -> float:
    """Least contrast from which on the error stays within a level, to the end of the map; infinite if at none.

    On the side k2/k1 < 1 for a soft table, else on the other; the nearest mass ratio of the map is taken.
    """
    column = int(np.argmin(np.abs(np.log(found.mass_ratio / mass_ratio))))
    side = found.side(soft_table)
    kappa, error = found.stiffness_ratio[side], found.error[side, column]
    if soft_table:
        kappa, error = 1 / kappa[::-1], error[::-1]
    bad = np.flatnonzero(~(error <= level))
    first = bad[-1] + 1 if bad.size else 0
    return float(kappa[first]) if first < kappa.size else math.inf


def share_within(found: ErrorMap, level: float, *, soft_table: bool) -> float:
    """Share of the cells of one side of the map within a level."""
    error = found.error[found.side(soft_table)]
    known = np.isfinite(error)
    return float(np.mean(error[known] <= level)) if known.any() else math.nan
