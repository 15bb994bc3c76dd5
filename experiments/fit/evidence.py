"""How much the data speak for each law: information criteria, fit, and prediction of groups that were left out.

With chi^2 at the best fit, p free parameters and n measured velocities, AIC = chi^2 + 2 p (Akaike 1974) and BIC =
chi^2 + p ln n (Schwarz 1978); the constant of the likelihood is that of the data and the same for all. Akaike's
weight of a law is proportional to exp(-AIC/2) (Burnham and Anderson 2002). Whether any law explains the data is
another question: the probability that chi^2 with n - p degrees of freedom is at least that large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from impact_xval.experiments.fit.laws import Floats
from impact_xval.experiments.fit.search import Objective, search

#: Parts that groups are dealt into, each left out at once, where there are more groups.
PARTS = 10
#: Rise of chi^2 within which fits to the others are as good as the best, and the share by which their predictions of
#: what was left out may differ: by more, the others do not tell.
_AS_GOOD, _APART = 1e-4, 0.1
#: Probability of so large a chi^2 below which a law does not explain the data.
UNLIKELY = 0.001


@dataclass(frozen=True, slots=True)
class Evidence:
    """How well a law explains the data.

    Attributes
    ----------
    chi2 : float
    free : int
        Parameters that were fitted.
    measured : int
        Velocities.
    aic, bic : float
    probability : float
        Of a chi^2 at least that large if the law is true; NaN where nothing is left to test it by.
    left_out : float
        Sum of chi^2 of each group, predicted by a fit of the others, or of the groups of other parts (`PARTS`);
        NaN where it was not asked for, or cannot be (`left_out_of`).
    """

    chi2: float
    free: int
    measured: int
    aic: float
    bic: float
    probability: float
    left_out: float = float("nan")

    @property
    def explains(self) -> bool:
        """Whether the data are not improbable under the law."""
        return not self.probability < UNLIKELY


def evidence_of(objective: Objective, best: Floats) -> Evidence:
    """Judge a law at its best fit, shape (P,), without leaving groups out."""
    free, n = int(objective.free.sum()), objective.trials.measured
    chi2 = float(objective.chi2(best))
    probability = float(chi2_distribution.sf(chi2, n - free)) if n > free else float("nan")
    return Evidence(chi2, free, n, chi2 + 2 * free, chi2 + free * np.log(n), probability)


def left_out_of(objective: Objective) -> float:
    """Search for the parameters anew without each part of the groups, and hold them against that part.

    NaN where there is one group, or where what is left does not tell what it predicts: it has fewer velocities, those
    of one mass ratio counted once, than there are parameters, or fits that are as good predict something else.
    """
    names, group = np.unique(objective.trials.groups, return_inverse=True)
    parts, total = min(len(names), PARTS), 0.0
    if parts < 2:
        return float("nan")
    for part in range(parts):
        others, held = (
            objective.of(np.flatnonzero(chosen)) for chosen in (group % parts != part, group % parts == part)
        )
        t = others.trials
        told = sum(len(np.unique(t.mass_ratio[np.isfinite(sd)])) for sd in (t.sd1, t.sd2))
        if told < objective.free.sum():
            return float("nan")
        places, chi2, *_ = search(others.pooled())
        predicted = held.chi2(places[chi2 <= chi2[0] + _AS_GOOD])
        if np.ptp(predicted) > max(_APART, _APART * predicted[0]):
            return float("nan")
        total += float(predicted[0])
    return total


def weights_of(criteria: Floats) -> Floats:
    """Give Akaike's weights, which sum to 1."""
    relative = np.exp(-0.5 * (criteria - criteria.min()))
    return relative / relative.sum()
