import pytest
from numba import njit

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.sweep.chunk import warm


def from_python(part):
    """Return a part of a kernel, which only kernels call, as a kernel of its own."""
    return njit(lambda *numbers: part(*numbers))


@pytest.fixture(scope="session", autouse=True)
def compiled_kernels():
    """Compile what solvers and runs need before the first test, once for all workers: `warm` locks."""
    for kind in ("pair", "chain", "graph"):
        for name in ("state-transition", "kelvin-voigt", "mujoco", "pybullet"):
            warm(None, get_solver, name, kind)
