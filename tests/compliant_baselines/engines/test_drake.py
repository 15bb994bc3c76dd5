"""Drake: as Kelvin-Voigt engine in discrete time, as elastic and Hunt-Crossley oracle in continuous time; N balls."""

import importlib.util
import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from impact_xval.compliant_baselines import Settings, SolverError, get_solver
from impact_xval.compliant_baselines.calibration.pair import Pair, columns
from impact_xval.compliant_baselines.contact.line import line_of
from impact_xval.compliant_baselines.contact.mapping import Contact, DrakeGeometry, drake_geometries
from impact_xval.compliant_baselines.contract.solver import Convergence
from impact_xval.compliant_baselines.engines.drake_setup import silent
from impact_xval.model import Collision, Column

needs_drake = pytest.mark.skipif(importlib.util.find_spec("pydrake") is None, reason="Drake is not installed")
MU = 2 / 3**0.5
ELASTIC = [1.0, 40.0, 1 / 40]
CELLS = [(1.0, 0.9, 0.7), (40.0, 0.9, 0.7), (1 / 40, 0.9, 0.7)]

CHAIN = Column((1, 2, 1, 0.5), (1e4, 3e4, 1e4), (0.9, 0.8, 0.95), (-1, 0, 0, 0))
DROP = replace(
    CHAIN, stiffnesses=(1e4, 3e4, 1e4, 2e4), restitutions=(0.9, 0.8, 0.95, 0.7), gaps=(), table=True
)
LAWS = {"drake": "kelvin-voigt", "drake-hunt-crossley": "hunt-crossley"}


def collision(ratio, e1=1.0, e2=1.0, k1=1e6, **other):
    return Collision(**({"m1": 1.0, "m2": MU, "k1": k1, "k2": k1 * ratio, "e1": e1, "e2": e2} | other))


def gap(a, b, v0=-1.0):
    return math.hypot(a.v1 - b.v1, a.v2 - b.v2) / abs(v0)


# Discrete time


@pytest.mark.parametrize("cell", CELLS, ids=str)
@needs_drake
def test_discrete_drake_converges_to_kelvin_voigt_at_first_order(cell):
    exact = get_solver("kelvin-voigt").solve(collision(*cell))
    fractions = np.array([0.005, 0.0025, 0.00125])
    outcomes = [get_solver("drake").solve(collision(*cell), Settings(step_fraction=f)) for f in fractions]
    errors = [gap(o, exact) for o in outcomes]
    assert errors[-1] < 0.03
    assert np.polyfit(np.log(fractions), np.log(errors), 1)[0] == pytest.approx(1, abs=0.1)


@needs_drake
@pytest.mark.parametrize("scenario", ["impact", "drop"])
def test_discrete_drake_and_pybullet_solve_the_same_equations(scenario):
    bullet = get_solver("pybullet")
    if bullet.unavailable():
        pytest.skip("PyBullet is not installed")
    settings = Settings(scenario=scenario, step_fraction=5e-3)
    apart = []
    for ratio, e1, e2 in [*CELLS, *((r, 1.0, 1.0) for r in ELASTIC)]:
        c = collision(ratio, e1, e2)
        ours, theirs = get_solver("drake").solve(c, settings), bullet.solve(c, settings)
        apart.append(gap(ours, theirs))
    # Eight digits where Drake's solver converges beyond its relative tolerance of 1e-6, that otherwise.
    assert np.median(apart) < 2e-8
    assert max(apart) < 5e-6


@needs_drake
def test_theorem_5_when_the_step_scales_along():
    settings, one = Settings(step_fraction=5e-3), collision(3.0, 0.7, 0.9)
    base = get_solver("drake").solve(one, settings)
    for k, m, v in ((1e-6, 1, 1), (1e4, 1, 1), (1, 1e-3, 1), (1, 1e4, 1), (1, 1, 1e-3)):
        c = collision(3.0, 0.7, 0.9, k1=1e6 * k, m1=1.0 * m, m2=MU * m, v0=-1.0 * v)
        other = get_solver("drake").solve(c, settings)
        assert other.v1 / v == pytest.approx(base.v1, abs=1e-5), c
        assert other.v2 / v == pytest.approx(base.v2, abs=1e-5), c


@needs_drake
def test_one_by_one_and_together_are_the_same_to_the_bit_and_failures_stay_their_own():
    cells = [collision(1.0, 0.9, 0.7), collision(1.0, 0.0, 0.7), collision(3.0, 0.5, 1.0)]
    settings = Settings(step_fraction=0.01)
    solver = get_solver("drake")
    together = solver.solve_many(cells, settings)
    assert [o.status for o in together] == ["ok", "unrepresentable", "ok"]
    assert [solver.solve(cells[i], settings).v1 for i in (0, 2)] == [together[0].v1, together[2].v1]
    late = solver.solve_many(cells[:1], Settings(step_fraction=0.01, max_steps=20))[0]
    assert late.status == "timeout"


@needs_drake
def test_naive_geometries_are_half_as_stiff_and_damped_as_asked():
    one, two = Contact(2.0, 0.3, 1.0), Contact(8.0, 0.4, 1.0)
    upper, lower, _ = drake_geometries(one, two, "naive")
    pair = upper.against(lower)
    assert (pair.stiffness, pair.stiffness * pair.relaxation_time) == (1.0, pytest.approx(0.3))
    upper, lower, table = drake_geometries(one, two)
    assert upper.against(lower) == DrakeGeometry(2.0, 0.15)
    assert lower.against(table) == DrakeGeometry(8.0, 0.05)


@needs_drake
def test_what_drake_raises_becomes_a_status(monkeypatch):
    from pydrake.systems.analysis import Simulator

    def broken(self, until):
        raise RuntimeError("SAP did not\nconverge")

    monkeypatch.setattr(Simulator, "AdvanceTo", broken)
    drake = get_solver("drake")
    of_two, of_many = drake.solve_many([collision(1.0)], Settings()), drake.solve_columns([CHAIN], Settings())
    for outcome in (*of_two, *of_many):
        assert (outcome.status, "Drake: SAP did not converge" in outcome.reason) == ("crashed", True)


@needs_drake
@pytest.mark.parametrize(("fraction", "felt"), [(1e-5, 1.0), (1e-7, 0.0)])
def test_a_step_too_short_switches_a_contact_off(fraction, felt):
    # Half way into an elastic contact, at full speed: the force is k delta, or nothing at all.
    (column,) = columns(Pair((1.0, math.inf), 1.0, stiffness=1e6), 1.0, [0.0])
    omega = column.contact2.omega
    column = replace(column, step=fraction * column.contact2.period, x1=1.0, v1=0.0, x2=-0.5 / omega, v2=-1.0)
    from impact_xval.compliant_baselines.engines.drake_engine import run

    with silent():
        went = run(column, 5, False)
    assert (went.v2 + 1) / (5 * omega * column.step) == pytest.approx(0.5 * felt, abs=1e-3)
    refused = get_solver("drake").refusal(column)
    assert (refused is None) == (felt == 1)
    assert refused is None or "impulses below 1e-06 of the momentum" in refused
    # Who shortens a step without asking is told, too.
    (told,) = get_solver("drake").run_columns([column], max_steps=5)
    assert told.failure == (refused or "")
    assert told.raw.n_steps == (5 if felt else 0)


@needs_drake
def test_nothing_is_said_on_the_terminal(capfd):
    get_solver("drake").solve(collision(1.0), Settings(step_fraction=0.01))
    assert capfd.readouterr() == ("", "")


# Continuous time


@needs_drake
def test_continuous_drake_reproduces_the_exact_reference_of_its_law():
    settings = Settings(step_fraction=0.01)
    dashpots, exact, drake = (get_solver(n) for n in ("kelvin-voigt", "hunt-crossley", "drake-hunt-crossley"))
    for ratio in ELASTIC:
        c = collision(ratio)
        assert gap(drake.solve(c, settings), dashpots.solve(c)) < 2e-9, ratio
    for cell in CELLS:
        c = collision(*cell)
        assert gap(drake.solve(c, settings), exact.solve(c)) < 2e-9, cell
        assert gap(exact.solve(c), dashpots.solve(c)) > 1e-3  # and it is another law
    for k1, v0 in ((1.0, -1.0), (1e-4, -10.0), (1e10, -1e-3)):
        c = collision(1.0, 0.9, 0.7, k1=k1, v0=v0)
        assert gap(drake.solve(c, settings), exact.solve(c), v0) < 5e-9, c


@needs_drake
def test_a_drop_differs_by_what_gravity_does_between_two_samples():
    c = collision(1.0)
    errors = []
    for fraction in (4e-3, 2e-3, 1e-3):
        settings = Settings(scenario="drop", step_fraction=fraction)
        drake, exact = (get_solver(n).solve(c, settings) for n in ("drake-hunt-crossley", "kelvin-voigt"))
        errors.append(gap(drake, exact))
        # A collision is over after the first interval without force: two intervals late at most, both balls.
        assert errors[-1] <= 2**0.5 * 2 * 9.81 * drake.diagnostics["step"]
    assert errors[-1] < errors[0]


@needs_drake
def test_the_naive_mapping_is_that_of_two_balls_in_discrete_time():
    naive = Settings(mapping="naive")
    with pytest.raises(SolverError, match=r"unrepresentable: mapping = 'naive': .* take 'calibrated'"):
        get_solver("drake-hunt-crossley").solve(collision(1.0), naive)
    for name in LAWS:
        with pytest.raises(SolverError, match=r"mapping = 'naive': Drake's is that of two balls"):
            get_solver(name).solve_column(CHAIN, naive)


# N balls


def limits(outcome):
    return [outcome.diagnostics[f"v{i}_limit"] for i in range(1, len(outcome.velocities) + 1)]


@needs_drake
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


@needs_drake
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


@needs_drake
@pytest.mark.parametrize("column", [CHAIN, replace(DROP, velocities=(-1, 0, -3, 0))], ids=["chain", "drop"])
def test_four_balls_in_continuous_time_are_those_of_hunt_crossley(column):
    """The coefficient goes with the largest rate of compression at first touch, here 1 and 3 m/s."""
    exact = get_solver("hunt-crossley").solve_column(column)
    outcome = get_solver("drake-hunt-crossley").solve_column(column, Settings(step_fraction=5e-3))
    assert outcome.velocities == pytest.approx(exact.velocities, abs=2e-9 * max(np.abs(column.velocities)))
    dashpots = get_solver("kelvin-voigt").solve_column(column)
    assert np.abs(np.subtract(outcome.velocities, dashpots.velocities)).max() > 1e-3


@needs_drake
@pytest.mark.parametrize("name", LAWS)
def test_balls_that_are_apart_meet_after_a_flight_that_is_skipped(name):
    column = Column((1, 1, 1), (1e4, 1e4), (1, 0.8), (-500, 0, 0), gaps=(0, 40.0))
    settings = Settings(step_fraction=1e-3, record_path=True)
    solver, exact = get_solver(name), get_solver(LAWS[name]).solve_column(column)
    outcome = solver.solve_column(column, settings)
    assert outcome.states == exact.states == ((1,), (), (2,), ())
    assert outcome.velocities == pytest.approx(exact.velocities, abs=0.03 * 500)
    assert outcome.path.impulses[-1] == pytest.approx(outcome.impulses, rel=1e-12)
    assert np.diff(outcome.path.time).max() > 0.05


@needs_drake
def test_a_step_too_short_is_refused_and_not_run():
    settings = Settings(step_fraction=1e-6)
    with pytest.raises(SolverError, match=r"impulses below 1e-06 of the momentum, .* is needed"):
        get_solver("drake").solve_column(CHAIN, settings)
    line = line_of(CHAIN, settings)
    (run,) = get_solver("drake").run_lines([line], 100)
    assert (run.status, run.raw.n_steps) == ("crashed", 0)
    assert "impulses below 1e-06 of the momentum" in run.problem()
    assert get_solver("drake-hunt-crossley").line_refusal(line) is None
    # impulses are neglected beside the momentum of all bodies, not of those that meet
    drifting = line_of(Column((1, 1), (1e4,), (1,), (-1001, -1000)), Settings())
    assert "impulses below 1e-06" in get_solver("drake").line_refusal(drifting)
    assert get_solver("drake").line_refusal(replace(drifting, velocities=(-1.0, 0.0))) is None


# Without Drake


def test_without_drake_the_way_out_is_said(monkeypatch):
    monkeypatch.setitem(sys.modules, "pydrake", None)
    for name in LAWS:
        outcome = get_solver(name).solve_many([collision(1.0)], Settings())[0]
        assert outcome.status == "unavailable"
        assert "pip install 'impact-xval[drake]'" in outcome.reason
        with pytest.raises(SolverError, match=rf"{name}: unavailable: Drake is not installed"):
            get_solver(name).solve(collision(1.0))
