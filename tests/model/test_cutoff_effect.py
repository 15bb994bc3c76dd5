"""What is said of the effect of a cut-off, against the outcome without one."""

import math

import numpy as np
import pytest

from impact_xval.model import Collision, solve, solve_batch
from tests.model import sample


def random_cells(n, seed):
    rng = np.random.default_rng(seed)
    return (
        10 ** rng.uniform(-2, 2, n),
        10 ** rng.uniform(-1, 1, n),
        rng.uniform(0.3, 1, n),
        rng.uniform(0.3, 1, n),
    )


@pytest.mark.parametrize("cutoff", [1e3, 1e5])
def test_it_is_the_change_when_the_cut_off_is_switched_off(cutoff):
    cells = random_cells(sample(10_000), 1)
    with_it = solve_batch(*cells, stiffness_ratio_cutoff=cutoff, cutoff_effect=True)
    without = solve_batch(*cells, stiffness_ratio_cutoff=math.inf)
    change = np.hypot(with_it.v1 - without.v1, np.sqrt(cells[1]) * (with_it.v2 - without.v2))
    used = with_it.status == "limit"
    assert used.mean() > 0.2
    assert np.all(with_it.cutoff_effect[~used] == 0)
    assert np.all(change[~used] == 0)
    assert np.max(with_it.cutoff_effect) > 1e-8
    assert np.max(np.abs(with_it.cutoff_effect - change)) < 1e-11


def test_solve_says_the_same():
    cells = random_cells(300, 2)
    batch = solve_batch(*cells, cutoff_effect=True)
    for i, cell in enumerate(zip(*cells, strict=True)):
        effect = solve(Collision.from_ratios(*map(float, cell))).diagnostics["cutoff_effect"]
        assert effect == pytest.approx(batch.cutoff_effect[i], rel=1e-6, abs=1e-14)


def test_exact_limits_have_none():
    for kappa, e1, e2 in ((0.0, 0.9, 0.7), (math.inf, 0.9, 0.7), (1.0, 0.0, 0.7), (1.0, 0.9, 0.0)):
        outcome = solve(Collision.from_ratios(kappa, 1.3, e1, e2))
        assert (outcome.status, outcome.diagnostics["cutoff_effect"]) == ("limit", 0.0)
    assert solve_batch(1.0, 1.0, 0.9, 0.9).cutoff_effect is None


@pytest.mark.parametrize("max_events", [15, 30, 60])
def test_it_is_not_known_where_the_raised_cut_off_asks_for_too_many_events(max_events):
    cells = random_cells(sample(2_000), 3)
    few, many = (solve_batch(*cells, cutoff_effect=True, max_events=n) for n in (max_events, 10_000))
    assert few.cutoff_effect is not None
    assert many.cutoff_effect is not None
    limit = few.status == "limit"
    unknown = limit & np.isnan(few.cutoff_effect)
    assert unknown.any()
    assert np.array_equal(few.cutoff_effect[limit & ~unknown], many.cutoff_effect[limit & ~unknown])
    i = np.flatnonzero(unknown)[0]
    outcome = solve(Collision.from_ratios(*(float(a[i]) for a in cells)), max_events=max_events)
    assert outcome.status == "limit"
    assert "cutoff_effect" not in outcome.diagnostics
