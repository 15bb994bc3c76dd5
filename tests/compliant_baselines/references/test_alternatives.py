"""Solvers with another mapping, each against what it should be by itself."""

import math

import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contact.mapping import textbook_damping_ratio
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.model import Collision
from tests.compliant_baselines.reference import kelvin_voigt

MU = 2 / math.sqrt(3)


def available(name):
    solver = get_solver(name)
    if solver.unavailable():
        pytest.skip("not installed")
    return solver


def cell(k=1e8, ratio=1.0):
    return Collision(1.0, MU, k, ratio * k, 0.9, 0.7, -1.0)


def test_what_the_naive_mapping_of_mujoco_costs():
    engine, naive = available("mujoco"), available("mujoco-naive")
    exact = get_solver("kelvin-voigt").solve(cell())
    assert naive.solve(cell()).v1 == engine.solve(cell(), Settings(mapping="naive")).v1
    for fraction in (4e-3, 1e-3):  # no matter of the step
        settings = Settings(step_fraction=fraction)
        calibrated, found = engine.solve(cell(), settings), naive.solve(cell(), settings)
        assert math.hypot(calibrated.v1 - exact.v1, calibrated.v2 - exact.v2) < 0.005
        assert math.hypot(found.v1 - exact.v1, found.v2 - exact.v2) > 0.3
        assert found.v1 > 0.9
        assert found.v2 < 0.15
    # Theorem 5: the outcome does not depend on the scale of k. Under the default solimp it does.
    for solver, least, most in ((engine, 0, 1e-8), (naive, 0.01, 0.1)):
        soft, hard = solver.solve(cell(1e4)), solver.solve(cell(1e8))
        assert least <= abs(soft.v1 - hard.v1) <= most


def test_what_the_naive_mapping_of_pybullet_is():
    naive = available("pybullet-naive")
    for ratio in (1.0, 5.0):
        c = cell(1e4, ratio)
        zeta1, zeta2 = (textbook_damping_ratio(e) for e in (c.e1, c.e2))
        c1 = 2 * zeta1 * math.sqrt(c.k1 * c.m1 * c.m2 / (c.m1 + c.m2))
        c2 = 2 * zeta2 * math.sqrt(c.k2 * c.m2)
        # both balls carry (k1, c1), the table (k2, c2): stiffness in series, damping added
        series = 1 / (1 / c.k1 + 1 / c.k2)
        expected = kelvin_voigt(c.m1, c.m2, c.k1 / 2, series, 2 * c1, c1 + c2, c.v0)
        errors = []
        for fraction in (1e-3, 5e-4, 2.5e-4):
            o = naive.solve(c, Settings(step_fraction=fraction))
            errors.append(math.hypot(o.v1 - expected.v1, o.v2 - expected.v2))
        assert errors[-1] < 2e-3
        assert errors[0] / errors[2] == pytest.approx(4, rel=0.2)  # first order in the step
        exact = get_solver("kelvin-voigt").solve(c)
        assert math.hypot(expected.v1 - exact.v1, expected.v2 - exact.v2) > 0.1
