import pytest

from impact_xval.compliant_baselines import get_solver


def installed(name):
    """Give a solver; without its engine the test is skipped."""
    solver = get_solver(name)
    if reason := solver.unavailable():
        pytest.skip(reason)
    return solver


@pytest.fixture(params=["mujoco", "pybullet"])
def engine(request):
    return installed(request.param)
