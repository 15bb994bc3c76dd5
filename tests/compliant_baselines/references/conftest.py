"""Numba compiles the kernels of the references here, before the first test that runs them."""

import pytest

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.compliant_baselines.references import LAWS
from impact_xval.model import Collision
from tests.model.conftest import compiled, compiled_model  # noqa: F401


def references():
    for law in LAWS:
        get_solver(law).solve(Collision.from_ratios(2, 1, 0.9, 0.7), Settings(record_path=True))


@pytest.fixture(scope="session", autouse=True)
def compiled_references():
    compiled(references)
