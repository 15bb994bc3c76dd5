"""The limit dt -> 0: the extrapolation, its estimate, and estimates against independent references."""

import math

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contact.mapping import MUJOCO_IMPEDANCE, contacts
from impact_xval.compliant_baselines.contract.solver import Convergence, Settings
from impact_xval.compliant_baselines.engines.convergence import limit_of
from impact_xval.model.collision import Collision
from tests.compliant_baselines.reference import kelvin_voigt

H = 2.0 ** -np.arange(3)

#: Two balls of one mass.
PAIR = (1.0, 1.0)


def sequence(f):
    return np.column_stack([f(H), np.zeros(3)])


def test_a_first_order_error_is_removed():
    limit = limit_of(sequence(lambda h: 0.3 + 0.2 * h), 0.0, 1e-6, PAIR)
    assert limit.velocities == (pytest.approx(0.3, abs=1e-15), 0)
    assert limit.order == pytest.approx(1)
    # three differences that agree may do so by accident: a tenth of the last correction stays doubted
    assert limit.error == pytest.approx(0.1 * 0.2 / 4)


def test_a_second_order_error_is_estimated():
    limit = limit_of(sequence(lambda h: 0.3 + 0.01 * h + 0.2 * h**2), 0.0, 1e-6, PAIR)
    assert abs(limit.velocities[0] - 0.3) == pytest.approx(0.2 / 8)
    assert limit.error == pytest.approx(3 * 0.2 / 8)


def test_the_chance_of_contact_starts_is_estimated():
    # Starts up to a step late: errors h u theta, theta without any law in [0, 1], and u h what `starts` says.
    thetas = np.random.default_rng(1).uniform(0, 1, (4000, 3))

    def honest(starts):
        limits = [limit_of(sequence(lambda h, x=x: 0.5 + 0.05 * h * x), starts, 1e-6, PAIR) for x in thetas]
        return np.mean([abs(limit.velocities[0] - 0.5) <= 3 * limit.error for limit in limits])

    assert honest(0.05 * H[-1]) > 0.99
    assert honest(0.0) < 0.97  # the differences alone miss what the starts tell


def test_a_limit_of_balls_that_part_is_one_of_balls_that_parted():
    # v2 - v1 falls by 0.01 with each halving and is 0.005 beyond the last: the balls have yet to meet there.
    velocities = np.array([[0.4, 0.365], [0.4, 0.375], [0.4, 0.385]])
    velocities[:, 1] += 0.01
    limit = limit_of(velocities, 0.0, 1e-6, (1.0, 3.0))
    mean = 0.4 * 0.25 + 0.405 * 0.75  # momentum is kept
    assert limit.velocities[0] == limit.velocities[1] == pytest.approx(mean)
    assert limit.error == pytest.approx(0.01)  # the differences do not fall
    # B2 would go into the table
    limit = limit_of(np.array([[0.4, 0.012], [0.4, 0.004], [0.4, 0.0]]), 0.0, 1e-6, (1.0, 3.0))
    assert limit.velocities == (0.4, 0)
    assert limit.error == pytest.approx(0.008)  # and would leave it as fast as it was going to
    limit = limit_of(np.array([[0.4, 0.3], [0.4, 0.2], [0.4, 0.15]]), 0.0, 1e-6, (1.0, 3.0))
    assert limit.velocities[1] == pytest.approx(0.1)  # what is inside stays where it is


def test_illegal_convergence_is_refused():
    for kwargs, says in (
        ({"tolerance": 0.0}, r"tolerance = 0.0; legal: greater than 0"),
        ({"tolerance": math.nan}, "tolerance = nan"),
        ({"halvings": -1}, r"halvings = -1; legal: a whole number from 0 to 10"),
    ):
        with pytest.raises(ValueError, match=says):
            Convergence(**kwargs)


# A ball-ball and a ball-table contact that are stiffer, dissipative and elastic contacts; returns of contacts.
CELLS = [
    (ratio, mass, e1, e2)
    for ratio in (0.01, 0.1, 1.0, 10.0)
    for mass, e1, e2 in ((0.5, 1.0, 1.0), (2 / 3**0.5, 0.9, 0.7), (2.0, 0.5, 0.9), (2 / 3**0.5, 0.7, 0.5))
]


def test_estimates_are_honest(engine):
    """Against Kelvin-Voigt, and the step part alone against the engine's own limit: MuJoCo's is regularised."""
    collisions = [Collision(1.0, mass, 1e8, 1e8 * ratio, e1, e2) for ratio, mass, e1, e2 in CELLS]
    outcomes = engine.solve_many(collisions, Settings(convergence=Convergence()))
    impedance = MUJOCO_IMPEDANCE if engine.name == "mujoco" else 0.0
    for c, outcome in zip(collisions, outcomes, strict=True):
        assert outcome.status == "ok", outcome.reason
        one, two = contacts(c)
        pair = (c.m1, c.m2, c.k1, c.k2, one.c, two.c, c.v0)
        asked = kelvin_voigt(*pair, rtol=1e-9)
        own = kelvin_voigt(*pair, rtol=1e-9, impedance=impedance)
        d = outcome.diagnostics
        limit = np.array([d["v1_limit"], d["v2_limit"]])
        assert np.abs(limit - (asked.v1, asked.v2)).max() <= 3 * d["limit_error"] + 1e-8
        step_error = d["limit_error"] - d["regularisation"]
        assert np.abs(limit - (own.v1, own.v2)).max() <= 3 * step_error + 1e-8
        assert d["limit_error"] < 1e-3
        if c.e1 == c.e2 == 1:  # no dashpot, nothing left to chance: what regularisation does is measured
            moved = np.abs(np.subtract((own.v1, own.v2), (asked.v1, asked.v2))).max()
            assert d["regularisation"] == pytest.approx(moved, rel=0.05)
        assert d["finest_step"] <= d["step"]


def test_a_limit_is_that_of_the_same_steps_asked_for_one_by_one_and_changes_no_outcome(engine):
    c = Collision(m1=1.0, m2=1.5, k1=1e8, k2=1e8, e1=0.8, e2=0.6)
    h = 1e-3
    before, last = (engine.solve(c, Settings(step_fraction=fraction)) for fraction in (2 * h, h))
    followed = engine.solve(c, Settings(step_fraction=h, convergence=Convergence()))
    limit = followed.diagnostics
    extrapolated = 2 * last.v1 - before.v1, 2 * last.v2 - before.v2
    assert (limit["v1_limit"], limit["v2_limit"]) == extrapolated
    assert limit["finest_step"] == limit["step"]
    for name in ("v1", "v2", "impulse1", "impulse2", "states", "status"):
        assert getattr(followed, name) == getattr(last, name)
    assert {k: limit[k] for k in last.diagnostics} == dict(last.diagnostics)
    assert "v1_limit" not in last.diagnostics


def test_what_is_not_known_to_the_tolerance_is_unconverged_and_keeps_its_numbers(engine):
    c = Collision(m1=1.0, m2=1.5, k1=1e8, k2=1e7, e1=0.8, e2=0.6)
    settings = Settings(step_fraction=1e-3, convergence=Convergence(tolerance=1e-7, halvings=3))
    (outcome,) = engine.solve_many([c], settings)
    assert outcome.status == "unconverged"
    assert "beyond the tolerance of 1e-07" in outcome.reason
    assert math.isfinite(outcome.v1)
    assert outcome.diagnostics["limit_error"] > 1e-7
    if engine.name == "pybullet":
        assert outcome.diagnostics["finest_step"] == outcome.diagnostics["step"] / 8
    else:  # no step brings what the impedance does, seen at 4h and h alike, below the tolerance: not tried
        assert "regularisation" in outcome.reason
        assert outcome.diagnostics["finest_step"] == outcome.diagnostics["step"]


def test_halving_stops_where_the_tolerance_is_met():
    c = Collision(m1=1.0, m2=0.5, k1=1e8, k2=1e6, e1=0.7, e2=0.5)
    engine = get_solver("pybullet")
    if engine.unavailable():
        pytest.skip("not installed")
    both = (Settings(step_fraction=4e-3, convergence=Convergence(t, 6)) for t in (0.05, 1e-3))
    loose, tight = (engine.solve(c, settings) for settings in both)
    assert loose.diagnostics["finest_step"] == loose.diagnostics["step"]
    assert tight.diagnostics["finest_step"] < tight.diagnostics["step"]
    assert tight.diagnostics["limit_error"] <= 1e-3
