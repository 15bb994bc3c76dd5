"""The contact command: its printed text, pasted into a scene written by hand, gives the contact that was requested."""

import math

import numpy as np
import pytest

from impact_xval.compliant_baselines import SolverError
from impact_xval.compliant_baselines.engines import pybullet
from impact_xval.compliant_baselines.mapping import KelvinVoigtContact, contact_time, damping_ratio
from impact_xval.compliant_baselines.paste import paste
from impact_xval.compliant_baselines.pasted_drops import (
    drop_in_mujoco,
    drop_in_pybullet,
    drop_on_flat_in_pybullet,
    mujoco_scene,
)
from impact_xval.compliant_baselines.single_contact import (
    SingleImpact,
    find_extremes,
    find_largest_step,
    scenes_of,
)
from impact_xval.experiments.presentation.contacts import round_outward
from tests.compliant_baselines import hand_scenes
from tests.compliant_baselines.conftest import installed
from tests.compliant_baselines.test_mapping import integrated_contact


def requests(n, seed=20):
    """Draw n requests for a contact: masses, restitution, speed, and alternately a duration or a stiffness.

    Every third request has a fixed body.
    """
    rng = np.random.default_rng(seed)
    pairs = []
    for i in range(n):
        light = 10 ** rng.uniform(-2, 2)
        other = math.inf if i % 3 == 2 else light * 10 ** rng.uniform(-2, 2)
        masses = (light, other) if i % 4 < 2 else (other, light)
        e = 1.0 if i % 7 == 6 else rng.uniform(0.2, 1.0)
        speed = 10 ** rng.uniform(-1, 1)
        what = {"stiffness": 10 ** rng.uniform(2, 9)} if i % 2 else {"duration": 10 ** rng.uniform(-5, -1)}
        pairs.append(SingleImpact(masses, e, speed=speed, **what))
    return pairs


def measured(engine, pair, step, place):
    """Return restitution and duration in a scene written by hand; `place` sets where within a step the bodies touch."""
    text = paste(engine, pair.contact, step)
    return getattr(hand_scenes, engine)(pair, text, step, float(3 + place) * pair.speed * step)


ALL_TWENTY = [
    pytest.param(engine, 20, marks=pytest.mark.nightly) for engine in ("mujoco", "pybullet", "drake")
]


@pytest.mark.parametrize(("engine", "n"), [("mujoco", 8), ("pybullet", 1), ("drake", 1), *ALL_TWENTY])
def test_pasted_into_a_scene_written_by_hand(engine, n):
    solver, rng = installed(engine), np.random.default_rng(1)
    for pair in requests(n):
        step = find_largest_step(solver, pair).step
        asked = (
            pair.duration
            or contact_time(damping_ratio(pair.restitution)) * (pair.mass / pair.stiffness) ** 0.5
        )
        for place in rng.uniform(0, 1, 2):
            e, duration = measured(engine, pair, step, place)
            assert e == pytest.approx(pair.restitution, rel=0.01), pair
            assert duration == pytest.approx(asked, rel=0.01), pair


def far_apart(n, seed=68):
    """Yield n requests with masses from 1e-6 to 1e4 kg and e from 0.01 to 1; every third has a fixed body."""
    rng = np.random.default_rng(seed)
    for i in range(n):
        light, other = (10 ** rng.uniform(-6, 4) for _ in range(2))
        e = (1.0, 0.01, rng.uniform(0.01, 1))[min(i, 2)]
        duration, speed = 10 ** rng.uniform(-4, -1), 10 ** rng.uniform(-2, 1)
        yield SingleImpact((light, math.inf if i % 3 == 2 else other), e, duration=duration, speed=speed)


#: Masses in kg, duration in s and speed in m/s of contacts for which MuJoCo's default tolerance dropped part of the
#: force.
LET_GO = [
    ((1e-6, 1e4), 0.1, 0.1),
    ((1e-6, 1e4), 0.01, 1.0),
    ((1e-5, 1e3), 0.1, 0.1),
    ((1e-4, 1e3), 0.1, 0.1),
    ((1e-3, 1e4), 0.1, 0.1),
]


def assert_eight_drops_are_inside(engine, pair, found):
    """Assert that drops in a scene written by hand are within the stated interval of e, and their durations within 1 %.

    The bodies touch at eight places within a step, and just after its start.
    """
    low, high = map(float, round_outward(*found.restitution).split(" to "))
    for place in (*np.arange(8) / 8, 1e-5):
        e, duration = measured(engine, pair, found.step, place)
        assert low <= e <= high, (pair, place)
        assert duration == pytest.approx(pair.duration, rel=0.01), (pair, place)


@pytest.mark.parametrize(("masses", "duration", "speed"), LET_GO)
def test_light_on_heavy_does_what_is_stated_when_it_is_pasted(masses, duration, speed):
    pair = SingleImpact(masses, 0.5, duration=duration, speed=speed)
    assert_eight_drops_are_inside("mujoco", pair, find_largest_step(installed("mujoco"), pair))


NIGHTLY_THIRTY = [pytest.param(engine, 30, marks=pytest.mark.nightly) for engine in ("mujoco", "pybullet")]


@pytest.mark.parametrize(("engine", "n"), [("mujoco", 6), *NIGHTLY_THIRTY])
def test_stated_intervals_hold_wherever_in_a_step_bodies_touch(engine, n):
    for pair in far_apart(n):
        assert_eight_drops_are_inside(engine, pair, find_largest_step(installed(engine), pair))


@pytest.mark.parametrize("masses", [(0.2, math.inf), (3.0, 0.2)], ids=["fixed", "free"])
def test_pybullets_interval_holds_on_a_box_and_on_a_ball(masses):
    engine, pair = installed("pybullet"), SingleImpact(masses, 0.7, duration=1e-3, speed=0.5)
    found = find_extremes(engine, pair, 4e-6)
    assert_eight_drops_are_inside("pybullet", pair, found)
    # The project's adapter sets another breaking threshold, which the engine keeps for the whole process.
    engine.run(scenes_of(pair, 4e-6, [0.5]), 10_000)
    assert find_extremes(engine, pair, 4e-6) == found


def test_what_is_pasted_into_pybullet_is_not_capped_at_100_metres_per_second():
    pair = SingleImpact((1.0, math.inf), 0.8, duration=1e-2, speed=1000.0)
    e, _ = measured("pybullet", pair, 2e-5, 0.5)
    assert e == pytest.approx(0.8, rel=0.01)


def test_the_printed_text_is_all_that_a_drop_in_mujoco_runs():
    import mujoco

    pair, step = SingleImpact((1e-6, 1e4), 0.5, duration=0.1, speed=0.1), 8e-4
    text = paste("mujoco", pair.contact, step)
    model = mujoco.MjModel.from_xml_string(mujoco_scene(text, (1e-6, 1e4), 0.1))
    data = mujoco.MjData(model)
    data.qpos[1], data.qvel[1] = 0.3 * pair.speed * step, -pair.speed
    for _ in range(200):
        mujoco.mj_step(model, data)
    ((e, _),) = drop_in_mujoco(text, (1e-6, 1e4), 0.1, pair.speed, [0.3 * pair.speed * step], 1000)
    assert e == (data.qvel[1] - data.qvel[0]) / pair.speed
    # settings that the text leaves out are the engine's defaults in such a drop
    bad = text.replace(f'timestep="{step}"', "")  # without its timestep the scene has the default of 0.002 s
    assert drop_in_mujoco(bad, (1e-6, 1e4), 0.1, pair.speed, [0.0], 1000)[0][1] < 0.1 / step / 2


@pytest.mark.parametrize("drop", [drop_in_pybullet, drop_on_flat_in_pybullet])
@pytest.mark.parametrize("masses", [(0.2, 3.0), (2.0, math.inf)])
def test_drops_that_share_a_client_are_those_of_clients_of_their_own(drop, masses, monkeypatch):
    """Drops that share one PyBullet client give exactly what drops in separate clients give.

    Sharing matters because connecting a client takes ten times as long as a drop, and a search makes hundreds of drops.
    """
    installed("pybullet")
    pair, step = SingleImpact(masses, 0.7, duration=1e-2), 2e-4
    text = paste("pybullet", pair.contact, step)
    gaps = [place * step for place in (1e-8, 0.4, 0.9)]
    alone = [drop(text, masses, 0.1, 1.0, [gap], 1000)[0] for gap in gaps]
    clients, connected = [], pybullet.connected
    monkeypatch.setattr(pybullet, "connected", lambda: clients.append(connected()) or clients[-1])
    assert drop(text, masses, 0.1, 1.0, gaps, 1000) == alone
    assert len(clients) == 1


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_the_step_named_is_about_the_largest(engine):
    solver = installed(engine)
    for pair in requests(2 if engine == "mujoco" else 1, seed=4):
        step = 3 * find_largest_step(solver, pair).step
        errors = []
        for place in np.linspace(0, 1, 8, endpoint=False):
            e, duration = measured(engine, pair, step, place)
            errors += [abs(e / pair.restitution - 1), abs(duration / pair.contact.duration - 1)]
        assert max(errors) > 0.01


def test_the_penetration_is_that_of_the_motion_integrated():
    for e in (1.0, 0.7, 0.2, 0.01):
        pair = SingleImpact((1.0, math.inf), e, stiffness=4.0, speed=3.0)
        *_, deepest = integrated_contact(pair.contact.zeta)
        # omega = sqrt(k/m) is 2/s
        assert pair.penetration == pytest.approx(3.0 / 2.0 * deepest, rel=1e-10), e


def test_impossible_contacts_are_refused():
    for arguments, says in (
        ({"restitution": 1.1}, "restitution = 1.1; legal: from 0.0001 to 1"),
        ({"stiffness": 0.0}, r"stiffness = 0.0; legal: a finite number > 0 \(N/m\)"),
        ({"stiffness": math.inf}, "stiffness = inf; legal"),
        ({"stiffness": None, "duration": 0.0}, r"duration = 0.0; legal: a finite number > 0 \(s\)"),
        ({"stiffness": None, "duration": 1e-200}, "duration = 1e-200: no stiffness within double precision"),
        ({"stiffness": None, "duration": 1e200}, r"duration = 1e\+200: no stiffness within double precision"),
        ({"masses": (0.0, 1.0)}, "masses = 0.0; legal: from 1e-15 to 1e"),
        ({"masses": (1.0,)}, r"masses = \(1.0,\); legal: two"),
    ):
        with pytest.raises(ValueError, match=says):
            SingleImpact(**({"masses": (1.0, 1.0), "restitution": 0.5, "stiffness": 1.0} | arguments))


def test_a_contact_that_no_step_gives_is_unconverged():
    pair = SingleImpact((1.0, math.inf), 0.01, stiffness=1.0)
    for tolerance, why in ((1e-7, "200000 steps a duration is not known"), (1e-5, "one of them is off by")):
        with pytest.raises(SolverError, match=f"unconverged: no step from .* s to .* s gives .*: .*{why}"):
            find_largest_step(installed("mujoco"), pair, tolerance)


def test_what_cannot_be_pasted_is_refused():
    with pytest.raises(ValueError, match="engine = 'dart'; legal: mujoco, pybullet, drake"):
        paste("dart", KelvinVoigtContact(1e6, 0.0, 1.0), 1e-5)
    with pytest.raises(SolverError, match="leaves double precision"):
        paste("mujoco", KelvinVoigtContact(1e308, 0.0, 1e-3), 1e-5)
