import pytest

from impact_xval.compliant_baselines import get_solver


@pytest.fixture(params=["mujoco", "pybullet"])
def engine(request):
    """Each engine that is installed."""
    solver = get_solver(request.param)
    reason = solver.unavailable()
    if reason is not None:
        pytest.skip(reason)
    return solver
