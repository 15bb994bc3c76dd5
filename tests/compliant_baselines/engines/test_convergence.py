"""Engines against the exact Kelvin-Voigt contacts, naive mappings, and what a scenario asks of them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.mapping import (
    Contact,
    damping_ratio,
    restitution,
    textbook_damping_ratio,
)
from impact_xval.model import Collision

# k2/k1, e1, e2: one contact stiffer and the other, elastic and not
CELLS = [(1.0, 0.9, 0.7), (40.0, 0.9, 0.7), (1 / 40, 0.9, 0.7), (100.0, 0.5, 0.5), (0.3, 1.0, 0.6)]
ELASTIC = [(1.0, 1.0, 1.0), (40.0, 1.0, 1.0), (1 / 40, 1.0, 1.0)]
FRACTIONS = np.array([0.01, 0.005, 0.0025, 0.00125])


def collision(ratio, e1, e2, k1=1e8):
    return Collision.two_balls(m1=1.0, m2=2 / 3**0.5, k1=k1, k2=k1 * ratio, e1=e1, e2=e2)


def reference(c, **settings):
    return get_solver("kelvin-voigt").solve(c, Settings(**settings))


def errors(engine, c, fractions=FRACTIONS):
    ref = reference(c)
    outcomes = [engine.solve(c, Settings(step_fraction=float(f))) for f in fractions]
    return np.array([np.hypot(o.v1 - ref.v1, o.v2 - ref.v2) for o in outcomes])


def slope(fractions, error):
    return np.polyfit(np.log(fractions), np.log(error), 1)[0]


@pytest.mark.parametrize("engine", ["mujoco", "pybullet", "drake"], indirect=True)
def test_first_order_convergence_to_kelvin_voigt(engine):
    for cell in CELLS:
        error = errors(engine, collision(*cell))
        assert error[-1] < 0.02, cell
        assert slope(FRACTIONS, error) == pytest.approx(1, abs=0.15 if engine.name == "mujoco" else 0.1), cell


def test_elastic_cells_converge_at_first_order_in_pybullet_and_better_in_mujoco(engine):
    for cell in ELASTIC:
        if engine.name == "pybullet":  # backward Euler dissipates
            assert slope(FRACTIONS, errors(engine, collision(*cell))) == pytest.approx(1, abs=0.15), cell
        else:
            # MuJoCo's semi-implicit Euler is symplectic: without damping its error is soon below that of the
            # impedance. A contact ends somewhere within a step: the error swings inside an envelope of second order.
            assert errors(engine, collision(*cell)).max() < 2e-4, cell
            fractions = np.array([0.04, 0.03, 0.02, 0.015, 0.01, 0.007, 0.005])
            error = errors(engine, collision(*cell), fractions)
            assert np.all(error < 5 * fractions**2 + 1.5e-4), cell


def test_states_and_impulses_are_those_of_kelvin_voigt(engine):
    for cell in [(1.0, 1.0, 1.0), *CELLS[:4]]:
        c = collision(*cell)
        ref, got = reference(c), engine.solve(c, Settings(step_fraction=2e-4))
        # Contacts that end within shortest_state of a period of each other end together.
        assert got.states in (ref.states, tuple(s for s in ref.states if s != "S2")), cell
        assert got.states == ref.states or cell == (40.0, 0.9, 0.7), cell
        impulses = got.impulse1, got.impulse2
        assert impulses == pytest.approx((ref.impulse1, ref.impulse2), rel=3e-3), cell
        balance = c.v0 + got.impulse1 / c.m1, (got.impulse2 - got.impulse1) / c.m2
        assert (got.v1, got.v2) == pytest.approx(balance, abs=1e-12)


@pytest.mark.parametrize("ratio", [0.5, 2.0, 10.0])
def test_drop_follows_kelvin_voigt_with_gravity(engine, ratio):
    # k1 = 1e4 N/m: gravity matters (g/(|v0| omega1) = 0.07)
    c = collision(ratio, 0.9, 0.7, k1=1e4)
    error, weightless = [], reference(c)
    for fraction in FRACTIONS:
        got = engine.solve(c, Settings(scenario="drop", gravity=9.81, step_fraction=float(fraction)))
        ref = reference(c, scenario="drop", gravity=9.81)
        # An engine's last step goes on beyond the end, and gravity with it.
        late = 9.81 * (got.diagnostics["duration"] - ref.diagnostics["duration"])
        error.append(np.hypot(got.v1 + late - ref.v1, got.v2 + late - ref.v2))
        impulses = got.impulse1, got.impulse2
        assert impulses == pytest.approx((ref.impulse1, ref.impulse2), rel=20 * fraction)
    assert slope(FRACTIONS, error) == pytest.approx(1, abs=0.1)
    # gravity is no detail here
    assert error[-1] < 0.3 * np.hypot(ref.v1 - weightless.v1, ref.v2 - weightless.v2)


def test_b2_stays_settled_until_it_is_hit(engine):
    for ratio in (0.01, 1.0, 100.0):
        c = Collision.two_balls(m1=1.0, m2=1.5, k1=1e6, k2=1e6 * ratio, e1=1.0, e2=1.0)
        scene = Scene.of(c, Settings(scenario="drop"))
        scene = replace(scene, heights=(2000 * abs(c.v0) * scene.step, 0.0))
        (run,) = engine.run([scene], max_steps=1000, record_path=True)
        assert run.points is not None
        assert len(run.points) > 900
        assert run.raw.state.tolist() == [0b10]  # carried by the table, every step
        # an elastic B2 out of balance by x would swing at omega2 x for ever
        assert np.abs(run.points[:, 2]).max() < 1e-10 * 9.81 * (c.m2 / c.k2) ** 0.5, ratio
        assert run.heights[1] == pytest.approx(-c.m2 * 9.81 / c.k2, rel=2e-4), ratio


def test_b2_at_rest_on_the_table_is_reported_at_rest(engine):
    c = Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=1e9, e1=0.5, e2=0.5)
    o = engine.solve(c, Settings(scenario="drop"))
    assert o.v2 == 0
    assert abs(o.diagnostics["rest_speed"]) <= 9.81 / (c.k2 / c.m2) ** 0.5
    # B2 is as good as the table, and B1 alone works against the dashpot mapped for the pair's 2/3 kg.
    zeta = damping_ratio(0.5) * (2 / 3) ** 0.5
    assert o.v1 == pytest.approx(restitution(zeta), abs=0.02)
    # what is reported is one momentum balance
    fallen = 9.81 * o.diagnostics["duration"]
    assert o.impulse2 == pytest.approx(c.m1 * (o.v1 + 1 + fallen) + c.m2 * fallen, rel=1e-12)
    assert o.states[-1] == "S4"


def test_balls_that_never_part_end_at_rest(engine):
    c = Collision.two_balls(m1=1.0, m2=1.0, k1=10.0, k2=10.0, e1=0.3, e2=0.3)
    o = engine.solve(c, Settings(scenario="drop"))
    assert (o.v1, o.v2) == (0, 0)
    # between them the contacts carried the balls' weight and took B1's momentum
    weight = (c.m1 + c.m2) * 9.81 * o.diagnostics["duration"]
    assert o.impulse2 == pytest.approx(weight + c.m1, rel=1e-12)


def test_what_the_naive_mapping_of_mujoco_costs():
    soft, hard = (collision(1, 0.9, 0.7, k1=k1) for k1 in (1e4, 1e8))
    engine, naive = get_solver("mujoco"), get_solver("mujoco-naive")
    assert naive.solve(hard).v1 == engine.solve(hard, Settings(mapping="naive")).v1
    exact = reference(hard)
    for fraction in (4e-3, 1e-3):  # no matter of the step
        settings = Settings(step_fraction=fraction)
        calibrated, found = engine.solve(hard, settings), naive.solve(hard, settings)
        assert math.hypot(calibrated.v1 - exact.v1, calibrated.v2 - exact.v2) < 0.005
        assert math.hypot(found.v1 - exact.v1, found.v2 - exact.v2) > 0.3
        assert found.v1 > 0.9
        assert found.v2 < 0.15
    # Theorem 5: the outcome does not depend on the scale of k. Under the default solimp it does.
    for solver, least, most in ((engine, 0, 1e-8), (naive, 0.01, 0.1)):
        assert least <= abs(solver.solve(soft).v1 - solver.solve(hard).v1) <= most


def test_what_the_naive_mapping_of_pybullet_is():
    pytest.importorskip("pybullet")
    for ratio in (1.0, 5.0):
        c = collision(ratio, 0.9, 0.7, k1=1e4)
        zeta1, zeta2 = (textbook_damping_ratio(e) for e in (c.e1, c.e2))
        c1 = 2 * zeta1 * math.sqrt(c.k1 * c.m1 * c.m2 / (c.m1 + c.m2))
        c2 = 2 * zeta2 * math.sqrt(c.k2 * c.m2)
        # both balls carry (k1, c1), the table (k2, c2): stiffness in series, damping added
        series = 1 / (1 / c.k1 + 1 / c.k2)
        both = Contact(c.k1 / 2, 2 * c1, c.m1 * c.m2 / (c.m1 + c.m2)), Contact(series, c1 + c2, c.m2)
        e1, e2 = (contact.restitution for contact in both)
        expected = reference(Collision.two_balls(c.m1, c.m2, c.k1 / 2, series, e1, e2, c.v0))
        errors = []
        for fraction in (1e-3, 5e-4, 2.5e-4):
            o = get_solver("pybullet-naive").solve(c, Settings(step_fraction=fraction))
            errors.append(math.hypot(o.v1 - expected.v1, o.v2 - expected.v2))
        assert errors[-1] < 2e-3
        assert errors[0] / errors[2] == pytest.approx(4, rel=0.2)  # first order in the step
        exact = reference(c)
        assert math.hypot(expected.v1 - exact.v1, expected.v2 - exact.v2) > 0.1
