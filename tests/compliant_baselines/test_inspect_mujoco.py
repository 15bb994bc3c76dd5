"""Each trap set, found by its name, and its effect measured in the engine."""

import math

import mujoco
import numpy as np
import pytest

from impact_xval.compliant_baselines.engines.mujoco import Mujoco
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.inspect_mujoco import inspect_model
from impact_xval.compliant_baselines.paste import mjcf
from impact_xval.compliant_baselines.restitution import contact_time
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision

FORCE_LEVEL = "1e-4 1e-4 .001 .5 1"
DEFAULT = ".9 .95 .001 .5 2"
ELASTIC, DURATION = "-1e6 -0", math.pi / 1e3  # solref, and how long its contact lasts
OVERRIDE = {"option": f'o_solref="0.02 1" o_solimp="{FORCE_LEVEL}"', "flag": 'override="enable"'}


def found(model):
    return {finding.trap: finding.says for finding in inspect_model(model)}


def ball_on_plane(solref, solimp=FORCE_LEVEL, floor=None, option="", flag="", mass=1.0, step=1e-5, gap=0.0):
    """Scene of a sphere of 1 m on a free joint that meets a plane; `floor` is the solref of that, if it is another."""
    ours, theirs = (f'condim="1" solref="{each}" solimp="{solimp}"' for each in (solref, floor or solref))
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco><option timestep="{step}" gravity="0 0 0" {option}><flag {flag}/></option><worldbody>
      <geom name="floor" type="plane" size="1 1 1" {theirs}/>
      <body pos="0 0 {1 + gap}"><freejoint/><geom name="ball" size="1" mass="{mass}" {ours}/></body>
    </worldbody></mujoco>""")


def bounce(model):
    """Restitution, and duration of the contact as the number of steps that have one."""
    data, touching = mujoco.MjData(model), 0
    data.qvel[2] = -1.0
    with Mujoco().running():  # without its warnings
        for _ in range(200_000):
            mujoco.mj_step(model, data)
            touching += data.ncon > 0
            if touching and data.ncon == 0:
                break
    return data.qvel[2], touching * model.opt.timestep


def test_a_sound_scene_has_no_traps_and_bounces_as_asked():
    model = ball_on_plane(ELASTIC)
    assert found(model) == {}
    assert bounce(model) == (pytest.approx(1, abs=1e-3), pytest.approx(DURATION, rel=0.01))


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
    assert bounce(model)[1] > 9 * DURATION


def test_refsafe_may_be_disabled_and_leaves_long_time_constants():
    free = ball_on_plane("0.02 0.2", step=0.015, flag='refsafe="disable"')
    assert "refsafe" not in found(free)
    assert bounce(free) != bounce(ball_on_plane("0.02 0.2", step=0.015))
    assert "refsafe" not in found(ball_on_plane("0.02 0.2", step=0.001))


def test_the_discrete_integrator_takes_restitution_away():
    model = ball_on_plane(ELASTIC, option='integrator="discrete"', step=DURATION / 32)
    assert set(found(model)) == {"discrete"}
    assert bounce(model)[0] < 0.9
    assert bounce(ball_on_plane(ELASTIC, step=DURATION / 32))[0] == pytest.approx(1, abs=0.01)


def test_direct_numbers_are_not_newton_per_metre():
    light, heavy = (ball_on_plane(ELASTIC, DEFAULT, mass=mass, step=1e-6) for mass in (1.0, 4.0))
    assert "this pair has 4e+06 N/m at most" in found(heavy)["not-newton-per-metre"]
    assert len(found(heavy)) == 1
    # In N/m a mass four times as large would take twice as long.
    assert bounce(heavy)[1] == pytest.approx(bounce(light)[1], rel=1e-6)
    assert bounce(heavy)[1] == pytest.approx(DURATION, rel=0.06)


def test_direct_numbers_of_two_geoms_are_mixed_element_by_element():
    model = ball_on_plane(ELASTIC, floor="-1e4 -600")
    assert set(found(model)) == {"mixed-geoms"}
    assert "combined to (-1000000.0, -600.0)" in found(model)["mixed-geoms"]
    restitution, duration = bounce(ball_on_plane("-1e6 -600"))
    assert bounce(model) == (pytest.approx(restitution, abs=1e-3), pytest.approx(duration, rel=0.01))
    assert bounce(model)[0] < 0.6  # either alone: 1, or slow


def test_an_absolute_tolerance_under_cg_loses_a_soft_contact():
    soft = "-1e-6 -0.000244"  # accelerations of 1e-3 m/s^2
    options = "", 'solver="CG"', 'solver="CG" tolerance="0"'
    sound, model, exact = (ball_on_plane(soft, step=30.0, option=option) for option in options)
    assert [set(found(each)) for each in (sound, model, exact)] == [set(), {"tolerance"}, set()]
    assert bounce(sound)[0] == pytest.approx(0.7, abs=0.01)
    assert bounce(model)[0] > bounce(sound)[0] + 0.1
    assert bounce(exact)[0] == pytest.approx(bounce(sound)[0], abs=1e-4)


def test_a_step_too_long_for_the_stiffest_contact():
    steps = (3, 0.3), (2, 0.7), (40, 0.3)  # in a contact, and of them before it
    third, half, short = (
        ball_on_plane(ELASTIC, step=DURATION / n, gap=gap * DURATION / n) for n, gap in steps
    )
    assert set(found(third)) == set(found(half)) == {"long-step"}
    assert bounce(half)[0] > 1.1  # it creates energy
    assert found(short) == {}
    # what a heavy dashpot needs is a shorter step than the spring's
    assert set(found(ball_on_plane("-1e6 -2e4", step=DURATION / 40))) == {"long-step"}


def test_where_no_long_step_is_found_the_restitution_is_within_ten_percent():
    for zeta in (0.0, 0.1, 0.3, 0.6):
        solref = f"-1e6 -{2e3 * zeta}"
        exact, pressed = bounce(ball_on_plane(solref, step=1e-6))[0], DURATION * contact_time(zeta) / np.pi
        for steps in (31, 60):
            for gap in np.linspace(0, 1, 5):
                model = ball_on_plane(solref, step=pressed / steps, gap=gap * pressed / steps)
                assert found(model) == {}
                assert bounce(model)[0] == pytest.approx(exact, rel=0.1), (zeta, steps, gap)


def test_a_trap_of_many_contacts_is_told_once_and_static_ones_not_at_all():
    balls = 5 * '<body><freejoint/><geom size="1" solref="-1 1"/></body>'
    walls = '<geom type="box" size="1 1 1"/><geom type="plane" size="1 1 1"/>'
    scenes = (f"<mujoco><worldbody>{walls}{each}</worldbody></mujoco>" for each in (balls, ""))
    moving, still = (inspect_model(mujoco.MjModel.from_xml_string(scene)) for scene in scenes)
    assert len(moving) == len({(finding.trap, finding.says) for finding in moving})
    assert "mixed-signs" in {finding.trap for finding in moving}
    assert still == []


def test_our_own_scenes_have_none():
    c = Collision.two_balls(m1=1.0, m2=0.5, k1=1e8, k2=1e5, e1=0.5, e2=1.0)

    def traps(**settings):
        return found(mujoco.MjModel.from_xml_string(mjcf(Scene.of(c, Settings(**settings)))))

    assert traps(scenario="impact") == traps(scenario="drop") == {}
    assert set(traps(mapping="naive")) == {"not-newton-per-metre"}
