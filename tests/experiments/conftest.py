import pytest

from impact_xval.experiments.config.configuration import parse_config

SMALL = {
    "name": "small",
    "scenario": "impact",
    "solvers": ["mujoco", "pybullet"],
    "chunk_size": 4,
    "grid": {"stiffness_ratio": [0.5, 1.0, 2.0], "mass_ratio": [1.0, 1.5], "e1": [0.5, 0.9], "e2": [0.7]},
}


@pytest.fixture
def small():
    return parse_config(SMALL)
