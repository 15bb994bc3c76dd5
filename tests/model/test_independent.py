"""The exact solver against an independent integration in time (tests/model/reference.py)."""

import numpy as np
import pytest

from impact_xval.model import SUPPLEMENT_CUTOFF, Collision, solve
from tests.model.reference import integrate

#: Cells whose compression rate turned around this near zero are told apart: beside a jump, rounding decides.
GRAZING = 1e-7


def random_cells(n, seed):
    rng = np.random.default_rng(seed)
    columns = (
        10 ** rng.uniform(-2, 2, n),
        10 ** rng.uniform(-1, 1, n),
        rng.uniform(0.3, 1, n),
        rng.uniform(0.3, 1, n),
    )
    return list(zip(*(c.tolist() for c in columns), strict=True))


#: Cut-offs of the model and of the integration: the same, or none and one at which the integration has converged.
CUTOFFS = [(SUPPLEMENT_CUTOFF, SUPPLEMENT_CUTOFF), ("exact", 1e8)]


def compare(cells, cutoff, of_integration):
    grazing = limits = 0
    for cell in cells:
        ours = solve(Collision.from_ratios(*cell), stiffness_ratio_cutoff=cutoff)
        theirs = integrate(*cell, cutoff=of_integration)
        if ours.grazing_margin < GRAZING:
            grazing += 1
            continue
        limits += theirs.limit
        assert (ours.status == "limit") == theirs.limit, cell
        assert ours.v1 == pytest.approx(theirs.v1, abs=1e-9, rel=0), cell
        assert ours.v2 == pytest.approx(theirs.v2, abs=1e-9, rel=0), cell
        if not theirs.limit:
            assert ours.states == theirs.states, cell
    return grazing, limits


@pytest.mark.parametrize("cutoffs", CUTOFFS)
def test_forty_random_cells(cutoffs):
    compare(random_cells(40, seed=20130101), *cutoffs)


@pytest.mark.nightly
def test_six_hundred_random_cells_with_those_that_reach_the_cutoff():
    grazing, limits = compare(random_cells(600, seed=1), *CUTOFFS[0])
    assert limits > 100  # about a third reach the cut-off
    assert grazing < 12


@pytest.mark.nightly
def test_three_hundred_random_cells_without_a_cutoff():
    grazing, limits = compare(random_cells(300, seed=2), *CUTOFFS[1])
    assert limits > 60
    assert grazing < 6


@pytest.mark.parametrize("cutoffs", CUTOFFS)
@pytest.mark.parametrize(("e1", "e2"), [(1.0, 1.0), (1.0, 0.6), (0.6, 1.0)])
@pytest.mark.parametrize("mass_ratio", [0.3, 1.7])
@pytest.mark.parametrize("stiffness_ratio", [0.02, 0.7, 30.0])
def test_elastic_contacts(stiffness_ratio, mass_ratio, e1, e2, cutoffs):
    cell = (stiffness_ratio, mass_ratio, e1, e2)
    assert not compare([cell], *cutoffs)[0]
