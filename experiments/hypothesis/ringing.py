"""Where the model itself has no limit: e1 = 1 and e2 < 1, united while the table contact is compressed.

Once the balls are united (v1 = v2 at the return of contact 1) an elastic ball-ball contact rings for ever. With
s = F2 at the return and F = F2 at the end of compression of contact 2, both per the same unit, the velocity of B2 about
the latter instant is

    (m1 + m2) v2' = F + (m1 s/m2) cos(tau),    tau = omega1 t + phase,    omega1 -> infinity,

since the ring starts from rest under the relative acceleration s/m2 and never loses any of it. So v2 rises through zero
as tau + q sin(tau) does, q = m1 s/(m2 F), and for q > 1 it does so once or three times (up, down, up), depending on the
phase. Every rise is an end of compression, which leaves e2^2 of the energy of contact 2; one more end leaves the balls
with e2 times the velocity. The phase is that of omega1 times a time that does not depend on k2/k1: as k2/k1 -> 0 it
takes every value equally often, and the outcome has no limit. By the supplement's E22 and E2max at e1 = 1,

    q^2 = (3 - m2)/(m2 (1 + m2))   (m1 = 1),

which exceeds 1 exactly where m2 < 1, that is in the whole regime. For 1 < q below about 4.6 the share of phases with a
second end is that of the values of tau + q sin(tau) taken three times, (sqrt(q^2 - 1) - arccos(1/q))/pi.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from experiments.hypothesis.cases import Point, distance
from experiments.hypothesis.subjects import model_batch

#: Contrasts over which shares are counted, and how many.
RANGE, COUNT = (1e4, 1e6), 1500


@dataclass(frozen=True, slots=True)
class Branches:
    """Outcomes of the model at a point over many contrasts, sorted by the ends of compression of contact 2.

    Attributes
    ----------
    point : Point
    predicted : float
        Share of contrasts with a second end of compression, from `second_end_share`.
    measured : float
        Share of outcomes at e2 times the closed form.
    uncertainty : float
        95 % half-width of that share, binomial.
    elsewhere : float
        Share of outcomes at neither.
    once, twice : float
        Velocity after one and two ends of compression, per abs(v0).
    """

    point: Point
    predicted: float
    measured: float
    uncertainty: float
    elsewhere: float
    once: float
    twice: float


def second_end_share(mass_ratio: float) -> float:
    """Share of phases with a second end of compression at e1 = 1; NaN where a third is possible."""
    mu = mass_ratio
    if mu >= 1:
        return 0.0
    q = math.sqrt((3 - mu) / (mu * (1 + mu)))
    share = (math.sqrt(q * q - 1) - math.acos(1 / q)) / math.pi
    return share if share <= 1 else math.nan


def count_branches(point: Point, seed: int) -> Branches:
    """Solve the model at many contrasts, drawn at random, and sort the outcomes."""
    rng = np.random.default_rng(seed)
    x = np.exp(rng.uniform(np.log(RANGE[0]), np.log(RANGE[1]), COUNT))
    mu, e2 = point.mass_ratio, point.e2
    mass, first, second = (np.full(COUNT, value) for value in (mu, point.e1, e2))
    answers = model_batch(1 / x, mass, first, second)
    once = e2 / math.sqrt(1 + mu)  # the closed form at e1 = 1
    near = [distance(mu, answers.v1 - v, answers.v2 - v) < 0.1 * (1 - e2) * once for v in (once, e2 * once)]
    share = float(np.mean(near[1]))
    half = 1.96 * math.sqrt(max(share * (1 - share), 0.25 / COUNT) / COUNT)
    lost = float(np.mean(~(near[0] | near[1])))
    return Branches(point, second_end_share(mu), share, half, lost, once, e2 * once)
