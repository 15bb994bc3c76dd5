"""Drake: as Kelvin-Voigt engine in discrete time, as elastic and Hunt-Crossley oracle in continuous time."""

import importlib.util
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from impact_xval.compliant_baselines import Settings, SolverError, get_solver
from impact_xval.compliant_baselines.calibration.calibration import ContactRequest, calibrate
from impact_xval.compliant_baselines.contact.mapping import Contact, DrakeGeometry, drake_geometries
from impact_xval.model.collision import Collision

needs_drake = pytest.mark.skipif(importlib.util.find_spec("pydrake") is None, reason="Drake is not installed")
MU = 2 / 3**0.5
ELASTIC = [1.0, 40.0, 1 / 40]
CELLS = [(1.0, 0.9, 0.7), (40.0, 0.9, 0.7), (1 / 40, 0.9, 0.7)]


def collision(ratio, e1=1.0, e2=1.0, k1=1e6, **other):
    return Collision(**({"m1": 1.0, "m2": MU, "k1": k1, "k2": k1 * ratio, "e1": e1, "e2": e2} | other))


def gap(a, b, v0=-1.0):
    return math.hypot(a.v1 - b.v1, a.v2 - b.v2) / abs(v0)


# Discrete time


@needs_drake
@pytest.mark.parametrize("cell", CELLS, ids=str)
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
@pytest.mark.parametrize(("what", "factor"), [("k", 1e-6), ("k", 1e4), ("m", 1e-3), ("m", 1e4), ("v", 1e-3)])
def test_theorem_5_when_the_step_scales_along(what, factor):
    scale = {"k": 1.0, "m": 1.0, "v": 1.0, what: factor}
    c = collision(3.0, 0.7, 0.9, k1=1e6 * scale["k"], m1=scale["m"], m2=MU * scale["m"], v0=-scale["v"])
    settings = Settings(step_fraction=5e-3)
    base, other = (get_solver("drake").solve(x, settings) for x in (collision(3.0, 0.7, 0.9), c))
    assert other.v1 / scale["v"] == pytest.approx(base.v1, abs=1e-5)
    assert other.v2 / scale["v"] == pytest.approx(base.v2, abs=1e-5)


@needs_drake
@pytest.mark.parametrize("contact", ["ball-table", "ball-ball"])
def test_single_contacts_come_back_as_asked(contact):
    requests = [ContactRequest(contact, e, k=1e5, m1=3.0, m2=0.2, step_fraction=2e-3) for e in (0.5, 1.0)]
    requests += [ContactRequest(contact, e, k=1e5, m1=3.0, m2=0.2, step_fraction=1e-3) for e in (0.5, 1.0)]
    coarse, fine = np.split(np.array([r.restitution for r in calibrate(get_solver("drake"), requests)]), 2)
    assert 2 * fine - coarse == pytest.approx([0.5, 1.0], abs=1e-3)  # extrapolated: first order
    assert abs(fine - coarse) == pytest.approx(abs(fine - [0.5, 1.0]), rel=0.1)


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
    outcome = get_solver("drake").solve_many([collision(1.0)], Settings())[0]
    assert (outcome.status, "Drake: SAP did not converge" in outcome.reason) == ("crashed", True)


@needs_drake
@pytest.mark.parametrize(("fraction", "felt"), [(1e-5, 1.0), (1e-7, 0.0)])
def test_a_step_too_short_switches_a_contact_off(fraction, felt):
    # Half way into an elastic contact, at full speed: the force is k delta, or nothing at all.
    column = ContactRequest("ball-table", 1.0, k=1e6).column()
    omega = column.contact2.omega
    column = replace(column, step=fraction * column.contact2.period, x1=1.0, v1=0.0, x2=-0.5 / omega, v2=-1.0)
    from impact_xval.compliant_baselines.engines.drake_engine import run, silent

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
@pytest.mark.parametrize("ratio", ELASTIC)
def test_continuous_drake_reproduces_the_elastic_reference(ratio):
    exact = get_solver("kelvin-voigt").solve(collision(ratio))
    drake = get_solver("drake-hunt-crossley").solve(collision(ratio), Settings(step_fraction=0.01))
    assert gap(drake, exact) < 2e-9


@needs_drake
@pytest.mark.parametrize("cell", CELLS, ids=str)
def test_continuous_drake_reproduces_hunt_crossley_contacts(cell):
    exact = get_solver("hunt-crossley").solve(collision(*cell))
    drake = get_solver("drake-hunt-crossley").solve(collision(*cell), Settings(step_fraction=0.01))
    assert gap(drake, exact) < 2e-9
    assert gap(exact, get_solver("kelvin-voigt").solve(collision(*cell))) > 1e-3  # and it is another law


@needs_drake
@pytest.mark.parametrize(("k1", "v0"), [(1.0, -1.0), (1e-4, -10.0), (1e10, -1e-3)])
def test_the_oracle_is_as_good_at_other_scales(k1, v0):
    c = collision(1.0, 0.9, 0.7, k1=k1, v0=v0)
    exact, drake = (
        get_solver(n).solve(c, Settings(step_fraction=0.01)) for n in ("hunt-crossley", "drake-hunt-crossley")
    )
    assert gap(drake, exact, v0) < 5e-9


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


def test_continuous_drake_has_no_naive_mapping():
    solver = get_solver("drake-hunt-crossley")
    if solver.unavailable():
        pytest.skip("Drake is not installed")
    with pytest.raises(SolverError, match=r"unrepresentable: mapping = 'naive': .* take 'calibrated'"):
        solver.solve(collision(1.0), Settings(mapping="naive"))


# Without Drake


@pytest.mark.parametrize("name", ["drake", "drake-hunt-crossley"])
def test_without_drake_the_way_out_is_said(monkeypatch, name):
    monkeypatch.setitem(sys.modules, "pydrake", None)
    outcome = get_solver(name).solve_many([collision(1.0)], Settings())[0]
    assert outcome.status == "unavailable"
    assert "pip install 'impact-xval[drake]'" in outcome.reason
    with pytest.raises(SolverError, match=rf"{name}: unavailable: Drake is not installed"):
        get_solver(name).solve(collision(1.0))


def test_drake_is_not_imported_for_others():
    code = (
        "import sys, impact_xval.experiments.commands.cli, impact_xval.compliant_baselines as b;"
        "b.get_solver('drake'); b.get_solver('drake-hunt-crossley'); b.get_solver('mujoco').unavailable();"
        "print([m for m in sys.modules if m.startswith('pydrake')])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"
