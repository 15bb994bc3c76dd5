"""Columns against an independent integration in time (tests/model/column_reference.py)."""

import numpy as np
import pytest

from impact_xval.model import solve_column
from tests.model.column_reference import integrate
from tests.model.test_columns import GRAZING, LAWS, random_column

#: The integration looks at signs, and misses pairs of events; it is repeated at this resolution before it counts.
FINER = 0.02


def compare(seed, count, law, exponent, bound, balls=None):
    """Compare random columns; how many were left out, beside a jump or with infinitely many events."""
    rng = np.random.default_rng(seed)
    left_out = 0
    for _ in range(count):
        column = random_column(rng, balls)
        ours = solve_column(column, law=law, exponent=exponent)
        assert ours.grazing_margin is not None
        if ours.grazing_margin < GRAZING or "infinitely many" in ours.reason:
            left_out += 1
            continue
        theirs = integrate(column, exponent, law == LAWS[0])
        if np.abs(np.subtract(ours.velocities, theirs.velocities)).max() > bound:
            theirs = integrate(column, exponent, law == LAWS[0], resolution=FINER)
        assert ours.velocities == pytest.approx(theirs.velocities, abs=bound, rel=0), column
        assert (ours.status == "limit") == theirs.limit, column
        if not theirs.limit:
            assert ours.states == theirs.states, column
    return left_out


@pytest.mark.parametrize("law", LAWS)
def test_random_columns_are_those_of_the_integration(law):
    compare(20, 5, law, 1.0, 1e-9)
    compare(21, 4, law, 1.5, 1e-9, balls=3)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("law", "exponent", "count"), [(LAWS[0], 1.0, 15), (LAWS[1], 1.0, 30), (LAWS[1], 1.5, 10)]
)
def test_more_random_columns_are_those_of_the_integration(law, exponent, count):
    assert compare(22, count, law, exponent, 1e-9) <= 2
