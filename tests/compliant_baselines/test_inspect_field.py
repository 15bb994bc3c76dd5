"""The command `inspect` on scenes from public reports: its numbers are compared with those of the reports' authors."""

import mujoco
import numpy as np
import pytest

from impact_xval.compliant_baselines.inspect_mujoco import examine_groups
from tests.compliant_baselines import field_scenes


def examine_scene(xml, speed=1.0):
    return examine_groups(mujoco.MjModel.from_xml_string(xml), speed)


@pytest.mark.parametrize(
    ("scene", "speed", "measured"),
    [
        (field_scenes.too_high(), 1.0, 0.8200),
        (field_scenes.golf(70), 1.0, 0.79),
        (field_scenes.golf(5), 1.0, 0.98),
        (field_scenes.tennis(12), 7.06, 0.739),
        (field_scenes.tennis(2), 7.06, 0.95),
    ],
    ids=["too-high", "golf-70", "golf-5", "tennis-12", "tennis-2"],
)
def test_direct_numbers_do_what_the_author_measured_and_both_readings_are_kept(scene, speed, measured):
    (group,) = examine_scene(scene, speed).groups
    (contact,) = group.examined
    low, high = contact.row.restitution_range
    assert low - 0.005 <= measured <= high + 0.005
    assert contact.keep.restitution == pytest.approx(measured, abs=0.02)
    assert contact.keep.is_kept
    assert contact.newton_metre.is_kept
    first, second = contact.bodies.solref
    assert (contact.newton_metre.stiffness, contact.newton_metre.damping) == (-first, -second)
    # Read as N/m by the closed form, the numbers would give a lower restitution, because the bodies are lighter than 1
    # kg.
    assert contact.newton_metre.restitution < low - 0.02


def test_the_table_tennis_ball_would_have_another_restitution_in_newton_per_metre():
    (group,) = examine_scene(field_scenes.table_tennis()).groups
    (contact,) = group.examined
    assert group.restitution_range == pytest.approx((0.967, 0.983), abs=1e-3)
    assert contact.keep.restitution == pytest.approx(0.975, abs=1e-3)
    assert contact.newton_metre.restitution == pytest.approx(0.63, abs=0.005)


def test_a_damping_ratio_that_was_taken_for_a_restitution_is_a_trap():
    examination = examine_scene(field_scenes.second_number_is_e())
    (contact,) = examination.contacts
    assert contact.keep is contact.newton_metre is None
    (trap,) = (finding for finding in examination.findings if finding.trap == "damping-ratio")
    low, high = contact.row.restitution_range
    assert f"0.95 rebounds with {low:.3g} to {high:.3g}" in trap.message
    assert "formula" not in trap.message
    (e, (_, zeta)), (other_e, _) = contact.advice.choices
    assert (e, other_e) == (0.95, 0.5)
    assert zeta == pytest.approx(0.0165, abs=5e-5)
    assert contact.advice.measured == pytest.approx([0.95, 0.5], abs=0.005)
    assert "no rebound" not in contact.row.change


def test_what_the_advice_says_holds_in_the_users_scene():
    scene = field_scenes.second_number_is_e()
    (contact,) = examine_scene(scene).contacts
    for e, solref in contact.advice.choices:
        text = scene.replace('"0.02 0.95"', f'"{solref[0]} {solref[1]}"')
        model = mujoco.MjModel.from_xml_string(
            text.replace('timestep="0.002"', f'timestep="{contact.advice.step}"')
        )
        model.opt.gravity[:] = 0
        data = mujoco.MjData(model)
        data.qpos[2], data.qvel[2] = 0.1, -1.0
        for _ in range(round(1.5 * contact.row.duration / model.opt.timestep)):
            mujoco.mj_step(model, data)
        assert data.qvel[2] == pytest.approx(e, abs=0.01)


def test_solimp_sets_no_restitution():
    examination = examine_scene(field_scenes.three_by_solimp())
    restitutions = np.array([group.restitution_range for group in examination.groups])
    assert restitutions.min() > 0.11
    assert restitutions.max() < 0.15
    named = {
        name for finding in examination.findings if finding.trap == "solimp" for name in finding.contacts
    }
    assert {f"geoms floor and e{e}" for e in (0.9, 0.6, 0.3)} <= named
    assert all(
        "sets no restitution" in finding.message
        for finding in examination.findings
        if finding.trap == "solimp"
    )


def test_a_ratio_of_1_is_not_barely_damped_and_its_trap_has_the_steps_of_its_row():
    examination = examine_scene(field_scenes.cradle())
    (contact,) = examination.contacts
    assert contact.row.change.startswith(
        "the second number of solref (0.0004, 1) is a damping ratio, not a restitution"
    )
    assert [finding.trap for finding in examination.findings] == ["long-step"]
    assert f"takes {contact.row.steps:.3g} step" in examination.findings[0].message
    assert f" to {contact.row.restitution_range[1]:.3g}. At a step of " in examination.findings[0].message


def test_a_ratio_that_was_tuned_for_another_restitution_is_a_trap():
    examination = examine_scene(field_scenes.keepy_uppy(), 2.0)
    assert {finding.trap for finding in examination.findings} == {"refsafe", "damping-ratio", "long-step"}


def test_the_default_contact_of_golf_is_what_the_rebuilt_scene_does():
    scene = field_scenes.golf_by_default().replace('pos=".2 0 .1"', 'pos=".0515 0 .1"')
    model = mujoco.MjModel.from_xml_string(scene)
    (group,) = examine_groups(model).groups
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    data.qvel[0] = -2.0  # 1.8 m/s at the club, 0.9 m from the hinge
    for _ in range(400):
        mujoco.mj_step(model, data)
    e = (data.qvel[1] + 0.9 * data.qvel[0]) / 1.8
    low, high = group.restitution_range
    assert low - 0.005 <= e <= high + 0.005


def test_contacts_of_the_same_parameters_are_one_group_whatever_their_masses():
    examination = examine_scene(field_scenes.eight_balls())
    assert [len(group.group.contacts) for group in examination.groups] == [4, 4, 16, 6, 6]
    assert [group.group.contacts[0].bodies.rule for group in examination.groups] == ["mixed"] * 3 + [
        "same"
    ] * 2
    for group in examination.groups:
        assert len(group.examined) <= 4
        solrefs = {contact.keep.solref for contact in group.examined}
        first = next(iter(solrefs))
        # the numbers are equal for all masses
        assert all(solref == pytest.approx(first, rel=1e-9) for solref in solrefs)


def test_some_geoms_of_each_kind_stand_for_a_large_scene():
    balls = "".join(
        f'<body pos="{i} 0 1"><freejoint/><geom name="b{i}" size=".1" mass="{1 + i}"/></body>'
        for i in range(100)
    )
    floors = "".join(f'<geom name="f{i}" type="plane" size="1 1 1"/>' for i in range(2000))
    examination = examine_scene(f"<mujoco><worldbody>{floors}{balls}</worldbody></mujoco>")
    assert (examination.geoms, len(examination.groups)) == (2100, 1)
    assert examination.geoms_looked_at < 10
    masses = {contact.bodies.masses for contact in examination.groups[0].group.contacts}
    assert {(1, np.inf), (100, np.inf), (1, 100)} <= masses


def test_the_contacts_of_one_geom():
    model = mujoco.MjModel.from_xml_string(field_scenes.eight_balls())
    examination = examine_groups(model, geom="floor")
    assert sum(len(group.group.contacts) for group in examination.groups) == 8
    with pytest.raises(
        ValueError, match="--geom = 'flor': the scene has no such geom; legal: a name such as floor"
    ):
        examine_groups(model, geom="flor")
