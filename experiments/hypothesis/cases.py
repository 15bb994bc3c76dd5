"""The limits of the supplement: their regimes, and the points at which each is approached.

Each is approached along one number x >= 1, its contrast, that goes to infinity (docs/hypothesis.md). For e_i → 0 it is
1/e_i^2, because an end of compression multiplies the stiffness by it (supplement, 3.3): a rate in e_i is twice that in
x. Closed forms are the model's own at a contrast of infinity (`model.pair.limits`); tests hold them against those of
the supplement. Velocities are per abs(v0), masses per m1.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import qmc

from impact_xval.experiments.config.axes import Sample
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.model import solve_batch

#: Least distance from the border of a regime, in velocity per abs(v0): there two closed forms meet, a series begins to
#: fall at the inverse of the distance from it, and balls part so slowly that engines need most of their steps.
MARGIN = 0.1

#: Grazing margin below which an outcome lies beside a jump. In the limits of k2/k1 the stiff contact's ringing, which
#: is what grazes, shrinks as the root of the contrast, and the margin with it: there it is multiplied by that root.
GRAZING = 1e-3

#: What is drawn from: k2/k1 of the plastic limits, m2/m1, and an inelastic e.
_RANGES = {"stiffness_ratio": {"log": [0.03, 30.0]}, "mass_ratio": {"log": [0.2, 10.0]}}
BOX = Sample.model_validate(_RANGES | {e: {"linear": [0.3, 0.95]} for e in ("e1", "e2")})

#: Classes of points none of whose contacts is elastic.
LOSSY = ("both lossy", "other lossy")


class Point(NamedTuple):
    """A collision by its ratios, in the order of `solve_batch`; the one that goes to its limit is NaN."""

    stiffness_ratio: float
    mass_ratio: float
    e1: float
    e2: float


class Case(NamedTuple):
    """One limit, or one regime of it: what its contrast is, where it applies, and the ratio that goes to its limit."""

    key: str
    variable: str
    regime: str
    axis: str = "stiffness_ratio"

    @property
    def plastic(self) -> bool:
        """Whether the limit is that of a restitution."""
        return self.axis != "stiffness_ratio"

    def at(self, contrast: float) -> dict[str, float]:
        """Return the ratio that goes to its limit, by name, at a contrast."""
        ratios = {"k1/k2": 1 / contrast, "k2/k1": contrast}
        return {self.axis: contrast**-0.5 if self.plastic else ratios[self.variable]}


CASES = (
    Case("zero-apart", "k1/k2", "e1 m2/m1 ≥ 1 and e2 (1 + e1) ≤ e1 m2/m1 - 1"),  # the balls part at once
    Case("zero-early", "k1/k2", "e1 m2/m1 below 1"),  # united while the table contact is compressed
    Case("zero-late", "k1/k2", "e1 m2/m1 ≥ 1 and e2 (1 + e1) above e1 m2/m1 - 1"),  # ... while it restores
    Case("infinity", "k2/k1", "everywhere"),
    Case("plastic-ball-ball", "1/e1^2", "everywhere", "e1"),
    Case("plastic-ball-table", "1/e2^2", "everywhere", "e2"),
)


def border(case: Case, point: Point) -> float:
    """How far inside its regime a point lies, in velocity per abs(v0); negative outside, infinite without a border.

    At k2/k1 → 0 the regimes part where v11 = 0, and where -e2 v21 = v11, v11 and v21 being the velocities after a
    ball-ball impact that the table has no part in: supplement, (11), (12).
    """
    _, mu, e1, e2 = point
    v11, v21 = (e1 * mu - 1) / (1 + mu), -(1 + e1) / (1 + mu)
    catch_up = -e2 * v21 - v11
    inside = {"zero-apart": min(v11, -catch_up), "zero-early": -v11, "zero-late": min(v11, catch_up)}
    return inside.get(case.key, math.inf)


def pair_class(case: Case, point: Point) -> str:
    """Name the class of a point: which of its contacts are elastic (e = 1); of a plastic limit, the other one."""
    if case.plastic:
        return "other elastic" if 1 in (point.e1, point.e2) else "other lossy"
    names = {(True, True): "e1 = e2 = 1", (True, False): "only e1 = 1", (False, True): "only e2 = 1"}
    return names.get((point.e1 == 1, point.e2 == 1), "both lossy")


def distance(weights: Any, differences: Any) -> Any:
    """D of differences of velocities, shape (..., N): their kinetic norm, by masses in the unit of that."""
    return np.sqrt((weights * np.square(differences)).sum(axis=-1))


def draw(case: Case, n: int, seed: int) -> list[Point]:
    """Draw the points of a case from a scrambled Sobol sequence in `BOX`, in six digits, `MARGIN` inside.

    Of a limit of k2/k1 half of them have e1, e2 < 1, and the rest is shared by e1 = 1, e2 = 1 and both; of a plastic
    limit a third has the other contact elastic.
    """
    elastic = n // 6 * [{"e1": 1.0}] + n // 6 * [{"e2": 1.0}] + n // 6 * [{"e1": 1.0, "e2": 1.0}]
    if case.plastic:
        elastic = n // 3 * [{"e2" if case.axis == "e1" else "e1": 1.0}]
    sampler = qmc.Sobol(4, rng=np.random.default_rng([seed, *case.key.encode()]))
    unit = sampler.random(2**16)  # enough for every class of a regime
    drawn = iter(BOX.place(np.roll(unit, 1, axis=1)))

    def inside(fixed: dict[str, float]) -> Point:
        points = (Point(*(float(f"{x:.6g}") for x in ratios))._replace(**fixed) for ratios in drawn)
        return next(point for point in points if border(case, point) >= MARGIN)

    wanted = (n - len(elastic)) * [{}] + elastic
    return [inside(one | {case.axis: math.nan}) for one in wanted]


def design(n: int, seed: int) -> Frame:
    """Draw the points of all limits: a row each, with its class, and v1 and v2 of the closed form."""
    tables = []
    for case in CASES:
        points = draw(case, n, seed)
        table: Frame = pd.DataFrame(points)
        closed = solve_batch(**table.assign(**case.at(math.inf)), stiffness_ratio_cutoff=math.inf)
        known = {"case": case.key, "point": range(n), "class": [pair_class(case, each) for each in points]}
        tables.append(table.assign(**known, closed_form_v1=closed.v1, closed_form_v2=closed.v2))
    return pd.concat(tables, ignore_index=True)
