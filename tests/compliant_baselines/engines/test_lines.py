"""Engines for N balls: the limit dt -> 0 against Kelvin-Voigt, states, and paths."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.compliant_baselines.solver import Convergence
from impact_xval.model import Collision
from tests.model.test_columns import random_column

CHAIN = Collision((1, 1, 1), (1, 1), (1, 0.9), (-1, 0, 0))
FOUR = Collision((1, 2, 1, 0.5), (1e4, 3e4, 1e4), (0.9, 0.8, 0.95), (-1, 0, 0, 0))
DROP = Collision(
    FOUR.masses, (*FOUR.stiffnesses, 2e4), (*FOUR.restitutions, 0.7), FOUR.velocities, table=True
)
SETTINGS = Settings(step_fraction=4e-3, convergence=Convergence())


def limits(outcome):
    return [outcome.diagnostics[f"v{i}_limit"] for i in range(1, len(outcome.velocities) + 1)]


@pytest.mark.parametrize("column", [CHAIN, FOUR, DROP], ids=["three", "four", "drop"])
@pytest.mark.parametrize("engine", ["mujoco", "pybullet", "drake"], indirect=True)
def test_a_column_has_the_limit_of_kelvin_voigt(engine, column):
    exact = get_solver("kelvin-voigt").solve(column)
    outcome = engine.solve(column, Settings(convergence=Convergence()))
    off = np.abs(np.subtract(limits(outcome), exact.velocities)).max()
    assert off < outcome.diagnostics["limit_error"] < 1e-3
    assert off < 2e-4
    assert engine.name != "drake" or outcome.diagnostics["order"] == pytest.approx(1, abs=0.05)
    assert outcome.states == exact.states
    lost = np.dot(column.masses, np.subtract(outcome.velocities, column.velocities))
    assert lost == pytest.approx(outcome.impulses[-1] if column.table else 0, abs=1e-12)


def test_a_column_alone_is_the_column_among_others(engine):
    columns = [CHAIN, Collision((1, 2), (1,), (0.5,), (-1, 0)), CHAIN.reversed()]
    for column, among in zip(columns, engine.solve_many(columns, Settings()), strict=True):
        assert engine.solve(column).velocities == among.velocities


def test_gaps_and_speeds_beyond_a_hundred(engine):
    """Balls that are apart meet one after the other; PyBullet's multibodies are capped at 100 m/s by default."""
    column = Collision((1, 1, 1), (1e4, 1e4), (1, 0.8), (-500, 0, 0), gaps=(0, 40.0))
    exact = get_solver("kelvin-voigt").solve(column)
    outcome = engine.solve(column, SETTINGS)
    assert exact.velocities == pytest.approx([0, -50, -450], abs=1e-9)
    assert outcome.states == exact.states == ("1", "-", "2", "-")
    assert limits(outcome) == pytest.approx(exact.velocities, abs=3 * outcome.diagnostics["limit_error"])


@pytest.mark.slow
def test_random_columns_have_the_limit_of_kelvin_voigt(engine):
    rng = np.random.default_rng(22)
    columns = [random_column(rng, balls, least=0.6) for balls in (3, 4, 5, 6)]
    settings = Settings(convergence=Convergence())
    exact = get_solver("kelvin-voigt").solve_many(columns, settings)
    for ours, theirs in zip(engine.solve_many(columns, settings), exact, strict=True):
        assert ours.status == "ok", ours.reason
        off = np.abs(np.subtract(limits(ours), theirs.velocities)).max()
        assert off < 2e-3
        assert off < 3 * ours.diagnostics["limit_error"]


def test_a_path_ends_with_the_outcome_and_its_forces_are_those_of_kelvin_voigt(engine):
    column = replace(CHAIN, restitutions=(0.8, 0.9))
    exact = get_solver("kelvin-voigt").solve(column, Settings(record_path=True)).path
    errors = []
    for fraction in (4e-3, 2e-3, 1e-3):
        outcome = engine.solve(column, Settings(step_fraction=fraction, record_path=True))
        path, step = outcome.path, outcome.diagnostics["step"]
        assert path.velocities[-1] == pytest.approx(outcome.velocities, abs=0)
        assert path.impulses[-1] == pytest.approx(outcome.impulses, rel=1e-14)
        assert path.acting[0].all()
        once = np.append(True, np.diff(path.time) > 0)  # a border between states is given twice
        time, forces = path.time[once], path.forces[once]
        assert len(time) == outcome.diagnostics["n_steps"] + 1
        assert np.diff(time) @ forces[1:] == pytest.approx(outcome.impulses, rel=1e-12)
        # Means, so that they are those of the middle of a step. The reference has a few points a segment: its
        # velocities between them are those of the cubic through velocities and forces.
        middle = 0.5 * (time[1:] + time[:-1])
        theirs = np.column_stack([between(exact, i, middle) for i in range(2)])
        # In the first step MuJoCo has no contacts yet: balls that only just touch have no depth.
        off = np.abs(forces[2:] - theirs[1:])
        assert off.max() < 1.5 * step
        # When in its last step a contact opens is chance, and no matter of order.
        errors.append(np.quantile(off, 0.95))
    order = np.polyfit(np.log2([4, 2, 1]), np.log2(errors), 1)[0]
    assert order == pytest.approx(1, abs=0.05)


def between(path, contact, time):
    """Force of a contact between the points of a path, from the cubics through its impulses and forces."""
    impulses, forces = path.impulses[:, contact], path.forces[:, contact]
    return CubicHermiteSpline(path.time, impulses, forces).derivative()(time)
