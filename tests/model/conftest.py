"""Numba compiles the kernels of the model here, before the first test that runs them."""

import pytest

from impact_xval.model import Collision, Column, solve, solve_batch, solve_column, solve_columns


@pytest.fixture(scope="session", autouse=True)
def compiled_model():
    collision, column = Collision.from_ratios(2, 1.2, 0.9, 0.7), Column((1, 1), (1,), (0.9,), (-1, 0))
    for law in ("jia-mason-erdmann", "liu-zhao-brogliato"):
        solve(collision, impact_law=law, path=True)
        solve_batch([1e-3, 2, 40], 1.2, 0.9, 0.7, impact_law=law, cutoff_effect=True)
        for exponent in (1.0, 1.5):
            solve_columns([column], law=law, exponent=exponent)
            solve_column(column, law=law, exponent=exponent, path=True)
