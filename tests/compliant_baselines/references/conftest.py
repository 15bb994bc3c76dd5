"""Numba compiles the kernels of the references here, before the first test that runs them."""

from itertools import product

import pytest

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.compliant_baselines.references.bistiffness import bistiffness_batch
from impact_xval.compliant_baselines.references.columns.solving import LAWS, solve_column
from impact_xval.compliant_baselines.references.kelvin_voigt import DAMPINGS, kelvin_voigt_batch
from impact_xval.model import Collision, Column
from tests.model.conftest import compiled, compiled_model  # noqa: F401


def batches():
    for frozen in (False, True):
        bistiffness_batch([1.0, 2.0], 1.0, 0.9, 0.7, 0.01, frozen=frozen)
        for damping in DAMPINGS:
            kelvin_voigt_batch([1.0, 2.0], 1.0, 0.9, 0.7, 0.01, damping=damping, frozen=frozen)
    for settings in (Settings(record_path=True), Settings("drop", 0.05, record_path=True)):
        for law in LAWS:
            get_solver(law).solve(Collision.from_ratios(2, 1, 0.9, 0.7), settings)


def columns():
    column = Column((1, 1, 1), (1, 1), (0.9, 0.9), (-1, 0, 0))
    for law, exponent in product(LAWS, (1, 1.5)):
        solve_column(column, law, exponent=exponent, path=True)
        solve_column(column, law, exponent=exponent, frozen=True)


@pytest.fixture(scope="session", autouse=True)
def compiled_references():
    compiled(batches, columns)
