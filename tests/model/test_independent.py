"""`solve` and `solve_batch` against two independent integrations, in time and in impulse space, and the latter's rates.

The integration in time is tests/model/reference.py, the one in impulse space `impact_xval.model.oracle`.
"""

import math

import numpy as np
import pytest

from impact_xval.model import SUPPLEMENT_CUTOFF, Collision, solve, solve_batch
from impact_xval.model.oracle import series, solve_oracle, straight_first_step
from tests.model.reference import integrate

#: Cells whose compression rate turned around this near zero are told apart: beside a jump, rounding decides.
GRAZING = 1e-7

MASS_RATIO = 2 / math.sqrt(3)


def random_cells(n, seed):
    rng = np.random.default_rng(seed)
    return np.array(
        [
            10 ** rng.uniform(-2, 2, n),
            10 ** rng.uniform(-1, 1, n),
            rng.uniform(0.3, 1, n),
            rng.uniform(0.3, 1, n),
        ]
    )


#: Cut-offs of the model and of the integrations: the same, or none and one at which they have converged.
CUTOFFS = [(SUPPLEMENT_CUTOFF, SUPPLEMENT_CUTOFF), ("exact", 1e8)]


def compare_in_time(cell, ours, cutoff):
    theirs = integrate(*cell, cutoff=cutoff)
    if math.dist((ours.v1, ours.v2), (theirs.v1, theirs.v2)) > 1e-9:  # it can miss a pair of events
        theirs = integrate(*cell, cutoff=cutoff, resolution=0.02)
    assert (ours.status == "limit") == theirs.limit, cell
    assert (ours.v1, ours.v2) == pytest.approx((theirs.v1, theirs.v2), abs=1e-9, rel=0), cell
    if not theirs.limit:
        assert ours.states == theirs.states, cell


def compare_in_impulse_space(cell, ours, cutoff):
    theirs = solve_oracle(Collision.from_ratios(*cell), stiffness_ratio_cutoff=cutoff)
    assert theirs.status in ("ok", "limit"), cell
    assert ours.status == theirs.status, cell
    assert (ours.v1, ours.v2) == pytest.approx((theirs.v1, theirs.v2), abs=1e-8, rel=0), cell
    if theirs.status == "ok":
        assert (ours.states, ours.n_events) == (theirs.states, theirs.n_events), cell


def compare(cells, cutoffs, *comparisons):
    """Assert agreement wherever the margin promises it; how many cells are beside a jump, and how many are limits."""
    batch = solve_batch(*cells, stiffness_ratio_cutoff=cutoffs[0])
    grazing = limits = 0
    for i, cell in enumerate(cells.T.tolist()):
        ours = solve(Collision.from_ratios(*cell), stiffness_ratio_cutoff=cutoffs[0])
        assert ours.status == batch.status[i], cell
        if ours.grazing_margin < GRAZING:
            grazing += 1
            continue
        limits += ours.status == "limit"
        assert (batch.v1[i], batch.v2[i]) == pytest.approx((ours.v1, ours.v2), abs=8e-16, rel=0), cell
        for comparison in comparisons:
            comparison(cell, ours, cutoffs[1])
    return grazing, limits


@pytest.mark.parametrize("cutoffs", CUTOFFS)
def test_forty_random_cells_are_those_of_both_integrations(cutoffs):
    cells = random_cells(40, seed=31)
    assert compare(cells, cutoffs, compare_in_time, compare_in_impulse_space)[0] <= 1


@pytest.mark.parametrize("cutoffs", CUTOFFS)
def test_elastic_contacts_are_those_of_both_integrations(cutoffs):
    ratios, masses = np.meshgrid([0.02, 0.7, 30.0], [0.3, 1.7])
    ones = np.ones(ratios.size)
    for e1, e2 in ((1.0, 1.0), (1.0, 0.6), (0.6, 1.0)):
        cells = np.array([ratios.ravel(), masses.ravel(), e1 * ones, e2 * ones])
        assert compare(cells, cutoffs, compare_in_time, compare_in_impulse_space)[0] == 0


@pytest.mark.nightly
def test_six_hundred_random_cells_are_those_of_the_integration_in_time():
    grazing, limits = compare(random_cells(600, seed=1), CUTOFFS[0], compare_in_time)
    assert limits > 100  # about a third reach the cut-off
    assert grazing < 12


@pytest.mark.nightly
def test_two_thousand_random_cells_are_those_of_the_integration_in_impulse_space():
    grazing, limits = compare(random_cells(2000, seed=7), CUTOFFS[0], compare_in_impulse_space)
    assert grazing <= 20
    assert limits > 300  # the closed form beyond the cut-off is compared too


def test_the_series_at_first_touch_leaves_a_residual_of_the_next_order():
    """The residual of (15), (dI2/dI1)^2 E1 - (k2/k1) E2, is of relative order I1^3."""
    for stiffness_ratio, mass_ratio in ((0.05, 0.3), (1.0, 1.0), (60.0, 4.0)):
        scale = 1 / (1 + 1 / mass_ratio + stiffness_ratio / mass_ratio)
        residuals = []
        for I1 in (scale * np.array([0.02, 0.04, 0.08])).tolist():
            _, E1, E2 = series(stiffness_ratio, mass_ratio, I1)
            h = 1e-4 * I1
            after, before = (series(stiffness_ratio, mass_ratio, x)[0] for x in (I1 + h, I1 - h))
            slope = (after - before) / (2 * h)
            residuals.append(abs(slope * slope * E1 / (stiffness_ratio * E2) - 1))
        np.testing.assert_allclose(np.diff(np.log2(residuals)), 3, atol=0.35)


def test_the_shift_by_a_finite_first_step_vanishes_with_it():
    """E2 after the straight first step is off by its own order, I1^3, so the force sqrt(2 k2 E2) is by I1^(3/2)."""
    steps = np.array([1e-2, 1e-3, 1e-4])
    for stiffness_ratio in (0.2, 1.0, 10.0):
        collision = Collision.from_ratios(stiffness_ratio, MASS_RATIO, 0.9, 0.7)
        exact = solve_oracle(collision)
        outcomes = [solve_oracle(collision, first_step=step) for step in steps.tolist()]
        assert {o.states for o in outcomes} == {exact.states}
        shifts = [math.hypot(o.v1 - exact.v1, o.v2 - exact.v2) for o in outcomes]
        assert shifts[0] > 1e-6
        np.testing.assert_allclose(np.diff(np.log(shifts)) / np.diff(np.log(steps)), 1.5, atol=0.05)


def test_a_finite_first_step_has_the_limit_that_the_supplement_quotes():
    impulse2, _, _ = straight_first_step(1e12, MASS_RATIO, 1e-2)
    assert impulse2 == pytest.approx(1e-2, rel=1e-8)
