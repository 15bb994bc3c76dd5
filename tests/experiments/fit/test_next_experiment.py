"""What one more trial would say of k2/k1: against a normal distribution, and sums over a grid."""

import numpy as np
import pytest
from scipy.stats import norm

from impact_xval.experiments.fit.fitting import fit
from impact_xval.experiments.fit.next_experiment import _spread_after, plausible
from tests.experiments.fit.planted import trials


@pytest.mark.parametrize("slope", [0.0, 0.5, 3.0])
def test_of_a_normal_distribution_the_precisions_add(slope):
    """x of deviation 2, measured by slope x with an error of 1: 1/4 + slope^2 is the precision after."""
    x = 2 * norm.ppf((np.arange(4000) + 0.5) / 4000)
    found = _spread_after(x, slope * x, np.zeros_like(x))
    assert found == pytest.approx((1 / 4 + slope**2) ** -0.5, rel=0.01)


def test_what_is_plausible_is_so_as_likely_as_the_data_say():
    point = [0.4, 0.8, 0.6]
    (found,) = fit(trials("state-transition", point, noise=1), "state-transition").fitted
    drawn = plausible(found.objective, found.intervals[0])
    axes = [np.linspace(*np.clip([i.low - 0.1, i.high + 0.1], *box), 61)
            for i, box in zip(found.intervals, found.objective.box, strict=True)]  # fmt: skip
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    chi2 = found.objective.chi2(grid)
    weights = np.exp((chi2.min() - chi2) / 2)
    mean = weights @ grid / weights.sum()
    deviation = np.sqrt(weights @ (grid - mean) ** 2 / weights.sum())
    assert np.abs(drawn.mean(axis=0) - mean).max() / deviation.max() < 4 / np.sqrt(len(drawn))
    assert drawn.std(axis=0) == pytest.approx(deviation, rel=0.2)


def test_another_trial_narrows_as_much_as_is_said():
    point = np.array([0.4, 0.8, 0.6])
    data = trials("state-transition", point, np.geomspace(0.8, 1.25, 8), noise=1)
    before = fit(data, "state-transition")
    assert before.narrows is not None
    ratio, share = before.narrows
    more = trials("state-transition", point, [*np.geomspace(0.8, 1.25, 8), ratio], noise=1)
    more.iloc[:8] = data
    after = fit(more, "state-transition")

    def deviation(found):
        return plausible(found.best.objective, found.best.intervals[0])[:, 0].std()

    assert deviation(after) / deviation(before) == pytest.approx(share, rel=0.5)
