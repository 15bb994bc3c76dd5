import pytest
from numba import njit

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.sweep.chunk import warm


def from_python(part):
    """Compile a function that only kernels can call, so that a test can call it from Python."""
    return njit(lambda *numbers: part(*numbers))


@pytest.fixture(scope="session", autouse=True)
def compiled_kernels():
    """Compile all kernels that the tests need before the first test. A lock lets one worker process compile for all."""
    for kind in ("pair", "chain", "graph"):
        for name in ("state-transition", "kelvin-voigt", "mujoco", "pybullet"):
            warm(None, get_solver, name, kind)
