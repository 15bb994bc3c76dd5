"""What `inspect` says of public scenes, compared with plain drops in the same scenes.

The scenes have overdamped, elastic or averaged contacts, or bodies that lie flat.
"""

import math

import mujoco
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from impact_xval.compliant_baselines.inspect_mujoco import PLACES, examine_groups, measure_model
from impact_xval.compliant_baselines.inspect_mujoco import examination as examination_module
from tests.compliant_baselines import field_scenes


@pytest.fixture(autouse=True)
def enough_time(monkeypatch):
    """Remove the time limit of `inspect`, so that everything is measured on a slow machine, too."""
    monkeypatch.setattr(examination_module, "MOST_SECONDS", math.inf)


def compiled(xml):
    return mujoco.MjModel.from_xml_string(xml)


def messages(examination):
    return {finding.trap: finding.message for finding in examination.findings}


def bare_drops(model, height, speed, *, height_of_other=None, places=PLACES):
    """Drop the first body of a scene, without gravity, for each place within a step at which it touches.

    Each row of the result holds the restitution, the number of steps with force, the largest depth and the largest
    force. The body moves down along its first vertical degree of freedom, onto the floor or onto a second free body.
    """
    model.opt.gravity[:] = 0
    vertical = 0 if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_SLIDE else 2
    found = []
    for place in places:
        data = mujoco.MjData(model)
        data.qpos[vertical] = height + place * speed * model.opt.timestep
        data.qvel[vertical] = -speed
        if height_of_other is not None:
            data.qpos[7:10] = data.qpos[0], data.qpos[1], height_of_other
        steps, depth, force = 0, 0.0, 0.0
        for _ in range(20_000):
            mujoco.mj_step(model, data)
            pushes = 0.0
            for n in range(data.ncon):
                wrench = np.zeros(6)
                mujoco.mj_contactForce(model, data, n, wrench)
                pushes += wrench[0]
                depth = max(depth, -data.contact[n].dist)
            steps, force = steps + (pushes > 0), max(force, pushes)
            if steps and not data.ncon:
                break
        rate = data.qvel[vertical] - (data.qvel[8] if height_of_other is not None else 0.0)
        found.append((rate / speed, steps, depth, force))
    return np.array(found)


def settle(model, seconds):
    """Return the largest depth of a scene's contacts after some seconds."""
    data = mujoco.MjData(model)
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return -min(data.contact.dist)


@pytest.mark.parametrize("damping", [19.0, 38.0])
@pytest.mark.parametrize(
    ("contact", "friction"),
    [("", 0.0), ("", 0.94), ('solimp=".015 1 .031"', 0.0), ('solimp=".015 1 .031"', 0.94)],
)
def test_a_foot_that_its_joints_brake_does_not_rebound(contact, friction, damping):
    model = compiled(field_scenes.braked_foot(contact, f'damping="{damping}" frictionloss="{friction}"'))
    examination = examine_groups(model)
    (row,) = (each.row for each in examination.contacts)
    assert (row.reason, row.restitution, row.restitution_range) == ("", 0.0, (0.0, 0.0))
    assert row.duration is row.steps is row.stiffness is row.damping is None
    assert row.note.startswith("no rebound: the joints brake the bodies to a standstill in the contact")
    assert row.penetration > 0
    assert not {"tolerance", "long-step", "gains-energy"} & set(messages(examination))
    # a plain simulation agrees: after 4 s the foot is at rest
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = -0.48 + 1e-3, -1.0
    for _ in range(2000):
        mujoco.mj_step(model, data)
    assert abs(data.qvel[0]) < 1e-3


def test_a_body_that_rests_above_the_surface_has_no_depth_but_the_reason():
    examination = examine_groups(compiled(field_scenes.braked_foot("", margin=0.001)))
    (row,) = (each.row for each in examination.contacts)
    assert row.penetration is None
    free = compiled(field_scenes.braked_foot("", losses="", margin=0.001))
    apart = -settle(free, 5.0)
    assert apart > 5e-4
    assert (
        f"at rest the bodies are {apart:.3g} m apart: the force begins at the margin of 0.001 m" in row.note
    )


@pytest.mark.parametrize("ratio", [2, 5, 20])
def test_an_overdamped_contact_of_a_free_body_has_what_a_bare_drop_gives(ratio):
    model = compiled(field_scenes.ball(mass=2.0, radius=0.1, ball=f'solref="0.02 {ratio}" priority="1"'))
    examination = examine_groups(model)
    (row,) = (each.row for each in examination.contacts)
    drops = bare_drops(model, 0.1, 1.0)
    assert row.restitution_range == pytest.approx((drops[:, 0].min(), drops[:, 0].max()), abs=1e-6)
    assert row.penetration > 0
    assert "tolerance" not in messages(examination)


def elastic_motion(speed):
    """Return duration and depth of the cradle's contact from its law a = 1e8 (d/0.01)^2 r, by conservation of energy.

    Here r is the depth and d the impedance, which grows with r.
    """

    def impedance(r):
        x = min(r / 1e-3, 1.0)
        y = 2 * x * x if x <= 0.5 else 1 - 2 * (1 - x) ** 2
        return 1e-4 + y * (0.01 - 1e-4)

    def potential(r):
        return quad(lambda each: 1e8 * (impedance(each) / 0.01) ** 2 * each, 0, r, epsabs=0, epsrel=1e-10)[0]

    depth = brentq(lambda r: potential(r) - speed**2 / 2, 1e-6, 1e-3, xtol=1e-16)

    def slowness(angle):  # r = depth sin(angle), which removes the pole at the end
        r = depth * math.sin(angle)
        return depth * math.cos(angle) / math.sqrt(max(speed**2 - 2 * potential(r), 1e-300))

    half = quad(slowness, 0, math.pi / 2 - 1e-5, epsrel=1e-7)[0]
    return 2 * half, depth


@pytest.mark.parametrize("on_floor", [True, False])
def test_the_cradle_of_mujocos_own_models_is_measured_as_bare_drops_are(on_floor):
    model = compiled(field_scenes.replicated_cradle())
    examination = examine_groups(model)
    (row,) = (each.row for each in examination.contacts if (each.row.masses[1] == math.inf) == on_floor)
    drops = bare_drops(model, 0.02 if on_floor else 1.04, 1.0, height_of_other=None if on_floor else 1.0)
    assert row.restitution_range == pytest.approx((drops[:, 0].min(), drops[:, 0].max()), abs=1e-6)
    assert row.steps == pytest.approx(drops[:, 1].mean(), abs=1e-9)
    assert row.duration == pytest.approx(drops[:, 1].mean() * 1e-4)
    assert row.depth == pytest.approx(drops[:, 2].max(), rel=1e-6)
    mass = 8000 * 4 / 3 * math.pi * 0.02**3 / (1 if on_floor else 2)
    assert row.stiffness == pytest.approx(mass * (math.pi / row.duration) ** 2, rel=1e-3)


def test_an_impedance_that_grows_is_measured_as_its_law_has_it():
    """A contact whose impedance grows has the restitution, duration, depth and stiffness of its law, to 1 %.

    The scene has no friction, because a pyramidal friction cone would multiply the force.
    """
    for row in measure_model(compiled(field_scenes.replicated_cradle(2e-6, condim=1))):
        duration, depth = elastic_motion(1.0)
        assert row.restitution == pytest.approx(1, abs=1e-3)
        assert row.duration == pytest.approx(duration, rel=5e-3)
        assert row.depth == pytest.approx(depth, rel=5e-3)
        mass = 1 / sum(1 / each for each in row.masses)
        assert row.stiffness == pytest.approx(mass * (math.pi / duration) ** 2, rel=1e-2)


def test_a_trap_has_the_steps_of_the_row_that_it_stands_beside():
    examination = examine_groups(compiled(field_scenes.replicated_cradle()))
    rows = [each.row for each in examination.contacts]
    fewest = min(row.steps for row in rows)
    assert f"takes {fewest:.3g} steps in the drops" in messages(examination)["long-step"]
    assert "At a step of 7e-06 s drops give 1" in messages(examination)["long-step"]
    low, high = (f"{float(f'{k:.3g}'):g}" for k in sorted(row.stiffness for row in rows))
    assert f"get {low} to {high} N/m in the drops" in messages(examination)["not-newton-per-metre"]


@pytest.mark.parametrize(
    "scene",
    [
        field_scenes.replicated_cradle(),
        field_scenes.cradle(),
        field_scenes.second_number_is_e(),
        field_scenes.three_by_solimp(),
        field_scenes.eight_balls(),
        field_scenes.keepy_uppy(),
        field_scenes.braked_foot(losses="", mass=3.2),
    ],
    ids=["replicated", "cradle", "ratio", "solimp", "eight", "refsafe", "foot"],
)
def test_no_formula_stands_beside_a_measurement(scene):
    assert all("formula" not in finding.message for finding in examine_groups(compiled(scene)).findings)


def test_a_solimp_that_grows_has_the_restitution_that_was_measured():
    examination = examine_groups(compiled(field_scenes.braked_foot(losses="", mass=3.2)))
    assert "sets no restitution: e is 0.242 to 0.243. " in messages(examination)["solimp"]


def test_numbers_whose_impedance_grows_are_not_at_the_level_of_forces():
    examination = examine_groups(compiled(field_scenes.replicated_cradle()))
    for contact in examination.contacts:
        assert (contact.newton_metre.stiffness, contact.newton_metre.damping) == (1e8, 0)
        low, high = contact.row.impedances
        assert low == pytest.approx(1e-4, rel=0.01)
        x = contact.row.depth / 1e-3
        assert high == pytest.approx(1e-4 + 2 * x * x * (0.01 - 1e-4), rel=0.01)
    assert (
        "With an impedance of 0.0001 to 0.00217 a third body" in messages(examination)["not-newton-per-metre"]
    )


TABLE = 'type="box" size="3 3 .3" pos="0 0 -.3"'
PLANE = 'type="plane" size="5 5 1"'


@pytest.mark.parametrize(
    ("geom", "floor", "points"),
    [
        ('type="box" size=".5 .4 .3"', PLANE, 4),
        ('type="box" size=".5 .4 .3"', TABLE, 4),
        ('type="capsule" size=".3 .4" zaxis="1 0 0"', PLANE, 2),
        ('type="capsule" size=".3 .4" zaxis="1 0 0"', TABLE, 2),
        ('type="cylinder" size=".3 .3"', PLANE, 3),
        ('size=".3"', PLANE, 1),
        ('type="ellipsoid" size=".3 .3 .3"', TABLE, 1),
    ],
)
@pytest.mark.parametrize("contact", ["", 'solref="-100 -20" priority="1"'])
def test_the_depth_at_rest_is_that_of_the_points_that_carry(geom, floor, points, contact):
    model = compiled(field_scenes.lying(geom, floor, contact))
    (row,) = measure_model(model)
    assert row.points == points
    assert row.penetration == pytest.approx(settle(model, 3.0), rel=0.005)


def test_the_number_of_points_is_printed_if_it_is_not_one(tmp_path, command):
    path = tmp_path / "scene.xml"
    path.write_text(field_scenes.lying('type="box" size=".5 .4 .3"'))
    assert " 0.000108 (4 points)\n" in command(["inspect", path], ends=3)


def test_a_default_that_is_averaged_into_a_solref_is_a_trap_with_three_ways_out():
    default, wanted = (0.02, 1), (1e-4, 1)
    examination = examine_groups(compiled(field_scenes.golf_head()))
    (contact,) = examination.contacts
    assert contact.bodies.solref == pytest.approx(np.mean([default, wanted], axis=0))
    message = messages(examination)["mixed-default"]
    assert "geom ball has solref 0.0001 1, and geom head has the default 0.02 1" in message
    assert "averages them by solmix to 0.01005 1" in message
    assert 'write it in a <pair>, or write priority="1" in geom ball, or solmix="0" in geom head' in message
    for ways in (
        {"pair": '<pair geom1="ball" geom2="head" solref="1e-4 1"/>'},
        {"ball": 'solref="1e-4 1" priority="1"'},
        {"head": 'solmix="0"'},
    ):
        (contact,) = examine_groups(compiled(field_scenes.golf_head(**ways))).contacts
        assert contact.bodies.solref == wanted
    for ways in ({"ball": 'solref=".02 1"'}, {"ball": 'solref="1e-4 1"', "head": 'solref="1e-4 1"'}):
        assert "mixed-default" not in messages(examine_groups(compiled(field_scenes.golf_head(**ways))))


def test_advice_is_corrected_by_drops_where_the_impedance_grows():
    scene = field_scenes.braked_foot(losses="", mass=3.2)
    (contact,) = examine_groups(compiled(scene)).contacts
    assert contact.advice.problem == ""
    for e, (constant, ratio) in contact.advice.choices:
        model = compiled(scene.replace('solimp="', f'solref="{constant} {ratio}" solimp="'))
        model.opt.timestep = contact.advice.step
        drops = bare_drops(model, -0.48, 1.0, places=PLACES[:2])
        assert drops[:, 0].mean() == pytest.approx(e, rel=0.01)


def test_advice_that_misses_is_a_trap_and_its_row_says_by_how_much(tmp_path, command):
    scene = field_scenes.braked_foot('solref="1.06 .255"', 'damping="19"')
    examination = examine_groups(compiled(scene))
    (contact,) = examination.contacts
    assert "proposed for e = 0.5 gives " in contact.advice.problem
    assert messages(examination)["unkept"] == contact.advice.problem
    (tmp_path / "scene.xml").write_text(scene)
    assert " off 9" in command(["inspect", tmp_path / "scene.xml"], ends=3)


def test_the_greatest_force_and_depth_are_those_of_a_bare_drop():
    model = compiled(field_scenes.probe())
    (row,) = measure_model(model, speed=0.5)
    drops = bare_drops(model, 0.075, 0.5)
    assert row.depth == pytest.approx(drops[:, 2].max(), rel=1e-3)
    assert row.force == pytest.approx(drops[:, 3].max(), rel=1e-6)


def test_the_force_of_a_braked_contact_is_the_contacts_alone():
    model = compiled(field_scenes.braked_foot('solref="1.06 .255"', 'damping="5"'))
    (row,) = measure_model(model)
    drops = bare_drops(model, -0.48, 1.0, places=PLACES[:2])
    assert row.force == pytest.approx(drops[:, 3].max(), rel=1e-6)
