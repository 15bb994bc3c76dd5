"""Where the hypothesis is good enough: its error over k2/k1 and m2/m1, by solver."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_xval.experiments.hypothesis.cases import nearer_limit
from impact_xval.experiments.hypothesis.config import MapConfig
from impact_xval.experiments.hypothesis.subjects import Answers, Subject
from impact_xval.model.collision import RESULT_STATUSES

Floats = NDArray[np.float64]

#: Errors asked for: 1, 5 and 20 % of the impact's kinetic norm.
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
        Of its answer.
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


def axes(config: MapConfig, subject: Subject) -> tuple[Floats, Floats]:
    """Return k2/k1 and m2/m1 of a map; neither axis has a value at k2/k1 = 1, where the limits change over."""
    engine = subject.kind == "stepped"
    size = config.engine_size if engine else config.size
    size = size // 2 if subject.costly else size
    size += size % 2  # even: symmetric about 1, without it
    limits = config.engine_stiffness_ratio if engine else config.stiffness_ratio
    kappa = np.round(np.geomspace(*limits, max(4, size)), 12)
    masses = np.geomspace(*config.mass_ratio, max(3, size // 2))
    return kappa, masses


def map_ratios(kappa: Floats, masses: Floats, e1: float, e2: float) -> Floats:
    """Return k2/k1, m2/m1, e1, e2 of every cell, the mass ratio varying fastest, shape (4, n m)."""
    k, m = (a.ravel() for a in np.meshgrid(kappa, masses, indexing="ij"))
    return np.array([k, m, np.full(k.size, e1), np.full(k.size, e2)])


def error_map(solver: str, e1: float, e2: float, kappa: Floats, masses: Floats, answers: Answers) -> ErrorMap:
    """Turn the answers to `map_ratios` into a map."""
    k, m = map_ratios(kappa, masses, e1, e2)[:2]
    v1, v2 = nearer_limit(k, m, e1, e2)
    error = np.sqrt(np.square(answers.v1 - v1) + m * np.square(answers.v2 - v2))
    error[~np.isin(answers.status, RESULT_STATUSES)] = math.nan
    shape = (kappa.size, masses.size)
    return ErrorMap(
        solver,
        e1,
        e2,
        kappa,
        masses,
        error.reshape(shape),
        answers.error.reshape(shape),
        answers.status.reshape(shape),
        answers.reason.reshape(shape),
    )


def contrast_needed(found: ErrorMap, mass_ratio: float, level: float, *, soft_table: bool) -> float:
    """Least contrast from which on the error stays within a level, to the end of the map; infinite if at none.

    Parameters
    ----------
    found : ErrorMap
    mass_ratio : float
        The nearest column of the map is taken.
    level : float
    soft_table : bool
        On the side k2/k1 < 1, else on the other.
    """
    column = int(np.argmin(np.abs(np.log(found.mass_ratio / mass_ratio))))
    side = found.stiffness_ratio < 1 if soft_table else found.stiffness_ratio > 1
    kappa, error = found.stiffness_ratio[side], found.error[side, column]
    if soft_table:
        kappa, error = 1 / kappa[::-1], error[::-1]
    bad = np.flatnonzero(~(error <= level))
    if bad.size == 0:
        return float(kappa[0])
    return float(kappa[bad[-1] + 1]) if bad[-1] + 1 < kappa.size else math.inf


def share_within(found: ErrorMap, level: float, *, soft_table: bool) -> float:
    """Share of the cells of one side of the map within a level."""
    side = found.stiffness_ratio < 1 if soft_table else found.stiffness_ratio > 1
    error = found.error[side]
    known = np.isfinite(error)
    return float(np.mean(error[known] <= level)) if known.any() else math.nan
