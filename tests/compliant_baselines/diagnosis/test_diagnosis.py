"""Each trap set, found by its name, and its effect measured in the engine."""

import math

import numpy as np
import pytest

from impact_xval.compliant_baselines.contact.column import column_of
from impact_xval.compliant_baselines.contact.mapping import restitution
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.diagnosis.diagnose_mujoco import diagnose_mujoco
from impact_xval.compliant_baselines.diagnosis.diagnose_pybullet import (
    diagnose_at_first_step,
    diagnose_pybullet,
)
from impact_xval.experiments.sweep.examination import column_findings
from impact_xval.model.collision import Collision

FORCE_LEVEL = "1e-4 1e-4 .001 .5 1"
DEFAULT = ".9 .95 .001 .5 2"
STIFF, DURATION = 1e6, math.pi / 1e3  # 1/s^2, and how long an elastic contact of it lasts


def traps(findings):
    return {finding.trap for finding in findings}


# MuJoCo: a sphere of 1 m on a free joint that meets a plane


def mujoco_scene(pair=None, ball="", floor="", option="", flag="", mass=1.0, step=1e-5, gap=0.0):
    import mujoco

    contact = (
        "" if pair is None else f'<contact><pair geom1="floor" geom2="ball" condim="1" {pair}/></contact>'
    )
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco><option timestep="{step}" gravity="0 0 0" {option}><flag {flag}/></option><worldbody>
      <geom name="floor" type="plane" size="1 1 1" {floor}/>
      <body pos="0 0 {1 + gap}"><freejoint/><geom name="ball" size="1" mass="{mass}" {ball}/></body>
    </worldbody>{contact}</mujoco>""")


def bounce(model, speed=1.0):
    """Restitution and duration of the contact, in steps with a contact."""
    import mujoco

    data = mujoco.MjData(model)
    data.qvel[2] = -speed
    touching = 0
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        for _ in range(200_000):
            mujoco.mj_step(model, data)
            touching += data.ncon > 0
            if touching and data.ncon == 0:
                break
    finally:
        mujoco.set_mju_user_warning(before)
    return data.qvel[2] / speed, touching * model.opt.timestep


def test_a_sound_scene_has_no_traps_and_bounces_as_asked():
    model = mujoco_scene(f'solref="-{STIFF} -0" solimp="{FORCE_LEVEL}"')
    assert diagnose_mujoco(model) == []
    assert bounce(model) == (pytest.approx(1, abs=1e-3), pytest.approx(DURATION, rel=0.01))


def test_mixed_signs_select_the_default():
    model = mujoco_scene(f'solref="-{STIFF} 100" solimp="{FORCE_LEVEL}"')
    (finding,) = diagnose_mujoco(model)
    assert finding.trap == "mixed-signs"
    assert "the default (0.02, 1) replaces it" in finding.says
    assert bounce(model) == bounce(mujoco_scene(f'solref="0.02 1" solimp="{FORCE_LEVEL}"'))
    assert bounce(model)[1] > 10 * DURATION


def test_refsafe_replaces_a_short_time_constant():
    asked, step = f'solref="0.02 0.2" solimp="{FORCE_LEVEL}"', 0.015
    model = mujoco_scene(asked, step=step)
    assert "refsafe" in traps(diagnose_mujoco(model))
    as_if = mujoco_scene(asked.replace("0.02 0.2", "0.03 0.2"), step=step)
    assert bounce(model) == bounce(as_if)
    free = mujoco_scene(asked, step=step, flag='refsafe="disable"')
    assert "refsafe" not in traps(diagnose_mujoco(free))
    assert bounce(free) != bounce(as_if)
    assert "refsafe" not in traps(diagnose_mujoco(mujoco_scene(asked, step=0.001)))


def test_the_discrete_integrator_takes_restitution_away():
    pair = f'solref="-{STIFF} -0" solimp="{FORCE_LEVEL}"'
    model = mujoco_scene(pair, option='integrator="discrete"', step=DURATION / 32)
    assert traps(diagnose_mujoco(model)) == {"discrete"}
    assert bounce(model)[0] < 0.9
    assert bounce(mujoco_scene(pair, step=DURATION / 32))[0] == pytest.approx(1, abs=0.01)


def test_direct_numbers_are_not_newton_per_metre():
    light, heavy = (
        mujoco_scene(f'solref="-{STIFF} -0" solimp="{DEFAULT}"', mass=mass, step=1e-6) for mass in (1.0, 4.0)
    )
    (finding,) = diagnose_mujoco(heavy)
    assert finding.trap == "not-newton-per-metre"
    assert "this pair has 4e+06 N/m at most" in finding.says
    # In N/m a mass four times as large would take twice as long.
    assert bounce(heavy)[1] == pytest.approx(bounce(light)[1], rel=1e-6)
    assert bounce(heavy)[1] == pytest.approx(DURATION, rel=0.06)


def test_direct_numbers_of_two_geoms_are_mixed_element_by_element():
    both = f'solimp="{FORCE_LEVEL}"'
    model = mujoco_scene(ball=f'solref="-{STIFF} -0" {both}', floor=f'solref="-1e4 -600" {both}')
    findings = diagnose_mujoco(model)
    assert traps(findings) == {"mixed-geoms"}
    assert "combined to (-1000000.0, -600.0)" in findings[0].says
    as_if = mujoco_scene(f'solref="-{STIFF} -600" {both}')
    assert bounce(model) == (
        pytest.approx(bounce(as_if)[0], abs=1e-3),
        pytest.approx(bounce(as_if)[1], rel=0.01),
    )
    assert bounce(model)[0] < 0.6  # either alone: 1, or slow


def test_the_override_flag_replaces_every_contact():
    model = mujoco_scene(
        f'solref="-{STIFF} -0" solimp="{FORCE_LEVEL}"',
        option=f'o_solref="0.02 1" o_solimp="{FORCE_LEVEL}"',
        flag='override="enable"',
    )
    assert "override" in traps(diagnose_mujoco(model))
    assert bounce(model) == bounce(mujoco_scene(f'solref="0.02 1" solimp="{FORCE_LEVEL}"'))


def test_an_absolute_tolerance_under_cg_loses_a_soft_contact():
    pair = f'solref="-1e-6 -0.000244" solimp="{FORCE_LEVEL}"'  # accelerations of 1e-3 m/s^2
    model = mujoco_scene(pair, option='solver="CG"', step=30.0)
    assert traps(diagnose_mujoco(model)) == {"tolerance"}
    sound = mujoco_scene(pair, step=30.0)
    assert diagnose_mujoco(sound) == []
    assert bounce(sound)[0] == pytest.approx(0.7, abs=0.01)
    assert bounce(model)[0] > bounce(sound)[0] + 0.1
    exact = mujoco_scene(pair, option='solver="CG" tolerance="0"', step=30.0)
    assert diagnose_mujoco(exact) == []
    assert bounce(exact)[0] == pytest.approx(bounce(sound)[0], abs=1e-4)


def test_a_step_too_long_for_the_stiffest_contact():
    def model(step, damping=0.0, gap=0.3):
        pair = f'solref="-{STIFF} -{damping}" solimp="{FORCE_LEVEL}"'
        return mujoco_scene(pair, step=step, gap=gap * step)

    assert traps(diagnose_mujoco(model(DURATION / 3))) == {"long-step"}
    assert bounce(model(DURATION / 2, gap=0.7))[0] > 1.1  # it creates energy
    assert diagnose_mujoco(model(DURATION / 40)) == []
    # what a heavy dashpot needs is a shorter step than the spring's
    assert traps(diagnose_mujoco(model(DURATION / 40, 2e4))) == {"long-step"}


def test_where_no_long_step_is_found_the_restitution_is_within_ten_percent():
    for zeta in (0.0, 0.1, 0.3, 0.6):
        pair = f'solref="-{STIFF} -{2e3 * zeta}" solimp="{FORCE_LEVEL}"'
        exact = bounce(mujoco_scene(pair, step=1e-6))[0]
        for steps in (31, 60):
            for gap in np.linspace(0, 1, 5):
                model = mujoco_scene(pair, step=DURATION / steps, gap=gap * DURATION / steps)
                assert diagnose_mujoco(model) == []
                assert bounce(model)[0] == pytest.approx(exact, rel=0.1), (zeta, steps, gap)


def test_a_trap_of_many_contacts_is_told_once_and_static_ones_not_at_all():
    import mujoco

    balls = "".join(
        f'<body pos="{3 * i} 0 1"><freejoint/><geom size="1" solref="-1 1"/></body>' for i in range(5)
    )
    walls = '<geom type="box" size="1 1 1"/><geom type="plane" size="1 1 1"/>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{walls}{balls}</worldbody></mujoco>")
    findings = diagnose_mujoco(model)
    assert len(findings) == len({(f.trap, f.says) for f in findings})
    assert "mixed-signs" in traps(findings)
    still = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{walls}</worldbody></mujoco>")
    assert diagnose_mujoco(still) == []


# PyBullet: a sphere of 1 m that meets a plane


class Bullet:
    """A client with a ball of 1 m above a plane, everything sound unless asked otherwise."""

    def __init__(self, ball=(STIFF, 0.0), plane=(1e30, 0.0), step=1e-5, slop=0.0, restitution=0.0, mass=1.0):
        self.p = p = pytest.importorskip("pybullet")
        self.client = p.connect(p.DIRECT)
        self.at = {"physicsClientId": self.client}
        self.parameters = {"fixedTimeStep": step, "solverResidualThreshold": 0}
        if slop is not None:
            self.parameters["contactSlop"] = slop
        p.setPhysicsEngineParameter(**self.parameters, **self.at)
        sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=1, **self.at)
        floor = p.createCollisionShape(p.GEOM_PLANE, **self.at)
        self.plane = p.createMultiBody(0, floor, **self.at)
        self.ball = p.createMultiBody(mass, sphere, basePosition=(0, 0, 1), **self.at)
        for body, own in ((self.ball, ball), (self.plane, plane)):
            p.changeDynamics(body, -1, linearDamping=0, angularDamping=0, restitution=restitution, **self.at)
            if own is not None:
                p.changeDynamics(body, -1, contactStiffness=own[0], contactDamping=own[1], **self.at)
        self.step = step

    def findings(self):
        return diagnose_pybullet(self.client, self.parameters)

    def bounce(self, speed=1.0, steps=200_000):
        """Restitution, duration in steps with force, and how deep the ball is where forces begin, in m."""
        p = self.p
        p.resetBaseVelocity(self.ball, (0, 0, -speed), **self.at)
        before, loaded, begins = -speed, 0, None
        for _ in range(steps):
            z = p.getBasePositionAndOrientation(self.ball, **self.at)[0][2]
            p.stepSimulation(**self.at)
            v = p.getBaseVelocity(self.ball, **self.at)[0][2]
            if abs(v - before) > 1e-12 * speed:
                loaded, begins = loaded + 1, 1 - z if begins is None else begins
            elif loaded:
                break
            before = v
        p.disconnect(**self.at)
        return before / speed, loaded * self.step, begins


def test_a_sound_client_has_no_traps():
    sound = Bullet()
    assert sound.findings() == []
    e, duration, _ = sound.bounce()
    assert (e, duration) == (pytest.approx(0.984, abs=1e-3), pytest.approx(DURATION, rel=0.01))


def test_an_unset_body_adds_a_damping_of_its_own():
    soft = {"ball": (10.0, 0.0), "mass": 0.1, "step": 1e-4}
    unset = Bullet(**soft, plane=None)
    assert traps(unset.findings()) == {"unset-body"}
    lost = unset.bounce()[0]
    # 0.1 N s/m: zeta = 0.1/(2 sqrt(k m)) = 0.05, e = exp(-zeta ...) of a contact that ends at zero force
    assert lost == pytest.approx(restitution(0.05), abs=2e-3)
    assert Bullet(**soft).bounce()[0] > 0.995


def test_two_unset_bodies_have_no_stiffness_at_all():
    bare = Bullet(ball=None, plane=None)
    assert traps(bare.findings()) == {"no-stiffness"}
    assert bare.bounce()[0] == pytest.approx(0, abs=1e-6)


def test_two_stiffnesses_are_in_series():
    soft = Bullet(plane=(STIFF, 0.0))
    (finding,) = soft.findings()
    assert finding.trap == "series"
    assert "1e+06 and 1e+06 N/m in series are 500000 N/m" in finding.says
    assert soft.bounce()[1] == pytest.approx(2**0.5 * DURATION, rel=0.01)


def test_contact_slop_lets_bodies_in_before_there_is_a_force():
    slack = Bullet(slop=None, step=1e-7)
    assert traps(slack.findings()) == {"slop"}
    assert "contactSlop" in diagnose_pybullet(slack.client)[0].where  # not known: said to be so
    assert "cannot be read from a client" in diagnose_pybullet(slack.client)[0].says
    assert slack.bounce(speed=0.1, steps=40_000)[2] == pytest.approx(1e-5, abs=2e-7)
    assert Bullet(step=1e-7).bounce(speed=0.1, steps=40_000)[2] == pytest.approx(0, abs=2e-7)


def test_a_restitution_acts_beside_the_stiffness():
    both = Bullet(restitution=0.9, ball=(STIFF, 800.0))
    assert traps(both.findings()) == {"restitution"}
    assert abs(both.bounce()[0] - Bullet(ball=(STIFF, 800.0)).bounce()[0]) > 1e-3


def test_a_step_too_long_for_the_stiffest_contact_of_a_client():
    long = Bullet(step=DURATION / 5)
    assert traps(long.findings()) == {"long-step"}
    assert long.bounce()[0] < 0.7
    half = Bullet(step=DURATION / 20)
    assert traps(half.findings()) == {"long-step"}
    half.p.setPhysicsEngineParameter(fixedTimeStep=DURATION / 20, numSubSteps=10, **half.at)
    assert half.findings() == []
    half.p.disconnect(**half.at)


def test_a_script_is_examined_at_its_first_step_and_no_further():
    p = pytest.importorskip("pybullet")
    untold, reached = [], []

    def script():
        import pybullet as q

        at = {"physicsClientId": q.connect(q.GUI)}  # no window is opened
        q.setPhysicsEngineParameter(fixedTimeStep=1e-4, **at)
        for mass, shape in ((1, {"radius": 1, "shapeType": q.GEOM_SPHERE}), (0, {"shapeType": q.GEOM_PLANE})):
            body = q.createMultiBody(
                mass, q.createCollisionShape(**shape, **at), useMaximalCoordinates=1, **at
            )
            q.changeDynamics(body, linkIndex=-1, contactStiffness=1e3, contactDamping=0, **at)
            q.changeDynamics(body, -1, restitution=0.9, **at)
        untold.append(traps(diagnose_pybullet(at["physicsClientId"])))
        q.stepSimulation(**at)
        reached.append("went on")

    # what a client does not tell is known where the calls were seen
    assert traps(diagnose_at_first_step(script) or []) == {"series", "slop", "restitution"}
    assert (untold, reached) == ([{"unreadable"}], [])
    assert not p.isConnected(0)  # what the script left connected is given back


def test_our_own_scenes_have_none(engine):
    c = Collision(m1=1.0, m2=0.5, k1=1e8, k2=1e5, e1=0.5, e2=1.0)
    for scenario in ("impact", "drop"):
        assert column_findings(engine, column_of(c, Settings(scenario=scenario))) == []
    naive = traps(column_findings(engine, column_of(c, Settings(mapping="naive"))))
    assert naive == ({"not-newton-per-metre"} if engine.name == "mujoco" else {"series"})
