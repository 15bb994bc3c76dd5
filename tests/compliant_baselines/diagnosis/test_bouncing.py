"""Contacts of scenes as they are measured, beside plain scripts of the engines and closed forms."""

import math
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.calibration.scene_text import mjcf
from impact_xval.compliant_baselines.contact.column import column_of
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.diagnosis.bouncing import PLACES, Meeting, inspect, kinds
from impact_xval.compliant_baselines.diagnosis.diagnose_pybullet import at_first_step
from impact_xval.compliant_baselines.diagnosis.inspect_mujoco import mujoco_meetings
from impact_xval.compliant_baselines.diagnosis.inspect_pybullet import pybullet_meetings
from impact_xval.model.collision import Collision

needs_pybullet = pytest.mark.skipif(
    bool(get_solver("pybullet").unavailable()), reason="PyBullet is not installed"
)

DROP = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>
<body pos="0 0 0.5"><freejoint/><geom name="ball" size="0.1" mass="1"/></body></worldbody></mujoco>"""


def compiled(text):
    import mujoco

    return mujoco.MjModel.from_xml_string(text)


def measured(text, speed=1.0):
    return [inspect(meeting, speed) for meeting in kinds(mujoco_meetings(compiled(text)))]


# MuJoCo


def test_mujocos_default_ball_that_falls_at_2_80_rebounds_with_0_37():
    import mujoco

    model = compiled(DROP)
    data = mujoco.MjData(model)
    velocities = []
    for _ in range(400):
        mujoco.mj_step(model, data)
        velocities.append(data.qvel[2])
    assert min(velocities) == pytest.approx(-2.80, abs=0.01)
    assert max(velocities) == pytest.approx(0.37, abs=0.005)
    (contact,) = measured(DROP, speed=2.80)
    assert contact.where == "geoms floor and ball"
    low, high = contact.restitution_range
    assert low <= max(velocities) / -min(velocities) <= high
    assert (high - low) < 0.03
    assert 15 < contact.steps < 25
    at_half, by_place = contact.remarks
    assert at_half.startswith("at half the step e differs by more than 1 %")
    assert by_place == "e differs by more than 1 % with where within a step the bodies touch"


#: A ball of 0.5 kg above a floor, or above another ball; {0}, {1}: attributes of the upper and the lower geom.
ON_FLOOR = """<mujoco><option timestep="{step}" gravity="0 0 0" {option}><flag {flag}/></option><worldbody>
<geom name="low" type="plane" size="1 1 1" {lower}/>
<body name="up" pos="0 0 {height}"><freejoint/><geom name="up" size="0.2" mass="0.5" {upper}/></body>
</worldbody><contact>{contact}</contact></mujoco>"""
ON_BALL = ON_FLOOR.replace(
    '<geom name="low" type="plane" size="1 1 1" {lower}/>',
    '<body name="low" pos="0 0 -0.3"><freejoint/><geom name="low" size="0.3" mass="2" {lower}/></body>',
)
SOFT = "solref='-4e3 -10' solimp='.3 .6 .01 .5 2'"


def own_bounces(scene, speed, margin=0.0, steps=4000, **fields):
    """Restitution of a scene for touches at `PLACES`, by nothing but MuJoCo; margin: where forces begin, in m."""
    import mujoco

    found = []
    for place in PLACES:
        height = 0.2 + margin + place * speed * fields["step"]
        model = compiled(scene.format(height=height, **fields))
        data = mujoco.MjData(model)
        up = model.body("up").dofadr[0] + 2
        low = model.body("low").dofadr[0] + 2 if "low" in scene and model.nv > 6 else None
        data.qvel[up] = -speed
        touched = left = 0
        for _ in range(steps):
            mujoco.mj_step(model, data)
            rate = data.qvel[up] - (0 if low is None else data.qvel[low])
            touched += abs(rate + speed) > 1e-9 * speed
            left = left + 1 if touched and rate > 0 and not data.efc_force.any() else 0
            if left > 3:
                break
        found.append(rate / speed)
    return found


@pytest.mark.parametrize("scene", [ON_FLOOR, ON_BALL], ids=["floor", "ball"])
@pytest.mark.parametrize(
    ("changed", "margin"),
    [
        ({}, 0.0),
        ({"upper": SOFT}, 0.0),
        ({"upper": SOFT, "lower": "priority='1'"}, 0.0),
        ({"upper": SOFT + " solmix='5'", "lower": "solref='-1e3 -40' solmix='1'"}, 0.0),
        ({"upper": "solref='.05 .3' solmix='5'", "lower": "solref='.03 .2' condim='6'"}, 0.0),
        ({"upper": SOFT, "option": "cone='elliptic' impratio='3'", "lower": "condim='1'"}, 0.0),
        ({"upper": "friction='2 .1 .1'", "option": "integrator='implicitfast' solver='CG'"}, 0.0),
        ({"option": "integrator='discrete'", "lower": SOFT}, 0.0),
        ({"option": "integrator='RK4'", "lower": SOFT, "upper": "condim='4'"}, 0.0),
        ({"upper": SOFT, "flag": "override='enable'", "option": "o_solref='.02 .4'"}, 0.0),
        ({"contact": "<pair geom1='up' geom2='low' solref='-2e3 -20' solimp='.1 .1 .1 .5 1'/>"}, 0.0),
        ({"contact": "<pair geom1='up' geom2='low' condim='1' margin='.01'/>"}, 0.01),
        ({"contact": "<pair geom1='up' geom2='low' condim='1' margin='-.01'/>"}, -0.01),
    ],
    ids=[
        *(
            "default",
            "direct",
            "priority",
            "mixed direct",
            "mixed",
            "elliptic",
            "implicit",
            "discrete",
            "RK4",
        ),
        *("override", "pair", "margin", "inside"),
    ],
)
def test_every_parameter_of_a_contact_is_that_of_the_scene(scene, changed, margin):
    fields = {"step": 2e-3, "upper": "", "lower": "", "option": "", "flag": "", "contact": ""} | changed
    own = own_bounces(scene, 0.7, margin, **fields)
    (contact,) = measured(scene.format(height=1, **fields), speed=0.7)
    assert contact.status == "ok"
    assert contact.restitution == pytest.approx(np.mean(own), abs=2e-6)
    assert contact.restitution_range == pytest.approx((min(own), max(own)), abs=2e-6)
    assert contact.masses == ((math.inf, 0.5) if scene is ON_FLOOR else (2.0, 0.5)) or contact.masses == (
        0.5,
        math.inf if scene is ON_FLOOR else 2.0,
    )
    half = own_bounces(scene, 0.7, margin, **fields | {"step": 1e-3})
    assert contact.restitution_half_step == pytest.approx(np.mean(half), abs=2e-6)


def test_geoms_that_the_engine_keeps_apart_are_no_pairs():
    text = """<mujoco><worldbody>
    <geom name="floor" type="plane" size="1 1 1"/><geom name="wall" type="plane" size="1 1 1"/>
    <geom name="ghost" size="1" contype="0" conaffinity="0"/>
    <body name="a"><freejoint/><geom name="a" size="1"/><geom name="a2" size="2"/>
      <body name="b"><joint/><geom name="b" size="3"/>
        <body name="c"><joint/><geom name="c" size="4"/></body></body></body>
    <body name="d"><freejoint/><geom name="d" size="5" contype="2" conaffinity="4"/></body>
    <body name="e"><freejoint/><geom name="e" size="6"/></body>
    </worldbody>
    <contact><exclude body1="e" body2="c"/><pair name="named" geom1="ghost" geom2="d"/></contact></mujoco>"""
    import mujoco

    model = compiled(text)
    found = {meeting.where for meeting in mujoco_meetings(model)}
    # The engine itself, with everything in everything.
    data = mujoco.MjData(model)
    model.geom_margin[:] = 100
    model.body_margin[:] = 100
    mujoco.mj_forward(model, data)
    names = [model.geom(i).name for i in range(model.ngeom)]
    own = {frozenset(names[g] for g in contact.geom) for contact in data.contact}
    assert {frozenset(w.removeprefix("geoms ").split(" and ")) for w in found if w != "pair named"} == {
        pair for pair in own if pair != {"ghost", "d"}
    }
    assert {"ghost", "d"} in own
    assert "pair named" in found
    assert len(found) == 16
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    more = {meeting.where for meeting in mujoco_meetings(model)} - found
    assert more == {"geoms a and b", "geoms a2 and b", "geoms b and c"}
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    assert not list(mujoco_meetings(model))


def test_a_pendulum_counts_with_the_mass_that_strikes():
    # A point of 0.3 kg at 2 m strikes a wall where it hangs; its own scene is the other side.
    import mujoco

    text = f"""<mujoco><option timestep="1e-3" gravity="0 0 0"/><worldbody>
    <geom name="wall" type="plane" pos="{{place}} 0 0" zaxis="-1 0 0" size="1 1 1" {SOFT}/>
    <body><joint type="hinge" axis="0 1 0"/><inertial pos="0 0 -2" mass="0.3" diaginertia="1e-8 1e-8 1e-8"/>
    <geom name="bob" size="0.1" pos="0 0 -2" mass="0" {SOFT}/></body></worldbody></mujoco>"""
    own = []
    for place in PLACES:
        model = compiled(text.format(place=0.1 + place * 1e-3 * 0.5))
        data = mujoco.MjData(model)
        data.qvel[0] = -0.25
        for _ in range(600):
            mujoco.mj_step(model, data)
        own.append(data.qvel[0] / 0.25)
    (contact,) = measured(text.format(place=0.2), speed=0.5)
    assert contact.mass == pytest.approx(0.3, rel=1e-6)
    assert contact.restitution == pytest.approx(np.mean(own), abs=1e-3)
    assert 0.2 < contact.restitution < 0.9
    assert "moves most easily" in contact.remarks[0]


# Calibrated scenes, and closed forms


def asked(e, stiffness, mass):
    """Duration and damping of a Kelvin-Voigt contact that ends at zero force (docs/theory.md, section 7)."""

    def loss(zeta):
        w = math.sqrt(1 - zeta * zeta)
        time = math.atan2(2 * zeta * w, 2 * zeta * zeta - 1) / w  # theory's form
        return math.exp(-zeta * time), time

    low, high = 0.0, 1 - 1e-12
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if loss(middle)[0] > e else (low, middle)
    omega = math.sqrt(stiffness / mass)
    return loss(low)[1] / omega, 2 * low * mass * omega


COLLISION = Collision(m1=1.0, m2=0.5, k1=1e6, k2=1e5, e1=0.5, e2=1.0)
REQUESTED = {1 / 3: (0.5, 1e6), 0.5: (1.0, 1e5)}


def pairs_of(name, collision=COLLISION, fraction=1e-3):
    """Contacts of the scene that an adapter makes of a collision, and its step."""
    column = column_of(collision, Settings(step_fraction=fraction))
    if name == "mujoco":
        return list(mujoco_meetings(compiled(mjcf(column)))), column
    found = at_first_step(
        lambda: get_solver(name).run_columns([column], 1), lambda *seen: list(pybullet_meetings(*seen))
    )
    return found, column


@pytest.mark.parametrize("name", ["mujoco", pytest.param("pybullet", marks=needs_pybullet)])
def test_contacts_of_a_calibrated_scene_are_those_that_were_asked_for(name):
    errors = {}
    for fraction in (2e-3, 1e-3):
        found, column = pairs_of(name, fraction=fraction)
        for mass, (e, stiffness) in REQUESTED.items():
            (meeting,) = (m for m in found if m.mass == pytest.approx(mass, rel=1e-9))
            assert meeting.step == pytest.approx(column.step, rel=1e-12)
            contact = inspect(meeting, 1.0)
            duration, damping = asked(e, stiffness, mass)
            # The first force comes late, by half a step at most; PyBullet's backward Euler loses at first order.
            late = meeting.step / duration
            allowed = late / 2 if name == "mujoco" else 6 * late
            assert contact.restitution == pytest.approx(e, abs=allowed)
            assert contact.duration == pytest.approx(duration, abs=(1 + (name == "pybullet")) * meeting.step)
            assert contact.stiffness == pytest.approx(stiffness, rel=0.02)
            assert contact.damping == pytest.approx(damping, abs=0.02 * math.sqrt(stiffness * mass))
            errors[fraction, mass] = contact.restitution - e
            if name == "pybullet":
                halved = contact.restitution_half_step - e
                assert halved == pytest.approx(errors[fraction, mass] / 2, rel=0.1)
    if name == "pybullet":
        for mass in REQUESTED:
            assert errors[2e-3, mass] == pytest.approx(2 * errors[1e-3, mass], rel=0.1)


def test_an_elastic_contact_of_mujoco_lasts_half_a_period():
    k, mass, step = 1e4, 0.5, 1e-4
    text = ON_FLOOR.format(
        **{"step": step, "height": 1, "upper": "", "lower": "", "option": "", "flag": ""},
        contact=f"<pair geom1='up' geom2='low' condim='1' solref='{-k / mass} -0' solimp='1e-4 1e-4 .001 .5 1'/>",
    )
    (contact,) = measured(text)
    assert contact.restitution == pytest.approx(1, abs=1e-4)
    assert contact.duration == pytest.approx(math.pi * math.sqrt(mass / k), abs=step / 8)
    assert contact.stiffness == pytest.approx(k, rel=2 * step / 8 / contact.duration + 2e-4)
    assert contact.damping == pytest.approx(0, abs=1e-3 * math.sqrt(k * mass))
    assert contact.remarks == ()
    assert contact.steps == pytest.approx(contact.duration / step)


# PyBullet


@dataclass
class Scene:
    """A ball of 0.1 m above a plane, or above another such ball, as a script makes it."""

    upper: dict
    lower: dict
    mass: float = 1.0
    two: bool = False
    step: float = 1 / 240
    maximal: int = 0
    substeps: int = 0

    def make(self, gap, speed, gravity=0.0):
        import pybullet as p

        client = p.connect(p.DIRECT)
        at = {"physicsClientId": client}
        whole = self.step * max(1, self.substeps)
        p.setPhysicsEngineParameter(
            fixedTimeStep=whole, numSubSteps=self.substeps, contactBreakingThreshold=0.02, **at
        )
        p.setGravity(0, 0, -gravity, **at)
        sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=0.1, **at)
        plane = p.createCollisionShape(p.GEOM_PLANE, **at)
        low = p.createMultiBody(
            self.two * 2.0,
            sphere if self.two else plane,
            basePosition=(0, 0, -0.1 * self.two),
            useMaximalCoordinates=self.maximal,
            **at,
        )
        up = p.createMultiBody(
            self.mass, sphere, basePosition=(0, 0, 0.1 + gap), useMaximalCoordinates=self.maximal, **at
        )
        for body, own in ((up, self.upper), (low, self.lower)):
            p.changeDynamics(body, -1, linearDamping=0, angularDamping=0, **at)
            if own:
                p.changeDynamics(body, -1, **own, **at)
        p.resetBaseVelocity(up, (0, 0, -speed), **at)
        return p, client, up, low

    def bounce(self, gap, speed, steps=3000):
        """Restitution by nothing but PyBullet."""
        p, client, up, low = self.make(gap, speed)
        rates = []
        for _ in range(steps):
            p.stepSimulation(client)
            rates.append(p.getBaseVelocity(up, client)[0][2] - p.getBaseVelocity(low, client)[0][2])
            if len(rates) > 20 and rates[-1] >= 0 and len(set(rates[-4:])) == 1:
                break
        p.disconnect(client)
        return rates[-1] / speed

    def inspect(self, speed):
        def script():
            p, client, *_ = self.make(1.0, speed)
            p.stepSimulation(client)

        (meeting,) = at_first_step(script, lambda *seen: list(pybullet_meetings(*seen)))
        return inspect(meeting, speed)


SPRING = {"contactStiffness": 2e4, "contactDamping": 30.0}
BOUNCY = {"restitution": 0.9}


@needs_pybullet
@pytest.mark.parametrize(("lower", "rebound"), [({}, 0.15), (BOUNCY, 2.43)], ids=["plane unset", "both"])
def test_two_scripts_of_pybullet_that_differ_in_the_plane_alone(lower, rebound):
    import pybullet as p

    def drop(**more):
        client = p.connect(p.DIRECT)
        p.setPhysicsEngineParameter(contactBreakingThreshold=0.02, physicsClientId=client)
        p.setGravity(0, 0, -9.81, physicsClientId=client)
        sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=0.1, physicsClientId=client)
        plane = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
        ball = p.createMultiBody(1, sphere, basePosition=(0, 0, 0.5), physicsClientId=client)
        floor = p.createMultiBody(0, plane, physicsClientId=client)
        p.changeDynamics(ball, -1, **BOUNCY, **more, physicsClientId=client)
        p.changeDynamics(floor, -1, **lower, physicsClientId=client)
        velocities = []
        for _ in range(240):
            p.stepSimulation(client)
            velocities.append(p.getBaseVelocity(ball, client)[0][2])
        p.disconnect(client)
        return -min(velocities), max(velocities)

    falls, rises = drop()
    assert (falls, rises) == (pytest.approx(2.80, abs=0.03), pytest.approx(rebound, abs=0.01))
    contact = Scene(BOUNCY, lower).inspect(2.80)
    low, high = contact.restitution_range
    assert low - 0.01 <= rises / falls <= high + 0.015
    # Without the damping of velocities it touches elsewhere in a step, which decides what comes back.
    falls, rises_there = drop(linearDamping=0)
    assert abs(rises_there - rises) > 0.1
    assert low - 0.01 <= rises_there / falls <= high + 0.015
    assert contact.steps < 2
    assert contact.stiffness is contact.damping is None
    assert "an impulse, which has no stiffness" in contact.remarks[0]


@needs_pybullet
@pytest.mark.parametrize(
    "scene",
    [
        Scene(BOUNCY, {}),
        Scene(BOUNCY, BOUNCY),
        Scene(BOUNCY, BOUNCY, two=True),
        Scene(SPRING, {}),
        Scene(SPRING, SPRING, two=True),
        Scene(SPRING | BOUNCY, SPRING | BOUNCY, step=1e-3),
        Scene(SPRING, SPRING, maximal=1),
        Scene(SPRING, {}, step=1e-3, substeps=4),
    ],
    ids=[
        "unset",
        "restitution",
        "two balls",
        "spring",
        "series",
        "spring and restitution",
        "maximal",
        "sub-steps",
    ],
)
def test_every_parameter_of_a_contact_is_that_of_the_script(scene):
    speed = 2.8
    contact = scene.inspect(speed)
    own = [scene.bounce(place * speed * scene.step, speed) for place in PLACES]
    assert contact.restitution == pytest.approx(np.mean(own), abs=1e-9)
    assert contact.restitution_range == pytest.approx((min(own), max(own)), abs=1e-9)
    scene.step /= 2
    half = [scene.bounce(place * speed * scene.step, speed) for place in PLACES]
    assert contact.restitution_half_step == pytest.approx(np.mean(half), abs=1e-9)
    assert contact.mass == pytest.approx(2 / 3 if scene.two else 1)


@needs_pybullet
@pytest.mark.parametrize("speed", [5e-324, 1e-300, 1e12, 1e300, 1.7e308])
def test_a_speed_that_pybullet_does_not_take_costs_no_exception(speed):
    contact = Scene(SPRING, {}).inspect(speed)
    numbers = (contact.restitution, contact.duration, contact.stiffness, contact.damping)
    assert all(number is None or math.isfinite(number) for number in numbers)
    assert (contact.status == "ok") == (contact.reason == "") == (contact.restitution is not None)


@needs_pybullet
def test_what_goes_wrong_at_the_first_step_is_not_for_the_script_to_catch():
    def script():
        import pybullet as p

        client = p.connect(p.DIRECT)
        for _ in range(3):
            try:
                p.stepSimulation(client)
            except Exception:
                pytest.fail("caught")

    with pytest.raises(ZeroDivisionError):
        at_first_step(script, lambda *_: 1 / 0)


@needs_pybullet
def test_the_damping_that_an_unset_plane_adds_is_measured():
    soft = {"contactStiffness": 10.0, "contactDamping": 0.0}
    contact = Scene(soft, {}, mass=0.1, step=1e-4).inspect(1.0)
    assert contact.damping == pytest.approx(0.1, rel=0.02)
    assert contact.stiffness == pytest.approx(10, rel=0.01)


@needs_pybullet
def test_what_a_client_before_left_behind_changes_nothing():
    scene = Scene(BOUNCY, BOUNCY)
    before = scene.inspect(2.8)
    column = column_of(COLLISION, Settings())
    get_solver("pybullet").run_columns([column], 100)  # sets the process's contactBreakingThreshold
    assert scene.inspect(2.8) == before


# What cannot be measured


def test_alike_pairs_are_one_kind():
    balls = "".join(
        f'<body pos="{3 * i} 0 1"><freejoint/><geom name="b{i}" size="1"/></body>' for i in range(4)
    )
    found = kinds(
        mujoco_meetings(
            compiled(f"<mujoco><worldbody><geom type='plane' size='1 1 1'/>{balls}</worldbody></mujoco>")
        )
    )
    assert [meeting.where for meeting in found] == [
        "geoms #0 and b0 and 3 more",
        "geoms b0 and b1 and 5 more",
    ]
    assert pickle.loads(pickle.dumps(found)) == found


@pytest.mark.parametrize("speed", [0, -1, math.inf, math.nan, True, "1"])
def test_a_speed_that_is_none_is_refused(speed):
    (meeting,) = mujoco_meetings(compiled(DROP))
    with pytest.raises(ValueError, match=r"speed = .*; legal: a finite number > 0 \(m/s\)"):
        inspect(meeting, speed)


@pytest.mark.parametrize("speed", [5e-324, 1e-300, 1e30, 1e300, 1.7e308])
def test_a_speed_that_an_engine_does_not_take_is_a_status(speed):
    (meeting,) = mujoco_meetings(compiled(DROP))
    contact = inspect(meeting, speed)
    assert contact.status in ("crashed", "unconverged")
    assert contact.reason
    assert contact.restitution is contact.stiffness is None


def test_a_contact_without_end_is_a_status():
    text = DROP.replace("<worldbody>", "<worldbody>").replace('mass="1"', 'mass="1" solref="-1e-3 -1e-9"')
    (contact,) = measured(text)
    assert (contact.status, contact.reason) == ("timeout", "not over after 20000 steps")
    # At half the step it would take too many.
    (contact,) = measured(text.replace("-1e-3", "-1e-2"))
    assert contact.status == "ok"
    assert contact.restitution_half_step is None
    assert contact.duration == pytest.approx(math.pi / 0.1, rel=0.1)


@needs_pybullet
def test_a_link_without_a_mass_of_its_own_is_a_status():
    meeting = replace(pairs_of("pybullet")[0][0], masses=(0.0, math.inf))
    contact = inspect(meeting)
    assert contact.status == "unrepresentable"
    assert "no mass of its own" in contact.reason


@dataclass(frozen=True)
class Broken(Meeting):
    rates: tuple = ()

    @contextmanager
    def engine(self):
        if not self.rates:
            raise RuntimeError("two\nlines")
        yield lambda speed, step, place: World(iter(self.rates), speed)


@dataclass
class World:
    rates: Iterator
    speed: float

    def step(self):
        pass

    def rate(self):
        return next(self.rates) * self.speed


@pytest.mark.parametrize(
    ("rates", "status", "reason"),
    [
        ((), "crashed", "two lines"),
        ((-1, math.nan), "crashed", "the engine gave no finite velocities after 2 steps"),
        ((-1,) * 30_000, "unconverged", "the bodies pass through each other, or never meet"),
        ((-1, *(0.1, -0.1) * 20_000), "timeout", "not over after 20000 steps"),
    ],
)
def test_what_an_engine_does_wrong_is_a_status(rates, status, reason):
    contact = inspect(Broken("x", (1.0, 1.0), 1e-3, (), rates))
    assert contact.status == status
    assert reason in contact.reason


def test_more_than_went_in_is_said():
    contact = inspect(Broken("x", (1.0, 1.0), 1e-3, (), (-1, -0.5, 0, 0.6, 1.2, 1.2, 1.2, 1.2)))
    assert contact.restitution == pytest.approx(1.2)
    assert contact.damping == 0
    assert contact.steps == 4
    assert contact.stiffness == pytest.approx(0.5 * (math.pi / 4e-3) ** 2)
    assert contact.remarks == ("more comes back than went in",)
