"""Where the model itself has no limit: e1 = 1 and e2 < 1, united while the table contact is compressed.

Once the balls are united (v1 = v2 at the return of contact 1) an elastic ball-ball contact rings for ever. With
s = F2 at the return and F = F2 at the end of compression of contact 2, both per the same unit, the velocity of B2 about
the latter instant is

    (m1 + m2) v2' = F + (m1 s/m2) cos(tau),    tau = omega1 t + phase,    omega1 -> infinity,

since the ring starts from rest under the relative acceleration s/m2 and never loses any of it. So v2 rises through zero
as tau + q sin(tau) through a level given by the phase, and for q = m1 s/(m2 F) > 1 it may do so several times. Every
rise is an end of compression, which leaves e2^2 of the energy of contact 2: after n of them the balls have e2^(n-1)
times the velocity of the closed form. The phase is that of omega1 times a time that does not depend on k2/k1: as
k2/k1 -> 0 it takes every value equally often, and the outcome has no limit. By the supplement's E22 and E2max, at
e1 = 1,

    q^2 = (3 - m2)/(m2 (1 + m2))   (m1 = 1),

which exceeds 1 exactly where m2 < 1, that is in the whole regime.

How often n occurs: tau + q sin(tau) falls once in a period, by 2 pi r with

    r = (sqrt(q^2 - 1) - arccos(1/q))/pi,

and the next fall is the same one, 2 pi higher. So a level is passed downwards by r falls in the mean, the whole part of
r or one more of them depending on the phase, and upwards once more than downwards. n therefore occurs in the share
1 - |n - 1 - r| of the phases, or never where that is negative. For m2 > 0.121 (q < 4.603, r < 1) n is 1 or 2, and r is
the share of the second; a lighter B2 always makes two ends or more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from impact_xval.experiments.hypothesis.cases import Point, distance
from impact_xval.experiments.hypothesis.subjects import model_batch

#: Contrasts over which shares are counted, and how many.
RANGE, COUNT = (1e4, 1e6), 1500


@dataclass(frozen=True, slots=True)
class Branches:
    """Outcomes of the model at a point over many contrasts, sorted by the ends of compression of contact 2.

    Attributes
    ----------
    point : Point
    predicted : float
        Share of contrasts with two ends of compression, from `end_share`.
    measured : float
        Share of outcomes at e2 times the closed form.
    uncertainty : float
        95 % half-width of that share, binomial.
    elsewhere : float
        Share of outcomes at neither of `once` and `twice`: after more ends, or lost.
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


def mean_more_ends(mass_ratio: float) -> float:
    """Mean of n - 1, r above, over the phases at e1 = 1: n is the whole part of r and one, or two, more."""
    mu = mass_ratio
    if mu >= 1:
        return 0.0
    q = math.sqrt((3 - mu) / (mu * (1 + mu)))
    return (math.sqrt(q * q - 1) - math.acos(1 / q)) / math.pi


def end_share(mass_ratio: float, n: int) -> float:
    """Share of phases with n ends of compression at e1 = 1, neither more nor fewer."""
    r = mean_more_ends(mass_ratio)
    return max(0.0, 1 - abs(n - 1 - r))


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
    return Branches(point, end_share(mu, 2), share, half, lost, once, e2 * once)
