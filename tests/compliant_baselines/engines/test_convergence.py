"""Compliant engines compared with the exact solution for Kelvin-Voigt contacts, for pairs and chains.

The tests also check naive mappings, and what a drop needs: a lower ball that stays settled and is reported at rest.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.mapping import (
    KelvinVoigtContact,
    damping_ratio,
    restitution,
    textbook_damping_ratio,
)
from impact_xval.compliant_baselines.solver import Convergence
from impact_xval.model import Collision
from tests.compliant_baselines.reference_cells import two_balls

MU = 2 / 3**0.5
# k2/k1, e1, e2: equal stiffnesses or one stiffer contact, with or without losses
CELLS = [(1.0, 0.9, 0.7), (40.0, 0.9, 0.7), (1 / 40, 0.9, 0.7), (100.0, 0.5, 0.5), (0.3, 1.0, 0.6)]
FRACTIONS = np.array([0.01, 0.005, 0.0025, 0.00125])


def reference(c, **settings):
    return get_solver("kelvin-voigt").solve(c, Settings(**settings))


def errors(engine, c, fractions):
    ref = reference(c)
    outcomes = [engine.solve(c, Settings(step_fraction=float(f))) for f in fractions]
    return np.array([np.hypot(o.v1 - ref.v1, o.v2 - ref.v2) for o in outcomes])


def slope(fractions, error):
    return np.polyfit(np.log(fractions), np.log(error), 1)[0]


@pytest.mark.parametrize("engine", ["mujoco", "pybullet", "drake"], indirect=True)
def test_first_order_convergence_to_kelvin_voigt(engine):
    for ratio, *cell in CELLS:
        error = errors(engine, two_balls(ratio, MU, *cell), FRACTIONS)
        assert error[-1] < 0.02, cell
        assert slope(FRACTIONS, error) == pytest.approx(1, abs=0.15 if engine.name == "mujoco" else 0.1), cell


def test_elastic_cells_converge_at_second_order_in_mujoco():
    # MuJoCo's semi-implicit Euler is symplectic. Without damping its error soon falls below the error of the impedance.
    # The end of a contact can fall anywhere within a step. Therefore the error varies, below a bound of second order
    # in the step.
    fractions = np.array([0.04, 0.03, 0.02, 0.015, 0.01, 0.007, 0.005])
    for ratio in (1.0, 40.0, 1 / 40):
        c, engine = two_balls(ratio, MU, 1.0, 1.0), get_solver("mujoco")
        assert errors(engine, c, FRACTIONS).max() < 2e-4, ratio
        assert np.all(errors(engine, c, fractions) < 5 * fractions**2 + 1.5e-4), ratio


@pytest.mark.parametrize("ratio", [0.5, 2.0, 10.0])
def test_drop_follows_kelvin_voigt_with_gravity(engine, ratio):
    # with k1 = 1e4 N/m gravity matters: g/(|v0| omega1) = 0.07
    c = two_balls(ratio, MU, 0.9, 0.7, k1=1e4)
    error = []
    for fraction in FRACTIONS:
        got = engine.solve(c, Settings(scenario="drop", gravity=9.81, step_fraction=float(fraction)))
        ref = reference(c, scenario="drop", gravity=9.81)
        # An engine's last step goes on after the end of the collision, and gravity acts during the rest of this step.
        late = 9.81 * (got.diagnostics["duration"] - ref.diagnostics["duration"])
        error.append(np.hypot(got.v1 + late - ref.v1, got.v2 + late - ref.v2))
    assert slope(FRACTIONS, error) == pytest.approx(1, abs=0.1)


def test_b2_stays_settled_until_it_is_hit(engine):
    for ratio in (0.01, 1.0, 100.0):
        c = Collision.two_balls(m1=1.0, m2=1.5, k1=1e6, k2=1e6 * ratio, e1=1.0, e2=1.0)
        scene = Scene.of(c, Settings(scenario="drop"))
        scene = replace(scene, heights=(2000 * abs(c.v0) * scene.step, 0.0))
        (run,) = engine.run([scene], max_steps=1000, record_path=True)
        assert len(run.points) > 900
        assert run.raw_states.state.tolist() == [0b10]  # at every step the table alone carries B2
        # an elastic B2 at a distance x from its equilibrium depth would swing for ever, with the speed omega2 x
        assert np.abs(run.points[:, 2]).max() < 1e-10 * 9.81 * (c.m2 / c.k2) ** 0.5, ratio
        assert run.heights[1] == pytest.approx(-c.m2 * 9.81 / c.k2, rel=2e-4), ratio


def test_b2_at_rest_on_the_table_is_reported_at_rest(engine):
    c = Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=1e9, e1=0.5, e2=0.5)
    o = engine.solve(c, Settings(scenario="drop"))
    assert o.v2 == 0
    assert abs(o.diagnostics["rest_speed"]) <= 9.81 / (c.k2 / c.m2) ** 0.5
    # B2 is nearly a part of the table. B1 then acts on the dashpot that was made for the pair's reduced mass of 2/3 kg.
    zeta = damping_ratio(0.5) * (2 / 3) ** 0.5
    assert o.v1 == pytest.approx(restitution(zeta), abs=0.02)
    # velocities and impulses satisfy one momentum balance
    fallen = 9.81 * o.diagnostics["duration"]
    assert o.impulse2 == pytest.approx(c.m1 * (o.v1 + 1 + fallen) + c.m2 * fallen, rel=1e-12)


def test_balls_that_never_part_end_at_rest(engine):
    c = Collision.two_balls(m1=1.0, m2=1.0, k1=10.0, k2=10.0, e1=0.3, e2=0.3)
    o = engine.solve(c, Settings(scenario="drop"))
    assert (o.v1, o.v2) == (0, 0)
    # the contacts carried the balls' weight and took B1's momentum
    weight = (c.m1 + c.m2) * 9.81 * o.diagnostics["duration"]
    assert o.impulse2 == pytest.approx(weight + c.m1, rel=1e-12)


def test_what_the_naive_mapping_of_pybullet_is():
    pytest.importorskip("pybullet")
    for ratio in (1.0, 5.0):
        c = two_balls(ratio, MU, 0.9, 0.7, k1=1e4)
        zeta1, zeta2 = (textbook_damping_ratio(e) for e in (c.e1, c.e2))
        c1 = 2 * zeta1 * math.sqrt(c.k1 * c.m1 * c.m2 / (c.m1 + c.m2))
        c2 = 2 * zeta2 * math.sqrt(c.k2 * c.m2)
        # Both balls have (k1, c1) and the table has (k2, c2). PyBullet puts two stiffnesses in series and adds the
        # dampings.
        series = 1 / (1 / c.k1 + 1 / c.k2)
        both = (
            KelvinVoigtContact(c.k1 / 2, 2 * c1, c.m1 * c.m2 / (c.m1 + c.m2)),
            KelvinVoigtContact(series, c1 + c2, c.m2),
        )
        e1, e2 = (contact.restitution for contact in both)
        expected = reference(Collision.two_balls(c.m1, c.m2, c.k1 / 2, series, e1, e2, c.v0))
        errors = []
        for fraction in (1e-3, 5e-4, 2.5e-4):
            o = get_solver("pybullet-naive").solve(c, Settings(step_fraction=fraction))
            errors.append(math.hypot(o.v1 - expected.v1, o.v2 - expected.v2))
        assert errors[-1] < 2e-3
        assert errors[0] / errors[2] == pytest.approx(4, rel=0.2)  # the error is of first order in the step


CHAIN = Collision((1, 1, 1), (1, 1), (1, 0.9), (-1, 0, 0))
FOUR = Collision((1, 2, 1, 0.5), (1e4, 3e4, 1e4), (0.9, 0.8, 0.95), (-1, 0, 0, 0))
DROP = Collision(
    FOUR.masses, (*FOUR.stiffnesses, 2e4), (*FOUR.restitutions, 0.7), FOUR.velocities, table=True
)
SETTINGS = Settings(step_fraction=4e-3, convergence=Convergence())


def limits(outcome):
    return [outcome.diagnostics[f"v{i}_limit"] for i in range(1, len(outcome.velocities) + 1)]


@pytest.mark.parametrize("chain", [CHAIN, FOUR, DROP], ids=["three", "four", "drop"])
@pytest.mark.parametrize("engine", ["mujoco", "pybullet", "drake"], indirect=True)
def test_a_chain_has_the_limit_of_kelvin_voigt(engine, chain):
    exact = get_solver("kelvin-voigt").solve(chain)
    outcome = engine.solve(chain, Settings(convergence=Convergence()))
    off = np.abs(np.subtract(limits(outcome), exact.velocities)).max()
    assert off < outcome.diagnostics["limit_error"] < 1e-3
    assert off < 2e-4
    assert engine.name != "drake" or outcome.diagnostics["order"] == pytest.approx(1, abs=0.05)
    assert outcome.states == exact.states
    lost = np.dot(chain.masses, np.subtract(outcome.velocities, chain.velocities))
    assert lost == pytest.approx(outcome.impulses[-1] if chain.table else 0, abs=1e-12)


def test_gaps_and_speeds_beyond_a_hundred(engine):
    """Balls with gaps between them meet one after the other, at speeds up to 500 m/s.

    By default PyBullet limits the speed of its multibodies to 100 m/s.
    """
    chain = Collision((1, 1, 1), (1e4, 1e4), (1, 0.8), (-500, 0, 0), gaps=(0, 40.0))
    exact = get_solver("kelvin-voigt").solve(chain)
    outcome = engine.solve(chain, SETTINGS)
    assert exact.velocities == pytest.approx([0, -50, -450], abs=1e-9)
    assert outcome.states == exact.states == ("1", "-", "2", "-")
    assert limits(outcome) == pytest.approx(exact.velocities, abs=3 * outcome.diagnostics["limit_error"])


def test_a_path_ends_with_the_outcome_and_its_forces_are_those_of_kelvin_voigt(engine):
    chain = replace(CHAIN, restitutions=(0.8, 0.9))
    exact = get_solver("kelvin-voigt").solve(chain, Settings(record_path=True)).path
    errors = []
    for fraction in (4e-3, 2e-3, 1e-3):
        outcome = engine.solve(chain, Settings(step_fraction=fraction, record_path=True))
        path, step = outcome.path, outcome.diagnostics["step"]
        assert path.velocities[-1] == pytest.approx(outcome.velocities, abs=0)
        assert path.active[0].all()
        # A path has two samples at each time at which the set of active contacts changes. One of the two is left out.
        once = np.append(True, np.diff(path.time) > 0)
        time, forces = path.time[once], path.forces[once]
        assert len(time) == outcome.diagnostics["n_steps"] + 1
        assert np.diff(time) @ forces[1:] == pytest.approx(outcome.impulses, rel=1e-12)
        # A force of the path is a mean over a step, so it is compared with the force in the middle of the step. The
        # reference has a few points per segment. Between them its force is the slope of the cubic through impulses and
        # forces.
        middle = 0.5 * (time[1:] + time[:-1])
        theirs = CubicHermiteSpline(exact.time, exact.impulses, exact.forces).derivative()(middle)
        # In MuJoCo's first step there are no contacts yet, because balls that only just touch have no depth.
        off = np.abs(forces[2:] - theirs[1:])
        assert off.max() < 1.5 * step
        # The largest errors are left out. They come from the last step of a contact, within which the contact opens at
        # a random place.
        errors.append(np.quantile(off, 0.95))
    assert slope([4, 2, 1], errors) == pytest.approx(1, abs=0.05)
