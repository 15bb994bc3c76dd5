"""Two balls on a table, compared with two independent integrations.

`chain_reference` integrates in time, `oracle` in impulse space.
"""

import math
from itertools import product

import numpy as np
import pytest

from impact_xval.model import SUPPLEMENT_CUTOFF, Collision, solve, solve_batch
from tests.compliant_baselines.reference_cells import random_cells
from tests.model.chain_reference import LZB, integrate
from tests.model.chains import assert_integrated
from tests.model.oracle import solve_oracle

#: Cells with a grazing margin below this are not compared: beside a jump, rounding decides the outcome.
GRAZING = 1e-7

#: Pairs of cut-offs of the stiffness ratio, for the model and for the integration in impulse space. In the first pair
#: both are equal. In the second the model uses its exact rule, and the integration a cut-off so large that it has
#: converged.
CUTOFFS = [(SUPPLEMENT_CUTOFF, SUPPLEMENT_CUTOFF), ("exact", 1e8)]


def compare_in_time(cell, ours, _):
    assert_integrated(ours, Collision.from_ratios(*cell))


def compare_in_impulse_space(cell, ours, cutoff):
    theirs = solve_oracle(Collision.from_ratios(*cell), stiffness_ratio_cutoff=cutoff)
    assert ours.status == theirs.status, cell
    assert ours.velocities == pytest.approx((theirs.v1, theirs.v2), abs=1e-8, rel=0), cell
    if theirs.status == "ok":
        assert (ours.states, ours.n_events) == (theirs.states, theirs.n_events), cell


def compare(cells, cutoffs, *comparisons):
    """Assert agreement in all cells that are not beside a jump.

    Return how many cells are beside a jump, and how many others a closed form finished.
    """
    grazing = limits = 0
    batch = solve_batch(*cells, stiffness_ratio_cutoff=cutoffs[0], states=True)
    for cell, ours in zip(cells.T.tolist(), batch.flat, strict=True):
        if ours.grazing_margin < GRAZING:
            grazing += 1
            continue
        limits += ours.status == "closed-form"
        for comparison in comparisons:
            comparison(cell, ours, cutoffs[1])
    return grazing, limits


@pytest.mark.parametrize("cutoffs", CUTOFFS)
def test_random_and_elastic_cells_are_those_of_both_integrations(cutoffs):
    comparisons = (compare_in_impulse_space, compare_in_time)[: 1 + (cutoffs[0] == "exact")]
    assert compare(np.array(random_cells(15, 31)), cutoffs, *comparisons)[0] <= 1
    elastic = product([0.02, 30.0], [0.3, 1.7], [(1.0, 1.0), (1.0, 0.6), (0.6, 1.0)])
    cells = np.transpose([(ratio, mass, *e) for ratio, mass, e in elastic])
    assert compare(cells, cutoffs, *comparisons)[0] == 0


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("n", "cutoffs", "comparison"),
    [(600, CUTOFFS[1], compare_in_time), (2000, CUTOFFS[0], compare_in_impulse_space)],
)
def test_many_random_cells_are_those_of_an_integration(n, cutoffs, comparison):
    grazing, limits = compare(np.array(random_cells(n, 1)), cutoffs, comparison)
    assert grazing <= n / 100
    assert limits > n / 5  # beyond the cut-off, closed forms are compared with each other


def test_random_cells_by_the_law_of_liu_zhao_and_brogliato_are_those_of_an_integration_in_time():
    repeated = 0
    for cell in np.transpose(random_cells(60, 8)).tolist():
        c = Collision.from_ratios(*cell)
        o = solve(c, law=LZB, stiffness_ratio_cutoff=math.inf)
        if o.v1 > 0:  # otherwise both balls end at rest, which the next test is about
            assert_integrated(o, c, LZB)
            repeated += math.dist(o.velocities, solve(c).velocities) > 1e-6
    assert repeated >= 40


def test_a_cycle_that_repeats_on_a_smaller_scale_ends_at_rest():
    """A cycle of states that repeats on an ever smaller scale ends with both balls at rest.

    It has infinitely many events. The velocities at successive returns shrink by a constant factor. The independent
    integration ends below 2e-3 m/s.
    """
    c = Collision.from_ratios(0.775, 0.165, 0.4, 0.33)
    o = solve(c, law=LZB, path=True)
    p = o.path
    assert (o.v1, o.v2, o.status) == (0, 0, "closed-form")
    assert "infinitely many events" in o.reason
    returns = p.v1[1:][(p.state[1:] == 1) & (p.state[:-1] == 2)]
    factors = returns[31:60] / returns[30:59]
    np.testing.assert_allclose(factors, factors[-1], rtol=1e-5)
    assert 0.1 < factors[-1] < 0.9
    assert math.hypot(*integrate(c, LZB, least=1e-3).velocities) < 2e-3
    # by the default law contacts stay stiffer, so that the cycle ends
    assert solve(c).v1 > 0.01
