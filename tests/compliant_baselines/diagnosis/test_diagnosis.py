"""Each trap set, found by its name, and its effect measured in the engine."""

import math

import numpy as np
import pytest

from impact_xval.compliant_baselines.diagnosis.diagnose_mujoco import diagnose_mujoco
from impact_xval.compliant_baselines.engines.column import column_of
from impact_xval.compliant_baselines.solver import Settings
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


def test_our_own_scenes_have_none():
    c = Collision.two_balls(m1=1.0, m2=0.5, k1=1e8, k2=1e5, e1=0.5, e2=1.0)
    for scenario in ("impact", "drop"):
        assert column_findings(column_of(c, Settings(scenario=scenario))) == []
    naive = traps(column_findings(column_of(c, Settings(mapping="naive"))))
    assert naive == {"not-newton-per-metre"}
