"""Engines as people run them: one contact, the basic collision, and what does not change an answer.

What each engine is held against is a closed form: (1, 0), Newton's restitution at both contacts at once, and
(7/9, 4/9), single impacts one after the other; or an exact reference of its contact law.
"""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from impact_xval.compliant_baselines.practical.practice import (
    RADIUS,
    Arrangement,
    Practice,
    shortest_period,
    single_contact,
)
from impact_xval.compliant_baselines.practical.practices import get_practice, practice_names
from impact_xval.compliant_baselines.references.columns.solving import solve_column
from impact_xval.model import Column

ALL_AT_ONCE, ONE_BY_ONE = (1.0, 0.0), (7 / 9, 4 / 9)
BASIC = Column((1.0, 2.0), (1e4, 1e4), (1.0, 1.0), (-1.0, 0.0), True)
PAIR = Column((1.0, 2.0), (1e4,), (0.9,), (-1.0, 0.5))
#: What compiles for seconds.
COMPILED = tuple(name for name in practice_names() if name.startswith(("newton", "mjx")))
QUICK = tuple(
    pytest.param(name, marks=[pytest.mark.slow] if name in COMPILED else []) for name in practice_names()
)


def installed(name):
    practice = get_practice(name)
    reason = practice.unavailable()
    if reason:
        pytest.skip(reason)
    return practice


def answer(name, column=BASIC, **arrangement):
    practice = installed(name)
    found = practice.simulate(column, replace(practice.usual(column), **arrangement))
    assert found.status == "ok", found.reason
    return found.velocities


# One contact: rigid engines, by what of e = 0.9 or 0.5 they miss at 1 m/s and their own step.
@pytest.mark.parametrize("e", [0.9, 0.5])
@pytest.mark.parametrize("table", [True, False])
@pytest.mark.parametrize(
    ("name", "within"),
    [
        ("dart", 3e-5),  # the softening of the LCP, 1e-5 of 1 + e
        ("pymunk", 1e-12),
        ("sapien-pgs", 1e-6),
        ("rapier", 1e-6),
        pytest.param("newton-xpbd", 1e-6, marks=pytest.mark.slow),
        ("mujoco-calibrated-0.001", 3e-3),
        ("pybullet-calibrated-0.001", 1e-2),  # backward Euler: exp(-pi^2 share) of it, or more
    ],
)
def test_one_contact_returns_what_was_asked_for(name, within, table, e):
    assert single_contact(installed(name), e, table=table).returned == pytest.approx(e, abs=within)


@pytest.mark.parametrize("e", [0.9, 0.5])
def test_tgs_returns_it_but_between_balls_that_touch(e):
    practice, pair = installed("sapien-tgs"), replace(PAIR, masses=(1.0, 1.0), velocities=(-1.0, 0.0))
    pair = replace(pair, restitutions=(e,))
    assert single_contact(practice, e).returned == pytest.approx(e, abs=1e-6)
    for gap, within in ((1e-4, 1e-6), (0.0, 3e-3)):  # touching, its velocities are 1e-3 off, and no more
        v1, v2 = answer("sapien-tgs", pair, gap=gap)
        assert v1 - v2 == pytest.approx(e, abs=within)


@pytest.mark.parametrize(
    ("name", "threshold"), [("dart", 0.1 / 0.9), ("pybullet-restitution", 0.2), ("sapien-shipped", 2.0)]
)
def test_below_its_threshold_an_engine_does_not_bounce(name, threshold):
    practice = installed(name)
    assert single_contact(practice, 0.9, 0.5 * threshold).returned == pytest.approx(0, abs=0.03)
    assert single_contact(practice, 0.9, 2 * threshold).returned == pytest.approx(0.9, abs=0.01)


def test_darts_threshold_is_of_what_comes_back():
    for e, speed, bounces in ((0.9, 0.11, False), (0.9, 0.112, True), (0.5, 0.19, False), (0.5, 0.21, True)):
        assert (single_contact(installed("dart"), e, speed).returned > 0.5 * e) == bounces


def test_pybullet_loses_its_slop_every_step():
    # contactSlop, 1e-5 m, is allowed to close within the step of the impact.
    for step in (1 / 240, 1e-3, 1e-4):
        returned = single_contact(installed("pybullet-restitution"), 0.9, step=step).returned
        assert returned == pytest.approx(0.9 - 1e-5 / step, abs=1e-6)


def test_mujoco_as_shipped_returns_the_same_whatever_is_asked_for():
    found = {single_contact(installed("mujoco-default"), e).returned for e in (1.0, 0.5, 0.0)}
    assert len(found) == 1
    assert found.pop() < 0.2


@pytest.mark.parametrize(
    ("name", "gap", "expected", "within"),
    [
        ("dart", 1e-4, ONE_BY_ONE, 5e-5),
        ("dart", -1e-6, ALL_AT_ONCE, 5e-5),
        ("dart", 0.0, ALL_AT_ONCE, 5e-5),
        # One unit in the last place: the table, a step after the balls, stops the lower one against the upper.
        ("dart", 2.0**-51, (2 / 3, 2 / 3), 5e-5),
        ("pymunk", 0.0, ONE_BY_ONE, 1e-12),
        ("pymunk", -1e-6, ALL_AT_ONCE, 5e-5),
        ("pymunk-one-iteration", -1e-6, (5 / 3, 2 / 3), 1e-9),  # a gain of energy
        ("sapien-pgs", 0.0, ALL_AT_ONCE, 5e-5),
    ],
)
def test_the_basic_collision_has_a_closed_form(name, gap, expected, within):
    assert answer(name, gap=gap) == pytest.approx(expected, abs=within)


def test_the_order_of_insertion_matters_to_one_iteration():
    turned = answer("pymunk-one-iteration", gap=-1e-6, reversed_insertion=True)
    assert turned == pytest.approx((1 / 3, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    ("name", "within"),
    [
        ("dart", 5e-4),  # of balls that touch to the last bit
        ("rapier", 1e-6),
        ("mujoco-default", 1e-12),
        ("mujoco-direct", 1e-12),
        ("pybullet-documented", 1e-6),  # where its iteration stops: solverResidualThreshold is 1e-7
    ],
)
def test_the_order_of_insertion_does_not_matter_elsewhere(name, within):
    assert answer(name, reversed_insertion=True) == pytest.approx(answer(name), abs=within)


def test_balls_that_touch_do_so_to_the_last_bit():
    tower = Column((1.0,) * 9, (1.0,) * 9, (1.0,) * 9, (-1.0, *(0.0,) * 8), True)
    for translation in (0.0, 1.0):
        heights = np.array(Arrangement(1e-3, translation=translation).heights(tower), np.float32)
        assert (heights == heights.astype(float)).all()
        assert (np.diff(heights) == -2 * RADIUS).all()
        assert heights[-1] - translation == RADIUS
    found = [answer("pybullet-restitution", gap=gap)[0] for gap in (0.0, 2.0**-51)]
    assert found == pytest.approx(
        [0.9951, 1.0773], abs=1e-4
    )  # one unit in the last place lets it gain energy


@pytest.mark.parametrize("name", QUICK)
def test_balls_in_space_keep_their_momentum(name):
    practice = installed(name)
    found = practice.simulate(PAIR)
    assert found.status == "ok", found.reason
    before, after = (
        sum(m * v for m, v in zip(PAIR.masses, each, strict=True))
        for each in (PAIR.velocities, found.velocities)
    )
    assert after == pytest.approx(before, abs=1e-5 if practice.precision == "float32" else 1e-10)


@pytest.mark.parametrize("name", ["pybullet-restitution", "pybullet-documented"])
def test_bullet_does_not_remember_the_calibrated_adapter(name):
    # Its threshold of contact is a number of the process: a gap of 1e-6 radii is where it shows.
    before = answer(name, gap=1e-6)
    answer("pybullet-calibrated-0.01")
    assert answer(name, gap=1e-6) == before


# Where an engine answers the same a metre further up, if the gap there is as open: 1e-4 radii, far beyond rounding.
@pytest.mark.parametrize(
    ("name", "within"),
    [
        ("dart", 1e-9),
        ("pymunk", 1e-9),
        ("rapier", 1e-3),
        ("mujoco-default", 1e-9),
        ("mujoco-direct", 1e-9),
        ("pybullet-documented", 1e-9),
        pytest.param("newton-semi-implicit", 2e-3, marks=pytest.mark.slow),
    ],
)
def test_a_metre_further_up(name, within):
    assert answer(name, gap=1e-4, translation=1.0) == pytest.approx(answer(name, gap=1e-4), abs=within)


@pytest.mark.parametrize("name", ["pymunk", "sapien-tgs", "rapier"])
def test_no_engine_falls_asleep_in_the_midst(name):
    assert single_contact(installed(name), 0.9, 1e-3).returned == pytest.approx(0.9, abs=1e-4)


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_calibrated_adapters_tend_to_kelvin_voigt_in_proportion_to_the_step(engine):
    column = replace(BASIC, restitutions=(0.9, 0.7))
    exact, period = solve_column(column, "kelvin-voigt").velocities, shortest_period(column)
    name = f"{engine}-calibrated-0.001"
    apart = [math.dist(answer(name, column, step=share * period), exact) for share in (1e-3, 2e-3, 4e-3)]
    assert 1.8 < apart[1] / apart[0] < 2.4
    assert 1.8 < apart[2] / apart[1] < 2.4


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.1, 1.0])
@pytest.mark.parametrize("e", [1.0, 0.8])
@pytest.mark.parametrize("name", ["newton-semi-implicit", "newton-featherstone"])
def test_newtons_springs_tend_to_the_compression_dashpot(name, e, ratio):
    column = Column((1.0, 2.0), (1e3, 1e3 * ratio), (e, e), (-1.0, 0.0), True)
    practice, exact = installed(name), solve_column(column, "compression-dashpot").velocities
    period = shortest_period(column)
    apart = []
    for share in (1 / 50, 1 / 400):
        found = practice.simulate(column, Arrangement(share * period))
        assert found.status == "ok", found.reason
        apart.append(math.dist(found.velocities, exact))
    # An eighth of the step; below 1e-4 single precision of positions would end it.
    assert apart[1] < apart[0] / 3
    assert apart[1] < 1e-3
    if e < 1:  # and it is this law, not the one that also damps what comes back
        assert apart[1] < 0.1 * math.dist(solve_column(column, "kelvin-voigt").velocities, exact)


@pytest.mark.parametrize("name", practice_names())
def test_an_absent_engine_is_unavailable_with_the_way_out(name, monkeypatch):
    practice = get_practice(name)
    for loaded in [name for name in sys.modules if name.startswith(f"{practice.module}.")]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setitem(sys.modules, practice.module, None)  # as if it were not there
    reason = practice.unavailable()
    assert reason is not None
    assert practice.distribution in reason
    assert "pip install" in reason
    found = practice.simulate(BASIC)
    assert (found.status, found.reason) == ("unavailable", reason)
    assert all(map(math.isnan, found.velocities))


@pytest.mark.parametrize(
    "name", ["dart", "pymunk", "rapier", "pybullet-restitution", "sapien-tgs", "newton-xpbd"]
)
def test_what_no_bodies_can_have_is_refused_by_name(name):
    column = Column((1.0,) * 4, (1e4,) * 3, (1.0, 0.1, 1.0), (-1.0, 0.0, 0.0, 0.0))
    found = installed(name).simulate(column)
    assert found.status == "unrepresentable"
    assert "restitutions = (1.0, 0.1, 1.0)" in found.reason


def test_an_elastic_contact_has_no_time_constant():
    found = installed("mujoco-documented").simulate(BASIC)
    assert found.status == "unrepresentable"
    assert "restitutions[1] = 1.0" in found.reason


class _Fake(Practice):
    name, settings, engine, distribution, module, default_step = "fake", "", "Fake", "numpy", "numpy", 0.1

    def __init__(self, after):
        self.after = after

    def load(self):
        return None

    def world(self, column, arrangement):
        raise RuntimeError("the engine\nsays no")

    def run(self, column, arrangement):
        if self.after is None:
            return super().run(column, arrangement)

        after = self.after

        class World:
            def step(self):
                print("chatter")

            def velocities(self):
                return after()

        return self._follow(World(), column, arrangement)


def test_failures_are_values(capfd):
    crashed = _Fake(None).simulate(BASIC)
    assert (crashed.status, crashed.reason) == ("crashed", "Fake: the engine says no")
    broken = _Fake(lambda: (math.nan, 0.0)).simulate(BASIC)
    assert broken.status == "crashed"
    assert "nan" in broken.reason
    late = _Fake(lambda: (-1.0, 0.0)).simulate(BASIC, Arrangement(0.1, max_steps=7))
    assert (late.status, late.steps) == ("timeout", 7)
    assert capfd.readouterr() == ("", "")


def test_engines_do_not_chatter(capfd):
    for name in practice_names():
        if name not in COMPILED:
            get_practice(name).simulate(BASIC)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "wrong", [{"step": 0.0}, {"step": math.inf}, {"gap": 0.6}, {"translation": math.nan}, {"max_steps": 0}]
)
def test_an_arrangement_is_checked(wrong):
    (name,) = wrong
    with pytest.raises(ValueError, match=f"{name} = .*legal"):
        Arrangement(**{"step": 1e-3, **wrong})


def test_an_unknown_practice():
    with pytest.raises(ValueError, match="practice 'havok' is unknown; known: "):
        get_practice("havok")


@pytest.mark.slow
def test_mjx_is_mujoco():
    found, expected = installed("mjx-default").simulate(BASIC), get_practice("mujoco-default").simulate(BASIC)
    assert found.velocities == pytest.approx(expected.velocities, abs=1e-13)
    assert found.steps == expected.steps
