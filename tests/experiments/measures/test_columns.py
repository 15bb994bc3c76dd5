"""Measures of columns: the limit of an engine and its law."""

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Convergence, Settings
from impact_xval.experiments.measures.divergence import measures_of
from impact_xval.model import Collision


def _by(names, column, settings=Settings()):  # noqa: B008
    return {name: get_solver(name).solve_many([column], settings)[0] for name in names}


def test_the_limit_of_an_engine_is_held_against_its_law():
    chain = Collision((1.0,) * 3, (1e8,) * 2, (0.9,) * 2, (-2.0, 0.0, 0.0))
    outcomes = _by(("kelvin-voigt", "mujoco"), chain, Settings(convergence=Convergence()))
    found = measures_of(chain, outcomes)["mujoco"]
    assert 0 < found["limit_distance"] < 3 * found["limit_error"] < 3e-3
    assert found["limit_error"] == outcomes["mujoco"].diagnostics["limit_error"] / 2
    assert found["velocity_divergence"] is None  # the model is not among them
    alone = measures_of(chain, {"mujoco": outcomes["mujoco"]})["mujoco"]
    naive = measures_of(chain, outcomes, "naive")["mujoco"]
    assert alone["limit_distance"] is naive["limit_distance"] is None
    assert alone["limit_error"] == naive["limit_error"] == found["limit_error"]
