"""Drake for N balls: two balls, the limits of its two laws, which geometries meet, flights, and what is refused."""

import importlib.util
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from impact_xval.compliant_baselines import Settings, SolverError, get_solver
from impact_xval.compliant_baselines.contact.line import line_of
from impact_xval.compliant_baselines.contract.solver import Convergence
from impact_xval.compliant_baselines.engines import drake_lines
from impact_xval.compliant_baselines.engines.drake_setup import plant_at, silent
from impact_xval.model import Collision, Column

pytestmark = pytest.mark.skipif(importlib.util.find_spec("pydrake") is None, reason="Drake is not installed")

CHAIN = Column((1, 2, 1, 0.5), (1e4, 3e4, 1e4), (0.9, 0.8, 0.95), (-1, 0, 0, 0))
DROP = replace(
    CHAIN, stiffnesses=(1e4, 3e4, 1e4, 2e4), restitutions=(0.9, 0.8, 0.95, 0.7), gaps=(), table=True
)
LAWS = {"drake": "kelvin-voigt", "drake-hunt-crossley": "hunt-crossley"}


def limits(outcome):
    return [outcome.diagnostics[f"v{i}_limit"] for i in range(1, len(outcome.velocities) + 1)]


@pytest.mark.parametrize("name", LAWS)
def test_two_balls_on_a_table_are_those_of_the_two_ball_adapter(name):
    solver, settings = get_solver(name), Settings(step_fraction=5e-3, mark=False)
    for k2, m2, e1, e2 in ((1, 2, 0.9, 0.7), (40, 0.5, 1, 0.8), (0.05, 1.2, 0.6, 1)):
        one = solver.solve(Collision(1, m2, 1e4, k2 * 1e4, e1, e2, -3), settings)
        column = Column((1, m2), (1e4, k2 * 1e4), (e1, e2), (-3, 0), table=True)
        other = solver.solve_column(column, settings)
        # To rounding, 1e-13 here: the engine's solver stops at the same iteration, since its problem is the same.
        assert other.velocities == pytest.approx((one.v1, one.v2), abs=1e-9)
        assert other.impulses == pytest.approx((one.impulse1, one.impulse2), abs=1e-9)
        assert other.diagnostics["n_steps"] == one.diagnostics["n_steps"]


@pytest.mark.parametrize("column", [CHAIN, DROP], ids=["chain", "drop"])
def test_four_balls_have_the_limit_of_kelvin_voigt(column):
    exact = get_solver("kelvin-voigt").solve_column(column)
    outcome = get_solver("drake").solve_column(column, Settings(convergence=Convergence()))
    off = np.abs(np.subtract(limits(outcome), exact.velocities)).max()
    assert off < outcome.diagnostics["limit_error"] < 1e-3
    assert off < 2e-4
    assert outcome.diagnostics["order"] == pytest.approx(1, abs=0.05)
    assert outcome.states == exact.states
    lost = np.dot(column.masses, np.subtract(outcome.velocities, column.velocities))
    assert lost == pytest.approx(outcome.impulses[3] if column.table else 0, abs=1e-12)


def test_four_balls_in_discrete_time_are_those_of_pybullet():
    bullet = get_solver("pybullet")
    if bullet.unavailable():
        pytest.skip("PyBullet is not installed")
    ours, theirs = (s.solve_column(CHAIN, Settings(record_path=True)) for s in (get_solver("drake"), bullet))
    # Both are backward Euler; Drake's solver stops at a relative tolerance of 1e-6.
    assert ours.velocities == pytest.approx(theirs.velocities, abs=5e-6)
    peak = theirs.path.forces.max()
    n = min(len(ours.path.time), len(theirs.path.time))
    assert ours.path.forces[:n] == pytest.approx(theirs.path.forces[:n], abs=1e-3 * peak)
    assert ours.path.impulses[-1] == pytest.approx(ours.impulses, rel=1e-14)


@pytest.mark.parametrize("velocities", [(-1, 0, 0, 0), (-1, 0, -3, 0)])
@pytest.mark.parametrize("column", [CHAIN, DROP], ids=["chain", "drop"])
def test_four_balls_in_continuous_time_are_those_of_hunt_crossley(column, velocities):
    """The coefficient goes with the largest rate of compression at first touch, here 1 and 3 m/s."""
    column = replace(column, velocities=velocities)
    exact = get_solver("hunt-crossley").solve_column(column)
    outcome = get_solver("drake-hunt-crossley").solve_column(column, Settings(step_fraction=5e-3))
    assert outcome.velocities == pytest.approx(exact.velocities, abs=2e-9 * max(np.abs(velocities)))
    dashpots = get_solver("kelvin-voigt").solve_column(column)
    assert np.abs(np.subtract(outcome.velocities, dashpots.velocities)).max() > 1e-3


@pytest.mark.parametrize("column", [CHAIN, DROP], ids=["chain", "drop"])
def test_only_the_sides_of_neighbours_meet(column):
    line = line_of(column, Settings())
    with silent():
        _, plant, graph = plant_at(line.step)
        drake_lines.add_bodies(plant, graph, line, 1.0, discrete=True)
        inspector = graph.model_inspector()
        pairs = {
            tuple(sorted(inspector.GetName(one).split("::")[-1] for one in pair))
            for pair in inspector.GetCollisionCandidates()
        }
    balls = [f"B{i}" for i in range(1, 5)]
    expected = {(f"{upper}-0", f"{lower}-1") for upper, lower in pairwise(balls)}
    assert pairs == expected | ({("B4-0", "table")} if column.table else set())


def test_wrong_pairs_would_change_the_answer(monkeypatch):
    """Without filters both sides of each ball meet both of the next, the rigid ones among them."""
    from pydrake.geometry import CollisionFilterManager

    settings = Settings(step_fraction=5e-3)
    right = get_solver("drake").solve_column(CHAIN, settings)
    monkeypatch.setattr(CollisionFilterManager, "Apply", lambda self, declaration: None)
    wrong = get_solver("drake").solve_columns([CHAIN], settings)[0]
    assert wrong.status != "ok" or np.abs(np.subtract(wrong.velocities, right.velocities)).max() > 0.05


@pytest.mark.parametrize("name", LAWS)
def test_a_flight_that_is_skipped_is_as_one_that_is_stepped(name, monkeypatch):
    column = Column((1, 1, 1), (1e4, 1e4), (1, 0.8), (-500, 0, 0), gaps=(0, 40.0))
    settings = Settings(step_fraction=5e-3, record_path=True)
    solver, exact = get_solver(name), get_solver(LAWS[name]).solve_column(column)
    skipped = solver.solve_column(column, settings)
    assert skipped.states == exact.states == ((1,), (), (2,), ())
    monkeypatch.setattr(drake_lines, "LEAST_FLIGHT", math.inf)
    stepped = solver.solve_column(column, settings)
    assert skipped.velocities == pytest.approx(stepped.velocities, abs=500e-9)
    assert skipped.diagnostics["n_steps"] == stepped.diagnostics["n_steps"]
    assert skipped.path.impulses[-1] == pytest.approx(skipped.impulses, rel=1e-12)
    assert np.diff(skipped.path.time).max() > 0.05


def test_a_step_too_short_is_refused_and_not_run():
    settings = Settings(step_fraction=1e-6)
    with pytest.raises(SolverError, match=r"impulses below 1e-06 of the momentum, .* is needed"):
        get_solver("drake").solve_column(CHAIN, settings)
    line = line_of(CHAIN, settings)
    (run,) = get_solver("drake").run_lines([line], 100)
    assert (run.status, run.raw.n_steps) == ("crashed", 0)
    assert "impulses below 1e-06 of the momentum" in run.problem()
    assert get_solver("drake-hunt-crossley").line_refusal(line) is None


def test_contacts_of_a_column_that_drifts_start_late_by_the_phase_that_is_refused(monkeypatch):
    """Impulses are neglected beside the momentum of all bodies, not of those that meet."""
    column = Column((1, 1), (1e4,), (1,), (-1001, -1000))
    line = line_of(column, Settings())
    assert "impulses below 1e-06" in get_solver("drake").line_refusal(line)
    assert get_solver("drake").line_refusal(replace(line, velocities=(-1.0, 0.0))) is None
    total, omega = math.hypot(1001, 1000), math.sqrt(2e4)
    late = 1e-6 * total / (omega * line.step * math.sqrt(0.5))
    monkeypatch.setattr(drake_lines, "shortest_of_line", lambda line: None)
    run = get_solver("drake").run_lines([line], 10_000)[0]
    first = run.raw.start[run.raw.state == 1][0]
    assert first * line.step * omega == pytest.approx(late, rel=0.1)


@pytest.mark.parametrize("name", LAWS)
def test_the_naive_mapping_is_that_of_two_balls(name):
    with pytest.raises(SolverError, match=r"mapping = 'naive': Drake's is that of two balls"):
        get_solver(name).solve_column(CHAIN, Settings(mapping="naive"))


def test_what_drake_raises_becomes_a_status(monkeypatch):
    from pydrake.systems.analysis import Simulator

    def broken(self, until):
        raise RuntimeError("SAP did not\nconverge")

    monkeypatch.setattr(Simulator, "AdvanceTo", broken)
    outcome = get_solver("drake").solve_columns([CHAIN], Settings())[0]
    assert (outcome.status, "Drake: SAP did not converge" in outcome.reason) == ("crashed", True)
