"""Measures of columns: for two balls those of two balls, and what is known of single contacts."""

import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Convergence, Settings
from impact_xval.experiments.measures.divergence import measures_of
from impact_xval.model import Collision

CELL = Collision.two_balls(m1=2.0, m2=3.0, k1=1e8, k2=3e8, e1=0.9, e2=0.7, v0=-3.0)
COLUMN = Collision((2.0, 3.0), (1e8, 3e8), (0.9, 0.7), (-3.0, 0.0), table=True)
NAMES = ("state-transition", "bistiffness", "kelvin-voigt")


def _by(names, column, settings=Settings()):  # noqa: B008
    return {name: get_solver(name).solve_many([column], settings)[0] for name in names}


def test_a_pair_keeps_its_momentum_and_what_e_leaves_of_its_energy():
    pair = Collision((1.0, 3.0), (1e6,), (0.5,), (-2.0, 0.0))
    for measures in measures_of(pair, _by(NAMES, pair)).values():
        assert measures.retained_momentum == pytest.approx(1, abs=1e-12)
        assert measures.retained_energy == pytest.approx(0.25 + 0.75 * 0.25, abs=1e-12)
        assert measures.velocity_divergence == pytest.approx(0, abs=1e-12)


def test_the_limit_of_an_engine_is_held_against_its_law():
    chain = Collision((1.0,) * 3, (1e8,) * 2, (0.9,) * 2, (-2.0, 0.0, 0.0))
    outcomes = _by(("kelvin-voigt", "mujoco"), chain, Settings(convergence=Convergence()))
    found = measures_of(chain, outcomes)["mujoco"]
    assert 0 < found.limit_distance < 3 * found.limit_error < 3e-3
    assert found.limit_error == outcomes["mujoco"].diagnostics["limit_error"] / 2
    assert found.velocity_divergence is None  # the model is not among them
    alone = measures_of(chain, {"mujoco": outcomes["mujoco"]})["mujoco"]
    naive = measures_of(chain, outcomes, "naive")["mujoco"]
    assert alone.limit_distance is naive.limit_distance is None
    assert alone.limit_error == naive.limit_error == found.limit_error
