"""`solve_batch` against two independent integrations: in time (column_reference) and in impulse space (oracle)."""

from itertools import product

import numpy as np
import pytest

from impact_xval.model import SUPPLEMENT_CUTOFF, Collision, solve_batch
from tests.compliant_baselines.reference_cells import random_cells
from tests.model.columns import assert_integrated
from tests.model.oracle import solve_oracle

#: Cells whose compression rate turned around this near zero are told apart: beside a jump, rounding decides.
GRAZING = 1e-7

#: Cut-offs of the model and of the integration in impulse space: the same, or none and one at which it has converged.
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
    """Assert agreement wherever the margin promises it; how many cells are beside a jump, and how many are limits."""
    grazing = limits = 0
    batch = solve_batch(*cells, stiffness_ratio_cutoff=cutoffs[0], states=True)
    for cell, ours in zip(cells.T.tolist(), batch, strict=True):
        if ours.grazing_margin < GRAZING:
            grazing += 1
            continue
        limits += ours.status == "limit"
        for comparison in comparisons:
            comparison(cell, ours, cutoffs[1])
    return grazing, limits


@pytest.mark.parametrize("cutoffs", CUTOFFS)
def test_random_and_elastic_cells_are_those_of_both_integrations(cutoffs):
    comparisons = (compare_in_impulse_space, compare_in_time)[: 1 + (cutoffs[0] == "exact")]
    assert compare(np.array(random_cells(40, 31)), cutoffs, *comparisons)[0] <= 1
    elastic = product([0.02, 0.7, 30.0], [0.3, 1.7], [(1.0, 1.0), (1.0, 0.6), (0.6, 1.0)])
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
    assert limits > n / 5  # beyond the cut-off a closed form is compared
