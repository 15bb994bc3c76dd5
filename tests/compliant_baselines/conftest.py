import pytest

from impact_xval.compliant_baselines import get_solver


def installed(name):
    """Return a solver by name; skip the test if the engine of the solver is not installed."""
    solver = get_solver(name)
    if reason := solver.unavailable():
        pytest.skip(reason)
    return solver


@pytest.fixture(params=["mujoco", "pybullet"])
def engine(request):
    return installed(request.param)
