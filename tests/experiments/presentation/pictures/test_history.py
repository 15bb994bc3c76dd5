"""A collision over time: its forces and heights against what springs, and the model's energies, say they are."""

import math

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.presentation.pictures.history import history_of
from impact_xval.model import Collision, solve

ELASTIC = Collision.two_balls(m1=2.0, m2=3.0, k1=1e6, k2=3e6, e1=1.0, e2=1.0, v0=-0.5)


def of(name, **settings):
    outcome = get_solver(name).solve(ELASTIC, Settings(record_path=True, **settings))
    return outcome, history_of(ELASTIC, outcome.path, settings.get("gravity", 0.0))


@pytest.mark.parametrize("name", ["kelvin-voigt", "mujoco"])
def test_without_damping_a_force_is_that_of_a_spring_of_its_compression(name):
    """In units of k1 and abs(v0) sqrt(m1/k1): force 1 is compression 1, force 2 is k2/k1 times compression 2."""
    _, history = of(name)
    between = 0.5 * (history.compressions[1:] + history.compressions[:-1])
    springs = np.maximum(between, 0) * [1, 3]
    assert np.abs(history.forces - springs).max() < 0.02
    assert springs.max() > 0.5


def test_after_the_last_instant_balls_fly_on_with_the_velocities_of_the_outcome():
    outcome, history = of("kelvin-voigt")
    last = history.time[-1]
    heights, _, forces, acting = history.at(np.array([last, last + 2.0]))
    assert heights[1] - heights[0] == pytest.approx(np.array(outcome.velocities) * 2 / 0.5, rel=1e-9)
    assert forces[1].tolist() == [0.0, 0.0]
    assert not acting[1].any()


def test_a_drop_begins_where_the_table_carries_b2():
    _, history = of("kelvin-voigt", scenario="drop", gravity=9.81)
    length = 0.5 * math.sqrt(2.0 / 1e6)
    assert history.heights[0] == pytest.approx([-3.0 * 9.81 / 3e6 / length] * 2)
    weight = 3.0 * 9.81 / (0.5 * math.sqrt(2.0 * 1e6))
    assert history.forces[0, 1] == pytest.approx(weight, rel=0.05)


def test_without_a_finite_clock_there_is_no_history():
    collision = Collision.from_ratios(0.0, 1.0, 0.9, 0.7)
    assert history_of(collision, solve(collision, path=True).path) is None
