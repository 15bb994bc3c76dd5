"""The limit of an engine at a time step of zero: its extrapolation and its stated error, compared with references."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import DOP853

from impact_xval.compliant_baselines import get_solver, references
from impact_xval.compliant_baselines.engines.convergence import extrapolate, parting_in_line
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.engines.stepping import project_to_separated
from impact_xval.compliant_baselines.mapping import MUJOCO_IMPEDANCE
from impact_xval.compliant_baselines.marks import find_jumps
from impact_xval.compliant_baselines.rigid.laws import follow_impacts
from impact_xval.compliant_baselines.solver import Convergence, Settings
from impact_xval.model.collision import Collision
from impact_xval.model.collisions import Collisions
from tests.compliant_baselines.reference_cells import random_cells, two_balls

H = 2.0 ** -np.arange(3)

#: Two balls of equal mass.
PAIR = parting_in_line((1.0, 1.0))


def sequence(f, steps=H):
    return np.column_stack([f(steps), 0 * steps])


def test_limits_gain_an_order_where_the_runs_show_it():
    def missed(finest, n, orders):
        steps = finest * 2.0 ** np.arange(n - 1, -1, -1)
        # an error that is a smooth function of the step
        velocities = sequence(lambda h: 0.3 + 0.1 * np.expm1(h), steps)
        return abs(extrapolate(velocities, 0.0, PAIR, orders=orders)[0][0] - 0.3)

    for n, orders, power in ((3, 2, 2), (4, 2, 3), (5, 2, 3), (4, 1, 2)):
        coarse, fine = (missed(h, n, orders) for h in (2e-2, 1e-2))
        assert np.log2(coarse / fine) == pytest.approx(power, abs=0.1)
    # If the changes from step to step have both signs, the velocity is extrapolated at first order. Such changes depend
    # on where within a step the bodies touch.
    velocities = np.array([0.36, 0.334, 0.3145, 0.3067])
    limit, *_ = extrapolate(np.column_stack([velocities, 0 * velocities]), 0.0, PAIR)
    assert limit[0] == 2 * velocities[-1] - velocities[-2]
    # A velocity that did not change at first and changes now is extrapolated at first order, too.
    other = 0.1 + np.array([0.0, 0.0, 0.0, 1e-3])
    limit, *_ = extrapolate(
        np.column_stack([0.3 + 0.2 * np.array([16, 4, 1, 0.25]) * 1e-2, other]), 0.0, PAIR
    )
    assert limit[1] == 2 * other[-1] - other[-2]


def test_the_error_of_a_limit_covers_runs_of_other_states_and_a_doubtful_first_flight():
    for doubt, expected in (
        ({}, 0.1 * 0.2 / 4),
        ({"same_states": False}, 0.2 / 4),
        ({"gravity_doubt": 0.01}, 0.01),
    ):
        _, error, _ = extrapolate(sequence(lambda h: 0.3 + 0.2 * h), 0.0, PAIR, **doubt)
        assert error == pytest.approx(expected), doubt
    second = sequence(lambda h: 0.3 + 0.01 * h + 0.2 * h**2, 2.0 ** -np.arange(4))
    _, error, _ = extrapolate(second, 0.0, PAIR)
    # the error is twice what the last row of the extrapolation table removed
    assert error == pytest.approx(2 * 0.2 / 32)


def test_a_limit_of_balls_that_part_is_one_of_balls_that_parted():
    # v2 - v1 rises by 0.01 with each halving of the step. Extrapolated it is 0.005, so that the balls would approach
    # each other.
    limit, error, _ = extrapolate(
        np.array([[0.4, 0.375], [0.4, 0.385], [0.4, 0.395]]), 0.0, parting_in_line((1.0, 3.0))
    )
    mean = 0.4 * 0.25 + 0.405 * 0.75  # the limit keeps momentum
    assert limit[0] == limit[1] == pytest.approx(mean)
    # the error is the full last difference, because the differences between steps do not fall
    assert error == pytest.approx(0.01)
    # extrapolated, B2 would move into the table
    limit, error, _ = extrapolate(
        np.array([[0.4, 0.012], [0.4, 0.004], [0.4, 0.0]]), 0.0, parting_in_line((1.0, 3.0))
    )
    assert limit == (0.4, 0)
    assert error == pytest.approx(0.004)  # the correction that would let B2 sink is stated as the error


def test_a_rate_that_turns_around_is_not_extrapolated():
    # the speed left by a vibration: the length of a vector that is shortest at a step above zero
    def left(h):
        return np.hypot(1e-3 * (h - 0.1), 1e-4)

    limit, error, _ = extrapolate(sequence(left), 0.0, PAIR)
    assert abs(limit[0] - left(0.0)) < error


def test_a_vibration_that_steps_damp_has_a_limit_within_its_error():
    for x in (0.3, 0.1, 0.02):  # the fraction of the vibration that is left at the shortest step
        limit, error, _ = extrapolate(sequence(lambda h, x=x: 0.3 + 0.01 * x ** (4 * h)), 0.0, PAIR)
        assert 0.5 * error < 0.31 - limit[0] < error


def regularised(collision):
    """Return final velocities of two balls whose contacts are MuJoCo's in continuous time, integrated without events.

    The law is (1 - d) F_i = k_i delta_i + c_i delta_i' - d M_i a_i (the chapter "Computation" of MuJoCo's
    documentation). Here d is the impedance and a_i the acceleration at which contact i separates. With a_1 = F1/M1 -
    F2/m2 and a_2 = (F2 - F1)/m2 this gives F1 = L1 + d (M1/m2) F2 and F2 = L2 + d F1, where L_i is the force for d = 0.
    """
    (one, two), m2 = Scene.of(collision, Settings()).contacts, collision.m2
    passed = MUJOCO_IMPEDANCE * one.mass / m2, MUJOCO_IMPEDANCE

    def forces(x1, x2, v1, v2):
        alone = np.array([one.k * (x2 - x1) + one.c * (v2 - v1), -two.k * x2 - two.c * v2])
        both = (alone + passed * alone[::-1]) / (1 - passed[0] * passed[1])
        met = x1 < x2, x2 < 0
        return both if all(met) and both.min() > 0 else met * np.maximum(alone, 0)

    def motion(_time, state):
        f1, f2 = forces(*state)
        return [*state[2:], f1 / collision.m1, (f2 - f1) / m2]

    shortest = min(one.period, two.period)
    start = np.array([0.0, 0.0, collision.v0, 0.0])
    atol = 1e-14 * np.array([shortest, shortest, 1, 1])
    run = DOP853(motion, 0.0, start, np.inf, rtol=1e-11, atol=atol, max_step=shortest / 60)
    while run.step() is None and (forces(*run.y).any() or not run.y[2] >= run.y[3] >= 0):
        pass
    return tuple(run.y[2:])


def test_estimates_are_honest(engine):
    """The limit is within three times its stated error of the exact velocities, for Kelvin-Voigt contacts.

    MuJoCo regularises its contacts. Therefore the part of the error that stems from the step is also compared with the
    exact limit of the regularised contacts.
    """
    # collisions with either contact stiffer, with losses or elastic, some with contacts that close again
    collisions = [
        Collision.two_balls(1.0, mass, 1e8, 1e8 * ratio, e1, e2)
        for ratio in (0.01, 0.1, 1.0, 10.0)
        for mass, e1, e2 in ((0.5, 1, 1), (2 / 3**0.5, 0.9, 0.7), (2, 0.5, 0.9), (2 / 3**0.5, 0.7, 0.5))
    ]
    outcomes = engine.solve_many(collisions, Settings(convergence=Convergence()))
    for c, outcome in zip(collisions, outcomes, strict=True):
        assert outcome.status == "ok", outcome.reason
        asked = get_solver("kelvin-voigt").solve(c)
        own = regularised(c) if engine.name == "mujoco" else asked.velocities
        d = outcome.diagnostics
        limit = np.array([d["v1_limit"], d["v2_limit"]])
        assert np.abs(limit - asked.velocities).max() <= 3 * d["limit_error"] + 1e-8
        step_error = d["limit_error"] - d["regularisation"]
        assert np.abs(limit - own).max() <= 3 * step_error + 1e-8
        assert d["limit_error"] < 1e-3
        # elastic contacts leave nothing to chance, so that the stated effect of regularisation can be compared
        if c.e1 == c.e2 == 1:
            moved = np.abs(np.subtract(own, asked.velocities)).max()
            assert d["regularisation"] == pytest.approx(moved, rel=0.05)


def test_a_limit_is_that_of_the_same_steps_asked_for_one_by_one_and_changes_no_outcome(engine):
    c = Collision.two_balls(m1=1.0, m2=1.5, k1=1e8, k2=1e8, e1=0.8, e2=0.6)
    h = 1e-3
    before, last = (engine.solve(c, Settings(step_fraction=fraction)) for fraction in (2 * h, h))
    followed = engine.solve(c, Settings(step_fraction=h, convergence=Convergence()))
    limit = followed.diagnostics
    extrapolated = 2 * last.v1 - before.v1, 2 * last.v2 - before.v2
    assert (limit["v1_limit"], limit["v2_limit"]) == extrapolated
    assert limit["finest_step"] == limit["step"]
    assert replace(followed, diagnostics={name: limit[name] for name in last.diagnostics}) == last
    assert "v1_limit" not in last.diagnostics


def test_what_is_not_known_to_the_tolerance_is_unconverged_and_keeps_its_numbers(engine):
    c = Collision.two_balls(m1=1.0, m2=1.5, k1=1e8, k2=1e7, e1=0.8, e2=0.6)
    settings = Settings(step_fraction=1e-3, convergence=Convergence(tolerance=1e-7, halvings=3))
    (outcome,) = engine.solve_many([c], settings)
    assert outcome.status == "unconverged"
    assert "more than the 1e-05 % that are allowed" in outcome.reason
    assert math.isfinite(outcome.v1)
    # No step brings the effect of MuJoCo's impedance below the tolerance, so MuJoCo's adapter tries no shorter one.
    halved = outcome.diagnostics["step"] / outcome.diagnostics["finest_step"]
    assert halved == (8 if engine.name == "pybullet" else 1)
    assert "the engine softens contacts by itself" in outcome.reason or engine.name == "pybullet"


DROP = Settings(scenario="drop", convergence=Convergence())

#: k2/k1, m2/m1, e1 and e2 of a drop in which the balls separate while B2 is faster by about 1e-4 |v0|.
PARTING = (0.108279, 0.523806, 0.627179, 0.902340)


def test_velocities_stay_in_flight(engine):
    outcome = engine.solve(two_balls(*PARTING), Settings(scenario="drop", record_path=True))
    path, start = outcome.path, outcome.diagnostics["first_flight"]
    flying = (path.time >= start) & (path.state == 4) & (path.time < path.time[-1])
    flight = path.time < path.time[flying][0] + 5e-4  # only the part of the path before the balls meet again
    for v in (path.v1, path.v2):
        assert np.ptp(v[flying & flight]) < 1e-15
    # impulses are those of the contacts; gravity acts until the first flight
    m2, g = PARTING[1], 9.81
    assert outcome.impulse1 == pytest.approx(outcome.v1 + 1 + g * start, rel=1e-12)
    assert outcome.impulse2 == pytest.approx(outcome.impulse1 + m2 * (outcome.v2 + g * start), rel=1e-12)


def test_no_unmarked_cell_of_the_default_box_jumps():
    cells = random_cells(4000, 11, 0.5, (3, np.log10(2)))
    rng = np.random.default_rng(12)
    # g in units of |v0| sqrt(k1/m1), for k1 = 1e8 N/m
    collisions, gravity = Collisions.from_ratios(*cells), np.full(4000, 9.81e-4)
    for name in ("kelvin-voigt", "bistiffness"):
        law = references.law_at(name)
        base = law(collisions, gravity)
        marked = find_jumps(law, collisions, base, gravity).excess > 1
        assert np.mean(marked) < 5e-3
        for _ in range(3):  # change the stiffnesses by other amounts than those that `find_jumps` tries
            a, b = 1 + 1e-3 * rng.uniform(-1, 1, (2, 4000))
            other = law(Collisions.from_ratios(cells[0] * a, *cells[1:]), gravity * b)
            away = np.maximum(abs(other.v1 - base.v1), abs(other.v2 - base.v2))
            assert np.max(away[~marked]) < 0.02


@pytest.mark.parametrize("name", ["kelvin-voigt", "bistiffness"])
@pytest.mark.parametrize("g", [0, 9.81])
def test_trying_every_cell_finds_no_other_jump(name, g):
    rng, law = np.random.default_rng(13), references.law_at(name)
    kappa, mu = 10 ** rng.uniform((-3, -1), (3, 1), (1500, 2)).T
    collisions = Collisions.from_ratios(kappa, mu, *rng.uniform(0.1, 1, (2, 1500)))
    gravity = np.full(1500, g / 1e4)  # g in units of |v0| sqrt(k1/m1), for k1 = 1e8 N/m
    exact = law(collisions, gravity)
    screened = find_jumps(law, collisions, exact, gravity)
    tried = find_jumps(law, collisions, exact, gravity, everywhere=True)
    marked = tried.excess > 1
    assert marked.any()
    assert np.count_nonzero(tried.excess) > 2 * np.count_nonzero(screened.excess)
    np.testing.assert_array_equal(screened.excess > 1, marked)
    np.testing.assert_array_equal(screened.excess[marked], tried.excess[marked])
    np.testing.assert_array_equal(screened.change[marked], tried.change[marked])


#: k2/k1, m2/m1, e1 and e2 of a drop that is close to a jump of its outcome. By the exact law, B2 comes to rest here
#: just before B1 would fall on it again, and B1 ends with 0.0004 |v0|. On the other side of the jump B1 falls on B2
#: again, and B1 ends with about 0.95 |v0|.
BESIDE_A_JUMP = (0.0019638078578694557, 1.4209566336503359, 0.9792807125092937, 0.8738534904062736)


@pytest.mark.parametrize("name", ["kelvin-voigt", "mujoco"])
def test_an_outcome_beside_a_jump_is_marked(name):
    c = two_balls(*BESIDE_A_JUMP, k1=1e5)
    outcome = get_solver(name).solve(c, Settings(scenario="drop"))
    says = r"a change of -?0.001 in e2 moves the exact outcome of kelvin-voigt by 0.95"
    assert re.match(says, outcome.mark)
    assert get_solver(name).solve(c, Settings(scenario="drop", mark=False)).mark == ""
    assert get_solver(name).solve(two_balls(*PARTING), Settings(scenario="drop")).mark == ""


@pytest.mark.slow
def test_a_flight_in_doubt_is_not_taken_for_known():
    # With steps h, h/2 and h/4 PyBullet's balls meet before B2 has left the table. In the limit they meet after it. The
    # velocities of the two cases differ by 2e-3 |v0|.
    c = two_balls(1e-3, 2 / np.sqrt(3), 1.0, 0.5)
    exact = get_solver("kelvin-voigt").solve(c, DROP)
    outcome = get_solver("pybullet").solve_many([c], DROP)[0]
    limit = outcome.diagnostics
    assert limit["finest_step"] < limit["step"] / 4
    assert abs(limit["v1_limit"] - exact.v1) < 3 * limit["limit_error"]
    # unconverged, although the differences between steps alone show no problem
    assert outcome.status == "unconverged"


def test_a_limit_with_another_flight_than_the_exact_law_is_marked():
    # MuJoCo's smallest impedance lets B2 leave the table 9 microseconds before the balls meet. In the exact solution
    # they meet first.
    c = two_balls(0.00553308751813229, 0.8101045963654292, 0.5562510847276028, 0.5158582821238982)
    outcome = get_solver("mujoco").solve(c, DROP)
    assert outcome.mark == "gravity ends in a first flight of the engine, and exact kelvin-voigt has none"
    assert get_solver("mujoco").solve(c, Settings(scenario="impact", convergence=Convergence())).mark == ""


def test_a_limit_at_rest_that_the_exact_law_leaves_is_marked():
    # The contacts are soft, so that gravity is strong. At every step PyBullet's lower ball stays on the table.
    c = two_balls(133.76074, 1.594772, 0.809319, 0.948431, k1=1e4)
    exact = get_solver("kelvin-voigt").solve(c, DROP)
    outcome = get_solver("pybullet").solve(c, DROP)
    limit = outcome.diagnostics
    assert limit["v2_limit"] == 0 < exact.v2
    # the differences between steps do not show this error
    assert abs(limit["v1_limit"] - exact.v1) > 3 * limit["limit_error"]
    says = "by the engine the lower ball comes to rest on the table, and by exact kelvin-voigt it leaves"
    assert outcome.mark == says


@pytest.mark.parametrize("law", ["sequential-top", "sequential-bottom", "newton-restitution"])
def test_impacts_bring_velocities_no_further_from_the_separated_ones(law):
    rng = np.random.default_rng(5)
    for _ in range(30):
        balls, table = int(rng.integers(2, 6)), bool(rng.integers(2))
        contacts = balls - 1 + table
        masses, velocities = np.exp(rng.uniform(-2, 2, balls)), rng.uniform(-1, 1, balls)
        velocities[0], gaps = -2.0, tuple(rng.uniform(0.1, 1, contacts).tolist())
        e = 1.0 if law == "newton-restitution" else float(rng.uniform(0.5, 1))
        numbers = tuple(masses.tolist()), (1.0,) * contacts, (e,) * contacts, tuple(velocities.tolist())
        end = follow_impacts(Collision(*numbers, table, gaps), law).v
        apart = np.array(project_to_separated(velocities.tolist(), masses.tolist(), table))
        assert np.all(np.diff(apart) <= 0)
        assert masses @ (end - apart) ** 2 <= masses @ (velocities - apart) ** 2 * (1 + 1e-12)


def test_a_meeting_too_slow_to_matter_ends_a_collision(engine):
    """A collision ends although its elastic balls still approach each other very slowly, and its limit is right.

    In the exact outcome these balls are at rest. Their remaining speeds are 1e-8 m/s, or an error that depends on the
    time step. The velocities agree with those of single impacts within the stated error of the limit.
    """
    cradle = Collision((1,) * 5, (1e8,) * 4, (1,) * 4, (-1, 0, 0, 0, 0), gaps=(0, 1e-3, 1e-3, 1e-3))
    wall = Collision((1, 1), (1e8, 1e8), (1, 1), (-1, 0), table=True, gaps=(1e-3, 1e-3))
    for collision, exact in ((cradle, (0, 0, 0, 0, -1)), (wall, (1, 0))):
        outcome = engine.solve(collision, Settings(convergence=Convergence()))
        limit = [outcome.diagnostics[f"v{i}_limit"] for i in range(1, len(exact) + 1)]
        assert outcome.diagnostics["limit_error"] < 1e-3
        assert limit == pytest.approx(exact, abs=outcome.diagnostics["limit_error"])
        assert all(np.diff(outcome.velocities) <= 0)
