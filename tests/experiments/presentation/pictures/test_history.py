"""A collision over time: its forces and heights against what springs, and the model's energies, say they are."""

import math

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.experiments.presentation.pictures.history import history_of
from impact_xval.model import Collision, solve

ELASTIC = Collision(m1=2.0, m2=3.0, k1=1e6, k2=3e6, e1=1.0, e2=1.0, v0=-0.5)


def of(name, collision, **settings):
    outcome = get_solver(name).solve(collision, Settings(record_path=True, **settings))
    return outcome, history_of(collision, outcome.path, settings.get("gravity", 0.0))


@pytest.mark.parametrize("name", ["kelvin-voigt", "mujoco"])
def test_without_damping_a_force_is_that_of_a_spring_of_its_compression(name):
    """In units of k1 and abs(v0) sqrt(m1/k1): force 1 is compression 1, force 2 is k2/k1 times compression 2."""
    _, history = of(name, ELASTIC)
    between = 0.5 * (history.compressions[1:] + history.compressions[:-1])
    springs = np.maximum(between, 0) * [1, 3]
    assert np.abs(history.forces - springs).max() < 0.02
    assert springs.max() > 0.5


def test_the_model_s_clock_is_that_of_its_forces():
    """F = sqrt(2 k E), with k as stiff as ends of compression have made it: k/e^2 after the first."""
    collision = Collision(m1=1.0, m2=2 / math.sqrt(3), k1=4.0, k2=4.0, e1=0.9, e2=0.7)
    path = solve(collision, path=True).path
    history = history_of(collision, path)
    units = collision.units
    first = (
        (path.state == 1) & (path.phase1 == 1) & (path.time < 0.5 * units.time)
    )  # before any end of compression
    instants = path.time[first][1:-1] / units.time
    forces = np.sqrt(2 * 4.0 * np.column_stack([path.energy1, path.energy2])[first][1:-1])
    assert len(instants) > 10
    assert history.force(instants) * math.sqrt(4.0) == pytest.approx(forces, abs=0.01)


def test_what_has_passed_at_the_end_are_the_impulses_of_the_outcome():
    outcome, history = of("kelvin-voigt", ELASTIC)
    assert history.impulses[-1] * 2.0 * 0.5 == pytest.approx([outcome.impulse1, outcome.impulse2], rel=1e-9)
    passed = (history.forces * np.diff(history.time)[:, None]).sum(axis=0)
    assert passed == pytest.approx(history.impulses[-1], rel=1e-9)


def test_after_the_end_balls_fly_on():
    outcome, history = of("kelvin-voigt", ELASTIC)
    last = history.time[-1]
    flown = np.diff(history.height(np.array([last, last + 2.0])), axis=0)[0]
    assert flown == pytest.approx([2 * outcome.v1 / 0.5, 2 * outcome.v2 / 0.5], rel=1e-9)
    assert history.force(np.array([last + 1.0])).tolist() == [[0.0, 0.0]]
    assert history.state_at(np.array([last + 1.0])).tolist() == [4]


def test_the_states_passed_are_those_of_the_outcome():
    collision = Collision(m1=1.0, m2=2 / math.sqrt(3), k1=1.0, k2=1.0, e1=0.9, e2=0.7)
    outcome = solve(collision, path=True)
    history = history_of(collision, outcome.path)
    states = history.state_at(np.linspace(0, history.time[-1], 2000))
    passed = states[np.append(True, np.diff(states) != 0)]
    assert [f"S{state}" for state in passed] == list(outcome.states)


def test_a_drop_begins_where_the_table_carries_b2():
    _, history = of("kelvin-voigt", ELASTIC, scenario="drop", gravity=9.81)
    length = 0.5 * math.sqrt(2.0 / 1e6)
    assert history.heights[0] == pytest.approx([-3.0 * 9.81 / 3e6 / length] * 2)
    weight = 3.0 * 9.81 / (0.5 * math.sqrt(2.0 * 1e6))
    assert history.forces[0, 1] == pytest.approx(weight, rel=0.05)


def test_without_a_finite_clock_there_is_no_history():
    collision = Collision.from_ratios(0.0, 1.0, 0.9, 0.7)
    assert history_of(collision, solve(collision, path=True).path) is None
