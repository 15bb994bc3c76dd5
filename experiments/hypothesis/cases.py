"""The limits of the supplement: closed forms, regimes, and the points at which each is approached.

**Contrast.** Each limit is approached along one number x >= 1 that goes to infinity: k1/k2 for k2/k1 → 0, k2/k1
for k2/k1 → infinity, and 1/e_i^2 for e_i → 0, because an end of compression multiplies the stiffness by it
(supplement, 3.3). A rate r means that the distance from the closed form falls as x^-r: a rate in e_i is twice that.

**Points** are drawn at random inside each regime, or given. A scrambled Sobol sequence fills (ln m2/m1, e1, e2[, ln
k2/k1]) evenly, and of each regime a given number is kept, divided over the classes of elastic contacts. Points within
`MARGIN` of a border between regimes are not drawn: there the two closed forms meet, and the contrast at which a series
begins to fall is the inverse of the distance from the border.

Velocities are per abs(v0), masses per m1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from impact_xval.model import Collision, solve

Floats = NDArray[np.float64]

#: A `pandas.DataFrame`, of which a type checker cannot tell what a selection gives.
Frame = Any

#: Least distance from the border of a regime, in velocity per abs(v0). Beside a border the balls also move apart, or
#: together, so slowly that an engine needs most of its steps for a few collisions.
MARGIN = 0.1

#: Grazing margin below which an outcome lies beside a jump. In the limits of k2/k1 the stiff contact's ringing, which
#: is what grazes, shrinks as the root of the contrast, and the margin with it: there it is multiplied by that root.
GRAZING = 1e-3

#: Ranges that are drawn from: m2/m1, an inelastic e, and k2/k1 of the plastic limits.
MASS_RATIO, RESTITUTION, STIFFNESS_RATIO = (0.2, 10.0), (0.3, 0.95), (0.03, 30.0)

#: Candidates drawn at a time, and in all, before a class of a regime is found empty.
_DRAW, _MOST = 1024, 65_536


@dataclass(frozen=True, slots=True)
class Point:
    """A point of the design.

    Attributes
    ----------
    mass_ratio, e1, e2 : float
        m2/m1 and the coefficients of restitution; the one that goes to 0 is NaN.
    stiffness_ratio : float
        k2/k1 where it stays as it is (plastic limits), else NaN.
    """

    mass_ratio: float
    e1: float
    e2: float
    stiffness_ratio: float = math.nan

    def ratios(self, case: Case, contrast: float) -> tuple[float, float, float, float]:
        """Return k2/k1, m2/m1, e1 and e2 at a contrast."""
        e = contrast**-0.5
        match case.variable:
            case "k1/k2":
                return 1 / contrast, self.mass_ratio, self.e1, self.e2
            case "k2/k1":
                return contrast, self.mass_ratio, self.e1, self.e2
            case "1/e1^2":
                return self.stiffness_ratio, self.mass_ratio, e, self.e2
            case _:
                return self.stiffness_ratio, self.mass_ratio, self.e1, e


@dataclass(frozen=True, slots=True)
class Case:
    """One limit, or one regime of it.

    Attributes
    ----------
    key : str
        As files and configurations call it.
    title : str
        As people do.
    variable : str
        What the contrast is: ``k1/k2``, ``k2/k1``, ``1/e1^2`` or ``1/e2^2``.
    stiff : int
        The contact that becomes infinitely stiff: 1 (ball-ball) or 2 (ball-table).
    regime : str
        Where it applies, as a formula.
    source : str
        Of the closed form.
    """

    key: str
    title: str
    variable: str
    stiff: int
    regime: str
    source: str

    @property
    def plastic(self) -> bool:
        """Whether the limit is that of a restitution."""
        return self.variable.startswith("1/e")


CASES = (
    Case(
        "zero-apart",
        "k2/k1 → 0, the balls part at once",
        "k1/k2",
        1,
        "e1 m2/m1 ≥ 1 and e2 (1 + e1) ≤ e1 m2/m1 - 1",
        "supplement, 3.2: (11) and -e2 times (12)",
    ),
    Case(
        "zero-early",
        "k2/k1 → 0, united while the table contact is compressed",
        "k1/k2",
        1,
        "e1 m2/m1 below 1",
        "supplement, 3.2: e2 sqrt(1 + m2 e1^2)/(1 + m2)",
    ),
    Case(
        "zero-late",
        "k2/k1 → 0, united while the table contact restores",
        "k1/k2",
        1,
        "e1 m2/m1 ≥ 1 and e2 (1 + e1) above e1 m2/m1 - 1",
        "supplement, 3.2: (13), corrected (errata)",
    ),
    Case(
        "infinity",
        "k2/k1 → infinity",
        "k2/k1",
        2,
        "everywhere",
        "supplement, 3.1: v1 = e1, v2 = 0",
    ),
    Case(
        "plastic-ball-ball",
        "e1 → 0",
        "1/e1^2",
        1,
        "everywhere",
        "supplement, 3.3, from the state at the end of compression",
    ),
    Case(
        "plastic-ball-table",
        "e2 → 0",
        "1/e2^2",
        2,
        "everywhere",
        "supplement, 3.3, from the state at the end of compression",
    ),
)
BY_KEY = {case.key: case for case in CASES}


def after_first_impact(mass_ratio: float, e1: float) -> tuple[float, float]:
    """Velocities of B1 and B2 after a ball-ball impact that the table has no part in: supplement, (11), (12)."""
    return (e1 * mass_ratio - 1) / (1 + mass_ratio), -(1 + e1) / (1 + mass_ratio)


def border(case: Case, point: Point) -> float:
    """How far inside its regime a point lies, in velocity per abs(v0); negative outside, infinite without a border.

    At k2/k1 → 0 the regimes part where v11 = 0, and where -e2 v21 = v11.
    """
    if not case.key.startswith("zero"):
        return math.inf
    v11, v21 = after_first_impact(point.mass_ratio, point.e1)
    catch_up = -point.e2 * v21 - v11
    match case.key:
        case "zero-apart":
            return min(v11, -catch_up)
        case "zero-early":
            return -v11
        case _:
            return min(v11, catch_up)


def closed_form(case: Case, point: Point) -> tuple[float, float]:
    """Velocities that the hypothesis gives in the limit, v1 and v2 (`Case.source`).

    A plastic limit needs the state at the end of compression: the model gets there exactly, and finishes by the closed
    form of 3.3 (`model.pair.limits`); no limit of a stiffness ratio is taken on the way.
    """
    mu, e1, e2 = point.mass_ratio, point.e1, point.e2
    match case.key:
        case "infinity":
            return e1, 0.0
        case "zero-apart":
            v11, v21 = after_first_impact(mu, e1)
            return v11, -e2 * v21
        case "zero-early":
            united = e2 * math.sqrt(1 + mu * e1**2) / (1 + mu)
        case "zero-late":
            united = math.sqrt((e1 * mu - 1) ** 2 + mu * e2**2 * (1 + e1) ** 2) / (1 + mu) ** 1.5
        case _:
            outcome = solve(
                Collision.from_ratios(*point.ratios(case, math.inf)), stiffness_ratio_cutoff=math.inf
            )
            return outcome.v1, outcome.v2
    return united, united


#: Classes of points none of whose contacts is elastic.
LOSSY = ("both lossy", "other lossy")


def pair_class(case: Case, point: Point) -> str:
    """Name the class of a point: which of its contacts are elastic (e = 1); of a plastic limit, the other one."""
    if case.plastic:
        return "other elastic" if 1.0 in (point.e1, point.e2) else "other lossy"
    if point.e1 == point.e2 == 1:
        return "e1 = e2 = 1"
    if point.e1 == 1:
        return "only e1 = 1"
    return "only e2 = 1" if point.e2 == 1 else "both lossy"


def distance(mass_ratio: Any, dv1: Any, dv2: Any) -> Floats:
    """D = sqrt(dv1^2 + (m2/m1) dv2^2), velocities per abs(v0): the project's velocity divergence."""
    return np.sqrt(np.square(dv1) + mass_ratio * np.square(dv2))


def draw(case: Case, n: int, seed: int) -> list[Point]:
    """Draw the points of a case; the same ones for the same seed.

    Of a limit of k2/k1 half of the n points have e1, e2 < 1, and the rest is shared by e1 = 1, e2 = 1 and both; of a
    plastic limit a third has the other contact elastic.

    Raises
    ------
    ValueError
        If the regime does not hold enough of them.
    """
    third, sixth = n // 3, n // 6
    if case.plastic:
        counts = {(False, False): n - third, (case.stiff == 2, case.stiff == 1): third}
    else:
        counts = {
            (False, False): n - 3 * sixth,
            **dict.fromkeys([(True, False), (False, True), (True, True)], sixth),
        }
    wanted = [elastic for elastic, count in counts.items() for _ in range(count)]
    sampler = qmc.Sobol(4, rng=np.random.default_rng([seed, *case.key.encode()]))
    points: list[Point] = []
    for _ in range(_MOST // _DRAW):
        for candidate in sampler.random(_DRAW):
            point = _point(case, candidate, wanted[len(points)])
            if border(case, point) >= MARGIN:
                points.append(point)
            if len(points) == n:
                return points
    e1, e2 = wanted[len(points)]
    raise ValueError(f"{case.key}: no point with e1 = 1: {e1}, e2 = 1: {e2} found")


def _point(case: Case, unit: Floats, elastic: tuple[bool, bool]) -> Point:
    def rounded(value: float) -> float:
        return float(f"{value:.6g}")

    def log_between(low: float, high: float, u: float) -> float:
        return rounded(low * (high / low) ** u)

    low, high = RESTITUTION
    e1, e2 = (
        1.0 if one else rounded(low + (high - low) * u) for one, u in zip(elastic, unit[1:3], strict=True)
    )
    return point_of(case, log_between(*MASS_RATIO, unit[0]), e1, e2, log_between(*STIFFNESS_RATIO, unit[3]))


def point_of(case: Case, mass_ratio: float, e1: float, e2: float, stiffness_ratio: float) -> Point:
    """Make a point of a case: what goes to its limit there is NaN."""
    if not case.plastic:
        return Point(mass_ratio, e1, e2)
    e1, e2 = (math.nan, e2) if case.stiff == 1 else (e1, math.nan)
    return Point(mass_ratio, e1, e2, stiffness_ratio)


def outside(case: Case, point: Point) -> str | None:
    """Say why a given point is none of a case, and what to do about it; None if it is one."""
    inside = border(case, point)
    if inside >= 0:
        return None
    return (
        f"m2/m1 = {point.mass_ratio:g}, e1 = {point.e1:g}, e2 = {point.e2:g} lies outside {case.key} by "
        f"{-inside:.3g} (velocity per |v0|); legal: {case.regime}; change the point, or name the regime it is in"
    )
