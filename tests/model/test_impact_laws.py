"""The law of Liu, Zhao and Brogliato beside the model's own: two readings of a repeated compression."""

import math

import numpy as np

from impact_xval.model import Collision, solve, solve_batch
from impact_xval.model.inputs import GRAZING_THRESHOLD
from impact_xval.model.pair.grazing import GRAZING
from tests.compliant_baselines.reference_cells import random_cells
from tests.model.column_reference import LZB, integrate
from tests.model.columns import assert_integrated


def test_random_cells_are_those_of_an_integration_in_time():
    repeated = 0
    for cell in np.transpose(random_cells(60, 8)).tolist():
        c = Collision.from_ratios(*cell)
        o = solve(c, law=LZB, stiffness_ratio_cutoff=math.inf)
        if o.v1 > 0:  # else collapsed, the subject of the test below
            assert_integrated(o, c, LZB)
            repeated += math.dist(o.velocities, solve(c).velocities) > 1e-6
    assert repeated >= 40


def test_a_cycle_that_repeats_on_a_smaller_scale_ends_at_rest():
    """A cycle of states that repeats on a smaller scale for ever: by self-similarity the bodies end at rest."""
    c = Collision.from_ratios(0.775, 0.165, 0.4, 0.33)
    o = solve(c, law=LZB, path=True)
    p = o.path
    assert (o.v1, o.v2, o.status) == (0, 0, "limit")
    assert "infinitely many events" in o.reason
    returns = p.v1[1:][(p.state[1:] == 1) & (p.state[:-1] == 2)]
    factors = returns[31:60] / returns[30:59]
    np.testing.assert_allclose(factors, factors[-1], rtol=1e-5)
    assert 0.1 < factors[-1] < 0.9
    assert math.hypot(*integrate(c, LZB, least=1e-3).velocities) < 2e-3
    assert solve(c).v1 > 0.01  # stiffening ends the cycle


def test_a_law_without_jumps_is_marked_for_none():
    cells = random_cells(60_000, 3)
    here, there = solve_batch(*cells), solve_batch(*cells, law=LZB)
    near = np.flatnonzero(here.grazing_margin < 2e-4)
    assert len(near) > 20
    assert np.isinf(there.grazing_margin).all()
    assert not there.mark.any()
    assert np.array_equal(here.marked == GRAZING, here.grazing_margin < GRAZING_THRESHOLD)
    # next to where it would be marked, nothing moves
    some = [x[near] for x in cells]
    moved = solve_batch(some[0] * (1 + 1e-5), *some[1:], law=LZB)
    assert np.abs(moved.v1 - there.v1[near]).max() < 1e-3
