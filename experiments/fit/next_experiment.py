"""The next experiment worth doing: the mass ratio at which laws differ most, and that tells k2/k1 best.

Laws are free of scale, so the speed of impact matters only through the error of a velocity per speed; that is taken
to be the median of the data's. Balls are taken from a tenth of the smallest to ten times the largest mass ratio of
the data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from impact_xval.experiments.fit.intervals import Interval
from impact_xval.experiments.fit.laws import LAWS, Floats
from impact_xval.experiments.fit.search import Objective
from impact_xval.experiments.fit.trials import Trials

#: Mass ratios that are tried, and how far beyond those of the data.
_TRIED, _BEYOND = 97, 10.0
#: m2/m1 that balls are to be had for.
_FEASIBLE = (0.02, 50.0)
#: Chains that draw parameters, how often they move, and how far aside, over the box.
_CHAINS, _MOVES, _NEAR = 256, 60, 1e-4


@dataclass(frozen=True, slots=True)
class Suggestion:
    """A mass ratio, and how far two laws are apart there in standard errors."""

    mass_ratio: float
    laws: tuple[str, str]
    apart: float


def mass_ratios(trials: Trials) -> Floats:
    """Give the mass ratios that are tried."""
    low = max(_FEASIBLE[0], trials.mass_ratio.min() / _BEYOND)
    high = min(_FEASIBLE[1], trials.mass_ratio.max() * _BEYOND)
    return np.geomspace(low, max(low, high), _TRIED)


def errors(trials: Trials) -> tuple[float, float]:
    """Give the median standard errors of v1 and v2 per speed; an error is infinite where v2 was never measured."""
    return float(np.median(trials.sd1)), float(np.median(trials.sd2))


def furthest_apart(trials: Trials, best: Mapping[str, Floats]) -> list[Suggestion]:
    """Find where laws, each at its best fit, are furthest apart.

    Parameters
    ----------
    trials : Trials
    best : mapping
        Parameters of each law that is in question, by name.

    Returns
    -------
    list of Suggestion
        One a pair, that of the largest distance first.
    """
    ratios, (sd1, sd2) = mass_ratios(trials), errors(trials)
    answers = {name: LAWS[name].velocities(point, ratios) for name, point in best.items()}
    found = []
    for one, other in combinations(best, 2):
        (a1, a2), (b1, b2) = answers[one], answers[other]
        apart = np.nan_to_num(np.hypot((a1 - b1) / sd1, (a2 - b2) / sd2))
        found.append(Suggestion(float(ratios[apart.argmax()]), (one, other), float(apart.max())))
    return sorted(found, key=lambda suggestion: -suggestion.apart)


def tells_stiffness(objective: Objective, stiffness: Interval) -> tuple[float, float] | None:
    """Find the mass ratio whose trial narrows what is known of k2/k1 most.

    Each of many parameters that explain the data is taken for the truth in turn, and the others are weighed by what a
    trial would then say of them (preposterior analysis: Chaloner and Verdinelli 1995, Statist. Sci. 10:273). Nothing
    is linear in that: an interval may be wide, have walls, or consist of several.

    Returns
    -------
    mass_ratio, share : float, optional
        Where, and the expected standard deviation of log10 k2/k1 over that of now; None where k2/k1 is known.
    """
    law, trials = objective.law, objective.trials
    k = law.parameters.index("log_k")
    if not objective.free[k]:
        return None
    points = plausible(objective.pooled(), stiffness)
    ratios, (sd1, sd2) = mass_ratios(trials), errors(trials)
    v1, v2 = (np.nan_to_num(v) for v in law.velocities(points, ratios))
    after = np.array(
        [_spread_after(points[:, k], v1[:, m] / sd1, v2[:, m] / sd2) for m in range(len(ratios))]
    )
    return float(ratios[after.argmin()]), float(after.min() / points[:, k].std())


def _spread_after(x: Floats, v1: Floats, v2: Floats) -> float:
    """Give the expected standard deviation of x once velocities, in standard errors, are measured."""
    weights = np.exp(-((v1[:, None] - v1) ** 2 + (v2[:, None] - v2) ** 2) / 2)
    weights /= weights.sum(axis=1, keepdims=True)
    mean = weights @ x
    return float(np.sqrt(np.maximum(weights @ x**2 - mean**2, 0)).mean())


def plausible(objective: Objective, stiffness: Interval) -> Floats:
    """Draw parameters with the probability that the data give them, all of the box being as likely before.

    Chains begin on the profile of k2/k1, in each of its pieces, and move by differences of one another, which takes
    the shape of what they draw from (ter Braak 2006, Statist. Comput. 16:239).

    Returns
    -------
    ndarray, shape (n, P)
    """
    random = np.random.default_rng(0)  # a fit is a function of its data
    likely = np.exp(-stiffness.profile / 2)
    points = stiffness.places[random.choice(len(likely), _CHAINS, p=likely / likely.sum())]
    chi2, (low, high) = objective.chi2(points), objective.box.T
    for _ in range(_MOVES):
        one, other = random.permuted(np.tile(np.arange(_CHAINS), (2, 1)), axis=1)
        gamma = 2.38 / np.sqrt(2 * objective.free.sum()) * random.choice([1.0, 0.5, 0.1], _CHAINS)[:, None]
        aside = _NEAR * (high - low) * random.standard_normal(points.shape)
        moved = points + gamma * (points[one] - points[other]) + aside
        inside = ((moved >= low) & (moved <= high)).all(axis=1)
        there = objective.chi2(np.clip(moved, low, high))
        take = inside & (np.log(random.random(_CHAINS)) < (chi2 - there) / 2)
        points, chi2 = np.where(take[:, None], moved, points), np.where(take, there, chi2)
    return points
