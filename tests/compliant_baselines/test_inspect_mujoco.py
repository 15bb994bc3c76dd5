"""Contacts in MuJoCo scenes: measurements compared with closed forms and with drops in the user's own scene.

A trap is a parameter whose effect users do not expect. For each trap that `inspect` names, the effect that the message
states is compared with a simulation.
"""

import math

import mujoco
import numpy as np
import pytest

from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.inspect_mujoco import (
    PLACES,
    examine_groups,
    examine_model,
    inspect_model,
    measure_model,
    read_contacts,
)
from impact_xval.compliant_baselines.inspect_mujoco.readings import round_solref
from impact_xval.compliant_baselines.inspect_mujoco.traps import looks_like_restitution
from impact_xval.compliant_baselines.mapping import KelvinVoigtContact
from impact_xval.compliant_baselines.paste import mjcf_of_scenes
from impact_xval.compliant_baselines.restitution import contact_time
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision

FORCE_LEVEL = "1e-4 1e-4 .001 .5 1"
SOFT = 'solref="-4e3 -10" solimp=".3 .6 .01 .5 2"'

VERSION = tuple(map(int, mujoco.__version__.split(".")[:2]))
TOLERANCE_LETS_GO = pytest.mark.skipif(
    VERSION < (3, 11), reason="from 3.11 on solvers may end without an iteration"
)
DISCRETE = pytest.mark.skipif(VERSION < (3, 13), reason="from 3.13 on")

#: Templates of scenes: a ball of 0.5 kg above a floor, and above a free ball of 2 kg.
ON_FLOOR = """<mujoco><option timestep="{step}" gravity="0 0 {g}" {option}><flag {flag}/></option><worldbody>
<geom name="low" type="plane" size="1 1 1" {lower}/>
<body name="up" pos="0 0 {height}"><freejoint/><geom name="up" size="0.2" mass="0.5" {upper}/></body>
</worldbody><contact>{contact}</contact></mujoco>"""
ON_BALL = ON_FLOOR.replace(
    '<geom name="low" type="plane" size="1 1 1" {lower}/>',
    '<body name="low" pos="0 0 -.3"><freejoint/><geom name="low" size=".3" mass="2" {lower}/></body>',
)


def compiled(scene=ON_FLOOR, **fields):
    empty = {"option": "", "flag": "", "lower": "", "upper": "", "contact": ""}
    return mujoco.MjModel.from_xml_string(
        scene.format(**empty | {"step": 2e-3, "g": 0, "height": 1} | fields)
    )


def hand_drops(scene, speed, margin=0.0, **fields):
    """Return restitutions simulated in the user's own scene, for each place within a step at which bodies touch."""
    found = []
    for place in PLACES:
        model = compiled(scene, height=0.2 + margin + place * speed * fields["step"], **fields)
        data = mujoco.MjData(model)
        up, low = model.body("up").dofadr[0] + 2, model.body("low").dofadr[0] + 2 if model.nv > 6 else None
        data.qvel[up], met = -speed, False
        for _ in range(4000):
            mujoco.mj_step(model, data)
            rate = data.qvel[up] - (0 if low is None else data.qvel[low])
            met |= abs(rate + speed) > 1e-9 * speed
            if met and rate > 0 and not data.efc_force.any():
                break
        found.append(rate / speed)
    return found


def test_mujocos_default_ball_that_falls_at_2_80_rebounds_with_0_37():
    model = compiled(g=-9.81, height=0.6)
    data, velocities = mujoco.MjData(model), []
    for _ in range(400):
        mujoco.mj_step(model, data)
        velocities.append(data.qvel[2])
    assert min(velocities) == pytest.approx(-2.80, abs=0.01)
    assert max(velocities) == pytest.approx(0.37, abs=0.005)
    (row,) = measure_model(model, speed=2.80)
    low, high = row.restitution_range
    assert low <= max(velocities) / -min(velocities) <= high < low + 0.03
    assert data.qpos[2] == pytest.approx(0.2 - row.penetration, abs=1e-6)  # by then the ball has come to rest
    assert (
        f"(0.02, 1) is a damping ratio, not a restitution: 1 rebounds with {low:.3g} to {high:.3g}."
        in row.change
    )


@pytest.mark.parametrize(("scene", "mass"), [(ON_FLOOR, 0.5), (ON_BALL, 0.4)], ids=["floor", "ball"])
@pytest.mark.parametrize(("e", "k"), [(1.0, 1e4), (0.7, 1e4), (0.3, 1e6)])
def test_a_force_level_contact_is_that_of_the_closed_form(scene, mass, e, k):
    asked = KelvinVoigtContact.from_restitution(k, e, mass)
    pair = f'<pair geom1="up" geom2="low" solref="{-k / mass} {-asked.c / mass}" condim="1" solimp="{FORCE_LEVEL}"/>'
    (row,) = measure_model(compiled(scene, contact=pair, step=asked.duration / 200, g=-9.81))
    assert row.masses == (0.5, math.inf if scene is ON_FLOOR else 2)
    assert row.restitution == pytest.approx(e, abs=2e-3)
    assert (row.duration, row.steps) == (pytest.approx(asked.duration, rel=5e-3), pytest.approx(200, abs=1))
    assert row.stiffness == pytest.approx(k, rel=1.2e-2)
    assert row.damping == pytest.approx(asked.c, abs=1.2e-2 * math.sqrt(k * mass))
    # the depth under the weight of the lighter body
    assert row.penetration == pytest.approx(0.5 * 9.81 / k * (1 - 1e-4), rel=1e-7)
    assert row.change == ""


@pytest.mark.parametrize("scene", [ON_FLOOR, ON_BALL], ids=["floor", "ball"])
@pytest.mark.parametrize(
    ("fields", "margin"),
    [
        ({"upper": SOFT + " solmix='5'", "lower": "solref='-1e3 -40' solmix='1'"}, 0.0),
        ({"upper": "solref='.05 .3' solmix='5'", "lower": "solref='.03 .2' condim='6'"}, 0.0),
        ({"upper": "friction='2 .1 .1'", "option": "solver='CG' cone='elliptic' impratio='3'"}, 0.0),
        pytest.param(
            {"lower": SOFT + " priority='1'", "option": "integrator='discrete'"}, 0.0, marks=DISCRETE
        ),
        ({"upper": SOFT, "flag": "override='enable'", "option": "o_solref='.02 .4' integrator='RK4'"}, 0.0),
        ({"contact": "<pair geom1='up' geom2='low' condim='1' margin='-.01'/>"}, -0.01),
    ],
)
def test_a_measured_contact_is_that_of_the_users_scene(scene, fields, margin):
    own = hand_drops(scene, 0.7, margin, step=2e-3, **fields)
    (row,) = measure_model(compiled(scene, **fields), speed=0.7)
    assert row.restitution == pytest.approx(np.mean(own), abs=2e-6)
    assert row.restitution_range == pytest.approx((min(own), max(own)), abs=2e-6)
    assert row.penetration is None  # without gravity there is no depth at rest


@pytest.mark.parametrize("friction", ["1 1 .005", "0.3 0.3 .005"])
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("condim", [1, 3, 6])
def test_each_proposed_pair_has_the_restitution_it_states(condim, cone, friction):
    wrong, meant = (
        f'solref="-1e4 -20" condim="{condim}" friction="{friction}"',
        KelvinVoigtContact(1e4, 20.0, 0.5),
    )
    option = f"cone='{cone}'"
    floor = f'friction="{friction}"'  # MuJoCo uses the larger friction of the two geoms
    model = compiled(upper=wrong, lower=floor, option=option)
    ((contact,),) = (group.examined for group in examine_groups(model).groups)
    assert contact.row.stiffness < 0.6 * meant.k
    assert contact.newton_metre.restitution == pytest.approx(meant.restitution)
    assert contact.keep.restitution == pytest.approx(contact.row.restitution, rel=1e-9)
    assert (contact.newton_metre.condim, contact.keep.condim) == (max(3, condim), max(3, condim))
    for reading in contact.keep, contact.newton_metre:
        assert reading.is_kept
        pair = reading.pair.replace("<pair", '<pair geom1="up" geom2="low"')
        fields = {"step": reading.step, "upper": wrong, "lower": floor, "contact": pair, "option": option}
        assert np.mean(hand_drops(ON_FLOOR, 1.0, **fields)) == pytest.approx(reading.restitution, abs=0.005)
        (row,) = measure_model(compiled(**fields))
        assert row.stiffness == pytest.approx(reading.stiffness, rel=0.02)
        # the measurement agrees with the numbers in the scene, so no change is proposed
        assert row.change == ""


def test_what_cannot_be_measured_is_a_row_with_the_reason():
    for upper, reason in (
        ("solref='0 0' priority='1'", "no force within 20000 steps"),
        ("solref='-1e-3 0' priority='1'", "not over within 20000 steps"),
    ):
        (row,) = measure_model(compiled(upper=upper))
        assert reason in row.reason
        assert row.restitution is row.stiffness is row.penetration is None


def test_contacts_are_those_that_the_filters_let_through():
    text = """<mujoco><worldbody>
    <geom type="plane" size="1 1 1"/><geom type="plane" size="1 1 1"/><geom name="ghost" size="1" contype="0"/>
    <body><freejoint/><geom size="1"/><geom size="2"/>
      <body><joint/><geom size="3"/><body name="c"><joint/><geom size="4"/></body></body></body>
    <body><freejoint/><geom name="d" size="5" contype="2" conaffinity="4"/></body>
    <body name="e"><freejoint/><geom size="6"/></body></worldbody>
    <contact><exclude body1="e" body2="c"/><pair name="named" geom1="ghost" geom2="d"/></contact></mujoco>"""
    # No contact: two fixed geoms, geoms whose contype and conaffinity do not match, a body and its parent, and bodies
    # that <exclude> names.
    fixed = {f"geoms {floor} and #{geom}" for floor in ("#0", "#1", "ghost") for geom in (3, 4, 5, 6, 8)}
    moving = {f"geoms #{a} and #{b}" for a, b in ((3, 6), (4, 6), (3, 8), (4, 8), (5, 8))}
    found = read_contacts(mujoco.MjModel.from_xml_string(text)).values()
    assert {name for names in found for name in names} == {"pair named"} | fixed | moving


def test_a_pendulum_counts_with_the_mass_that_strikes():
    text = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 5"><joint axis="0 1 0"/>
    <inertial pos="2 0 0" mass="0.3" diaginertia="1e-8 1e-8 1e-8"/><geom size="0.1" pos="2 0 0"/></body>
    </worldbody></mujoco>"""
    (row,) = measure_model(mujoco.MjModel.from_xml_string(text))
    assert row.masses == (pytest.approx(0.3, rel=1e-6), math.inf)


DEFAULT = ".9 .95 .001 .5 2"
# solref of an elastic contact, and the duration of that contact in s
ELASTIC, DURATION = "-1e6 -0", math.pi / 1e3
OVERRIDE = {"option": f'o_solref="0.02 1" o_solimp="{FORCE_LEVEL}"', "flag": 'override="enable"'}


def found(model):
    return {finding.trap: finding.message for finding in inspect_model(model)}


def ball_on_plane(solref, solimp=FORCE_LEVEL, floor=None, mass=0.5, step=1e-5, **how):
    """Compile a scene of a ball above a floor; `floor` is the floor's solref, by default the ball's."""
    ours, theirs = (f'condim="1" solref="{each}" solimp="{solimp}"' for each in (solref, floor or solref))
    scene = ON_FLOOR.replace('mass="0.5"', f'mass="{mass}"')
    return compiled(scene, upper=ours, lower=theirs, step=step, **how)


def bounce(model):
    (row,) = measure_model(model)
    return row.restitution, row.duration


@pytest.mark.parametrize(
    ("trap", "says", "acting", "asked"),
    [
        ("mixed-signs", "the default (0.02, 1) replaces it", "0.02 1", {"solref": "-1e6 100"}),
        ("refsafe", "a stiffness 2.25 times lower", "0.03 0.2", {"solref": "0.02 0.2", "step": 0.015}),
        ("override", "every contact has solref (0.02, 1.0)", "0.02 1", {"solref": ELASTIC} | OVERRIDE),
    ],
)
def test_parameters_are_replaced(trap, says, acting, asked):
    model = ball_on_plane(**asked)
    assert says in found(model)[trap]
    assert bounce(model) == bounce(ball_on_plane(acting, step=asked.get("step", 1e-5)))
    assert trap == "refsafe" or bounce(model)[1] > 9 * DURATION


def test_refsafe_may_be_disabled_and_leaves_long_time_constants():
    for more in ({"step": 0.015, "flag": 'refsafe="disable"'}, {"step": 0.001}):
        assert "refsafe" not in found(ball_on_plane("0.02 0.2", **more))


@DISCRETE
def test_the_discrete_integrator_takes_restitution_away():
    model = ball_on_plane(ELASTIC, option='integrator="discrete"', step=DURATION / 32)
    assert set(found(model)) == {"discrete"}
    assert bounce(model)[0] < 0.9
    assert bounce(ball_on_plane(ELASTIC, step=DURATION / 32))[0] == pytest.approx(1, abs=0.01)


def test_direct_numbers_are_not_newton_per_metre():
    light, heavy = (ball_on_plane(ELASTIC, DEFAULT, mass=mass, step=1e-6) for mass in (1.0, 4.0))
    assert "Two bodies alone get at most 4e+06 N/m. " in found(heavy)["not-newton-per-metre"]
    assert len(found(heavy)) == 1
    # If solref were in N/m, a mass four times as large would double the duration.
    assert bounce(heavy)[1] == pytest.approx(bounce(light)[1], rel=1e-6)
    assert bounce(heavy)[1] == pytest.approx(DURATION, rel=0.06)


def test_direct_numbers_of_two_geoms_are_mixed_element_by_element():
    model = ball_on_plane(ELASTIC, floor="-1e4 -600")
    assert set(found(model)) == {"mixed-geoms"}
    assert "combined to (-1000000.0, -600.0)" in found(model)["mixed-geoms"]
    restitution, duration = bounce(ball_on_plane("-1e6 -600"))
    assert bounce(model) == (pytest.approx(restitution, abs=1e-3), pytest.approx(duration, rel=0.01))
    assert bounce(model)[0] < 0.6  # either solref alone gives e = 1 or a slower contact


@TOLERANCE_LETS_GO
def test_the_tolerance_under_cg_loses_a_soft_contact():
    # the contact accelerates by about 1e-3 m/s^2 only
    soft = f'condim="1" solref="-1e-6 -0.000244" solimp="{FORCE_LEVEL}"'
    fields = {"upper": soft, "lower": soft, "step": 30.0}
    options = "", 'solver="CG"', 'solver="CG" tolerance="0"'
    traps = [examine_model(compiled(option=option, **fields))[1] for option in options]
    assert [[each.trap for each in of_option] for of_option in traps] == [[], ["tolerance"], []]
    sound, lost, exact = (np.mean(hand_drops(ON_FLOOR, 1.0, option=option, **fields)) for option in options)
    assert sound == pytest.approx(0.7, abs=0.01)
    assert lost > sound + 0.1
    assert exact == pytest.approx(sound, abs=1e-4)


def test_a_step_too_long_for_the_stiffest_contact():
    third, half, short = (ball_on_plane(ELASTIC, step=DURATION / steps) for steps in (3, 2, 40))
    assert set(found(third)) == set(found(half)) == {"long-step"}
    assert measure_model(half)[0].restitution_range[1] > 1.1  # so long a step creates energy
    assert found(short) == {}
    # a strong dashpot needs a shorter step than the spring
    assert set(found(ball_on_plane("-1e6 -2e4", step=DURATION / 40))) == {"long-step"}


def test_where_no_long_step_is_found_the_restitution_is_within_ten_percent():
    for zeta in (0.0, 0.1, 0.3, 0.6):
        solref = f"-1e6 -{2e3 * zeta}"
        exact, pressed = bounce(ball_on_plane(solref, step=1e-6))[0], DURATION * contact_time(zeta) / np.pi
        for steps in (31, 60):
            model = ball_on_plane(solref, step=pressed / steps)
            assert found(model) == {}
            assert measure_model(model)[0].restitution_range == pytest.approx((exact, exact), rel=0.1)


def test_scenes_of_the_adapter_have_no_unexpected_traps():
    c = Collision.two_balls(m1=1.0, m2=0.5, k1=1e8, k2=1e5, e1=0.5, e2=1.0)
    for settings, traps in (
        ({"scenario": "impact"}, set()),
        ({"scenario": "drop"}, set()),
        ({"mapping": "naive"}, {"not-newton-per-metre"}),
    ):
        (text,) = mjcf_of_scenes([Scene.of(c, Settings(**settings))])
        assert set(found(mujoco.MjModel.from_xml_string(text))) == traps


#: Template of a scene: a ball of 1e-6 kg above a ball of 1e4 kg. `ZETA_022` is their contact, which lasts 0.1 s.
LIGHT_ON_HEAVY = ON_BALL.replace('mass="0.5"', 'mass="1e-6"').replace('mass="2"', 'mass="1e4"')
ZETA_022 = {
    "contact": f'<pair geom1="up" geom2="low" condim="1" solref="-1e3 -13.9" solimp="{FORCE_LEVEL}"/>',
    "step": 8e-4,
}


@TOLERANCE_LETS_GO
@pytest.mark.parametrize("solver", ["Newton", "CG"])
def test_a_tolerance_that_makes_a_contact_create_energy_is_found_and_measured_as_in_the_scene(solver):
    fields = ZETA_022 | {"option": f'solver="{solver}"'}
    drops = hand_drops(LIGHT_ON_HEAVY, 0.1, **fields)
    assert min(drops) > 2
    (row,), traps = examine_model(compiled(LIGHT_ON_HEAVY, **fields), speed=0.1)
    assert row.restitution_range == pytest.approx((min(drops), max(drops)), abs=1e-6)
    assert [trap.trap for trap in traps] == ["tolerance", "gains-energy"]
    exact = fields | {"option": f'solver="{solver}" tolerance="0"'}
    e = np.mean(hand_drops(LIGHT_ON_HEAVY, 0.1, **exact))
    assert f"with tolerance 0 e = {e:.4g} in " in traps[0].message
    assert 'solimp="0.0001 0.0001 0.001 0.5 1"/> with <option tolerance="0"/> and a step' in row.change
    (row,), traps = examine_model(compiled(LIGHT_ON_HEAVY, **exact), speed=0.1)
    assert row.restitution == pytest.approx(e, abs=1e-6)
    assert traps == []


@pytest.mark.parametrize("island", ["enable", "disable"])
def test_without_islands_bodies_far_away_decide_what_the_tolerance_lets_go(island):
    far = '<body pos="9 0 9"><freejoint/><geom size="1" mass="1e6"/></body></worldbody>'
    fields = ZETA_022 | {"flag": f'island="{island}"'}
    scene = LIGHT_ON_HEAVY.replace("</worldbody>", far)
    drops = hand_drops(scene, 0.1, **fields)
    row = measure_model(compiled(scene, **fields), speed=0.1)[0]
    assert row.restitution_range == pytest.approx((min(drops), max(drops)), rel=1e-6)


def test_an_e_above_1_is_a_trap_by_itself():
    _, traps = examine_model(ball_on_plane(ELASTIC, step=DURATION / 2))
    assert [trap.trap for trap in traps] == ["long-step", "gains-energy"]
    for steps in (31, 40, 112):
        assert examine_model(ball_on_plane(ELASTIC, step=DURATION / steps))[1] == []


def test_a_proposal_that_does_not_keep_its_promise_is_a_trap():
    # In N/m and N s/m the contact would give e = 0.74, but the slide takes half of that away.
    slide = ON_FLOOR.replace("<freejoint/>", '<joint type="slide" axis="0 0 1" damping="20"/>')
    (row,), traps = examine_model(compiled(slide, upper='solref="-1e4 -15"', step=1e-4))
    assert "gives e =" in row.change
    unkept = [trap.message for trap in traps if trap.trap == "unkept"]
    assert any("newton-metre: the pair proposed gives e = " in message for message in unkept)
    _, traps = examine_model(compiled(upper='solref="-1e4 -15"', step=1e-4))
    assert "unkept" not in {trap.trap for trap in traps}


def joint_drops(model, speed, places):
    """Return restitutions of a body on a slide, for each place within a step at which it touches.

    A restitution is the speed after the last step with contact force over the speed before the touch.
    """
    found = []
    for place in places:
        data = mujoco.MjData(model)
        data.qpos[0], data.qvel[0] = place * speed * model.opt.timestep, -speed
        approach = rebound = None
        for _ in range(5_000):
            before = float(data.qvel[0])
            mujoco.mj_step(model, data)
            if data.ncon and approach is None:
                approach = before
            if data.ncon and data.efc_force[data.contact[0].efc_address] > 0:
                rebound = float(data.qvel[0])
        found.append(-rebound / approach)
    return found


@pytest.mark.parametrize("losses", ['damping="2"', 'frictionloss="8"', 'damping="1" frictionloss="4"'])
def test_damping_and_dry_friction_of_a_joint_are_in_the_measurement(losses):
    text = f"""<mujoco><option timestep="2e-4" gravity="0 0 0"/><worldbody><geom name="low" type="plane" size="1 1 1"/>
    <body pos="0 0 .1"><joint type="slide" axis="0 0 1" {losses}/><geom name="up" size=".1" mass=".5"/></body>
    </worldbody><contact><pair geom1="up" geom2="low" condim="1" solref="-1e4 -18" solimp="{FORCE_LEVEL}"/></contact>
    </mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    drops = joint_drops(model, 1.0, PLACES)
    (row,) = measure_model(model)
    assert row.restitution_range == pytest.approx((min(drops), max(drops)), abs=1e-9)
    assert row.note.startswith("with the joints' damping of ")
    free = mujoco.MjModel.from_xml_string(text.replace(losses, ""))
    (lossless,) = measure_model(free)
    assert lossless.restitution > row.restitution + 0.02
    assert lossless.note == ""


def test_a_joint_that_brakes_harder_than_the_contact_pushes_creates_no_energy():
    """A joint that brakes harder than the contact pushes leaves no energy gain, and agrees with drops by hand to 1e-9.

    At first touch the joint alone slows the body more than the contact requires. The contact begins to push only at a
    small speed.
    """
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option gravity="0 0 0"/><worldbody><geom name="low" type="plane" size="5 5 1"/><body pos="0 0 .02">
    <joint type="slide" axis="0 0 1" damping="5"/><geom name="up" size=".02" mass=".385"/></body></worldbody>
    <contact><pair geom1="up" geom2="low" condim="1" solref="1.06 .255"/></contact></mujoco>"""
    )
    # two places within the step are enough, because the contact takes many steps
    drops = joint_drops(model, 1.0, PLACES[:2])
    (row,), traps = examine_model(model)
    assert row.restitution_range == pytest.approx((min(drops), max(drops)), abs=1e-9)
    assert max(drops) < 0.2
    assert "gains-energy" not in {trap.trap for trap in traps}


def test_losses_of_a_hinge_are_those_along_the_normal():
    text = """<mujoco><option gravity="0 0 0"/><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 5">
    <joint axis="0 1 0" damping="0.6" frictionloss="0.8"/><geom size="0.1" pos="2 0 0"/>
    <inertial pos="2 0 0" mass="0.3" diaginertia="1e-8 1e-8 1e-8"/></body></worldbody></mujoco>"""
    (bodies,) = read_contacts(mujoco.MjModel.from_xml_string(text))
    hinge, floor = bodies.losses
    # the lever of 2 m divides the damping by its square and the friction by itself
    assert hinge[:2] == pytest.approx((0.6 / 2**2, 0.8 / 2))
    assert floor[:2] == (0, 0)


#: A ball of 0.2 kg above a ball of 0.6 kg on slides above a floor, with the same frictionless contact twice.
TWO_CONTACTS = """<mujoco><option timestep="2e-5" gravity="0 0 0" tolerance="0"/><worldbody>
<geom name="floor" type="plane" size="1 1 .1"/>
<body pos="0 0 {lower}"><joint type="slide" axis="0 0 1"/><geom name="lower" size=".05" mass=".6"/></body>
<body pos="0 0 {upper}"><joint type="slide" axis="0 0 1"/><geom name="upper" size=".05" mass=".2"/></body></worldbody>
<contact><pair geom1="floor" geom2="lower" condim="1" {contact}/>
<pair geom1="lower" geom2="upper" condim="1" {contact}/></contact></mujoco>"""


def leave_two_contacts(contact, lower, upper, velocities):
    """Return the velocities of the lower and the upper ball in m/s after a collision."""
    model = mujoco.MjModel.from_xml_string(TWO_CONTACTS.format(contact=contact, lower=lower, upper=upper))
    data = mujoco.MjData(model)
    data.qvel[:] = velocities
    while data.time < 0.3:
        mujoco.mj_step(model, data)
    return data.qvel.copy()


@pytest.mark.parametrize("solref", ["-20000 -40", "0.352 0.0343"])
def test_a_large_impedance_changes_two_contacts_hit_at_once_but_no_contact_hit_alone(solref):
    large, small = (f'solref="{solref}" solimp="{d} {d} .001 .5 1"' for d in ("0.95", "1e-4"))
    alone = [
        (
            leave_two_contacts(contact, 0.05, 9, (-1, 0))[0],
            np.diff(leave_two_contacts(contact, 9, 9.1, (0, -1)))[0],
        )
        for contact in (large, small)
    ]
    assert alone[0] == pytest.approx(alone[1], abs=0.01)
    both = [leave_two_contacts(contact, 0.05, 0.15, (0, -1)) for contact in (large, small)]
    difference = both[0] - both[1]
    divergence = math.sqrt((0.6 * difference[0] ** 2 + 0.2 * difference[1] ** 2) / 0.2)
    assert divergence > 0.3


def test_a_damping_ratio_of_at_most_two_digits_looks_like_a_restitution():
    assert all(looks_like_restitution(number) for number in (0.5, 0.85, 0.05, 0.95))
    assert not any(looks_like_restitution(number) for number in (0.255, 0.9999, 1.0, 1.5, 0.0343))


@pytest.mark.parametrize(
    ("ratio", "advised"),
    [(0.25499, 0.255), (0.2502, 0.251), (0.2498, 0.249), (0.10004, 0.101), (0.0996, 0.0996), (1.2346, 1.235)],
)
def test_an_advised_damping_ratio_does_not_look_like_a_restitution(ratio, advised):
    assert round_solref((0.053619, ratio)) == (0.0536, advised)
