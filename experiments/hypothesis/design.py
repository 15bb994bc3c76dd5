"""The points at which a limit is approached: drawn at random inside each regime, or given.

A scrambled Sobol sequence fills (ln m2/m1, e1, e2[, ln k2/k1]) evenly; of each regime as many points are kept as
asked for, divided over the classes of elastic contacts. Points within `MARGIN` of a border between regimes are not
drawn: there the two closed forms meet, and the contrast at which a series begins to fall is the inverse of the
distance from the border.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import qmc

from impact_xval.experiments.hypothesis.cases import Case, Point, border

#: Least distance from the border of a regime, in velocity per abs(v0). Beside a border the balls also move apart, or
#: together, so slowly that an engine needs most of its steps for a few collisions.
MARGIN = 0.1

#: Ranges that are drawn from: m2/m1, an inelastic e, and k2/k1 of the plastic limits.
MASS_RATIO, RESTITUTION, STIFFNESS_RATIO = (0.2, 10.0), (0.3, 0.95), (0.03, 30.0)

#: Candidates drawn at a time, and in all, before a class of a regime is found empty.
_DRAW, _MOST = 1024, 65_536


def draw(case: Case, n: int, seed: int) -> list[Point]:
    """Draw the points of a case.

    Parameters
    ----------
    case : Case
    n : int
        How many. Of a limit of k2/k1 half have e1, e2 < 1; the rest is shared by e1 = 1, e2 = 1 and both; of a
        plastic limit a third has the other contact elastic.
    seed : int
        Of the scrambling; the same points for the same seed.

    Raises
    ------
    ValueError
        If the regime does not hold enough of them.
    """
    if case.plastic:
        elastic = n // 3
        counts = {(False, False): n - elastic, (case.stiff == 2, case.stiff == 1): elastic}
    else:
        sixth = n // 6
        counts = {
            (False, False): n - 3 * sixth,
            (True, False): sixth,
            (False, True): sixth,
            (True, True): sixth,
        }
    sampler = qmc.Sobol(4, rng=np.random.default_rng([seed, *case.key.encode()]))
    points: list[Point] = []
    wanted = [pattern for pattern, count in counts.items() for _ in range(count)]
    drawn = 0
    while wanted and drawn < _MOST:
        for candidate in sampler.random(_DRAW):
            if not wanted:
                break
            point = _point(case, candidate, wanted[0])
            if border(case, point) >= MARGIN:
                points.append(point)
                wanted.pop(0)
        drawn += _DRAW
    if wanted:
        raise ValueError(f"{case.key}: no point with e1 = 1: {wanted[0][0]}, e2 = 1: {wanted[0][1]} found")
    return points


def _point(case: Case, unit: np.ndarray, elastic: tuple[bool, bool]) -> Point:
    def log_between(low: float, high: float, u: float) -> float:
        return float(f"{low * (high / low) ** u:.6g}")

    low, high = RESTITUTION
    e1, e2 = (
        1.0 if one else float(f"{low + (high - low) * u:.6g}")
        for one, u in zip(elastic, unit[1:3], strict=True)
    )
    if not case.plastic:
        return Point(log_between(*MASS_RATIO, unit[0]), e1, e2)
    kappa = log_between(*STIFFNESS_RATIO, unit[3])
    e1, e2 = (math.nan, e2) if case.stiff == 1 else (e1, math.nan)
    return Point(log_between(*MASS_RATIO, unit[0]), e1, e2, kappa)


def outside(case: Case, point: Point) -> str | None:
    """Say why a given point is none of a case, and what to do about it; None if it is one."""
    inside = border(case, point)
    if inside >= 0:
        return None
    where = f"m2/m1 = {point.mass_ratio:g}, e1 = {point.e1:g}, e2 = {point.e2:g}"
    return (
        f"{where} lies outside {case.key} by {-inside:.3g} (velocity per |v0|); legal: {case.regime}; "
        "change the point, or name the regime it is in"
    )
