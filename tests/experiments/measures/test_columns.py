"""Measures of columns: for two balls those of two balls, and what is known of single contacts."""

import math

import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Convergence, Settings
from impact_xval.experiments.measures.columns.measuring import ColumnMeasures, measures_of
from impact_xval.experiments.measures.divergence import divergence
from impact_xval.model import Collision, Column

CELL = Collision(m1=2.0, m2=3.0, k1=1e8, k2=3e8, e1=0.9, e2=0.7, v0=-3.0)
COLUMN = Column((2.0, 3.0), (1e8, 3e8), (0.9, 0.7), (-3.0, 0.0), table=True)
NAMES = ("state-transition", "bistiffness", "kelvin-voigt")


def _by(names, column, settings=Settings()):  # noqa: B008
    return {name: get_solver(name).solve_columns([column], settings)[0] for name in names}


def test_of_two_balls_on_a_table_they_are_those_of_the_collision():
    found = measures_of(COLUMN, _by(NAMES, COLUMN))
    model = get_solver(NAMES[0]).solve(CELL)
    for name in NAMES:
        outcome = get_solver(name).solve(CELL)
        expected = divergence(CELL, model, outcome, ((), ()))["velocity_divergence"]
        assert found[name].velocity_divergence == pytest.approx(expected, rel=1e-12, abs=1e-13)
        assert found[name].retained_energy == pytest.approx(outcome.retained_energy(CELL), rel=1e-12)
        momentum = (2.0 * outcome.v1 + 3.0 * outcome.v2) / -6.0
        assert found[name].retained_momentum == pytest.approx(momentum, rel=1e-12)
    assert found["kelvin-voigt"].velocity_divergence > 0.01


def test_a_pair_keeps_its_momentum_and_what_e_leaves_of_its_energy():
    pair = Column((1.0, 3.0), (1e6,), (0.5,), (-2.0, 0.0))
    for measures in measures_of(pair, _by(NAMES, pair)).values():
        assert measures.retained_momentum == pytest.approx(1, abs=1e-12)
        assert measures.retained_energy == pytest.approx(0.25 + 0.75 * 0.25, abs=1e-12)
        assert measures.velocity_divergence == pytest.approx(0, abs=1e-12)


def test_the_limit_of_an_engine_is_held_against_its_law():
    chain = Column((1.0,) * 3, (1e8,) * 2, (0.9,) * 2, (-2.0, 0.0, 0.0))
    outcomes = _by(("kelvin-voigt", "mujoco"), chain, Settings(convergence=Convergence()))
    found = measures_of(chain, outcomes)["mujoco"]
    assert 0 < found.limit_distance < 3 * found.limit_error < 3e-3
    assert found.limit_error == outcomes["mujoco"].diagnostics["limit_error"] / 2
    assert found.velocity_divergence is None  # the model is not among them
    alone = measures_of(chain, {"mujoco": outcomes["mujoco"]})["mujoco"]
    naive = measures_of(chain, outcomes, "naive")["mujoco"]
    assert alone.limit_distance is naive.limit_distance is None
    assert alone.limit_error == naive.limit_error == found.limit_error


def test_nothing_is_measured_without_a_result():
    hertz = get_solver("mujoco").solve_columns([COLUMN], Settings(), 1.5)[0]
    assert measures_of(COLUMN, {"mujoco": hertz}) == {"mujoco": ColumnMeasures()}


def test_no_scale_leaves_double_precision():
    for scale in (1e-150, 1e150):
        chain = Column((scale, 2 * scale), (1.0,), (1.0,), (-scale, 0.0))
        (measures,) = measures_of(chain, _by(NAMES[:1], chain)).values()
        assert measures.retained_energy == pytest.approx(1, rel=1e-12)
        assert measures.retained_momentum == pytest.approx(1, rel=1e-12)
        assert not math.isnan(measures.velocity_divergence)
