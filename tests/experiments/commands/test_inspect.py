"""The command `inspect`, which measures the contacts of a MuJoCo scene.

Its report of a scene fits on one screen, `--fix` writes the scene with corrected contacts, and bad
input is refused.
"""

import re

import mujoco
import pytest

from impact_xval.compliant_baselines.mapping import KelvinVoigtContact
from tests.compliant_baselines import field_scenes

MESH = "0 0 0  1 0 0  0 1 0  0 0 1"


@pytest.mark.parametrize("geoms", [6, 60])
def test_a_scene_is_one_screen(geoms, tmp_path, command):
    path = tmp_path / "scene.xml"
    path.write_text(field_scenes.many_geoms(geoms))
    lines = command(["inspect", path], ends=3).splitlines()
    assert len(lines) <= 40
    assert f"{geoms} geoms, {geoms * (geoms - 1) // 2} contacts in " in lines[0]
    assert lines[0].startswith(f"MuJoCo {mujoco.__version__}, ")


def test_many_groups_are_cut_and_all_shows_them(tmp_path, command):
    bodies = "".join(
        f'<body pos="{i} 0 1"><freejoint/><geom size=".1" contype="2" conaffinity="1" mass="{i}" '
        f'solref="{-2e4 - 1e3 * i} -15"/></body>'
        for i in range(1, 13)
    )
    path = tmp_path / "scene.xml"
    text = f'<mujoco><option timestep="1e-3"/><worldbody><geom type="plane" size="9 9 1"/>{bodies}</worldbody></mujoco>'
    path.write_text(text)
    out = command(["inspect", path], ends=3)
    assert len(out.splitlines()) <= 40
    assert "4 more groups are not shown; --all shows them" in out
    assert "more rows of what to write are not shown; --all shows them" in out
    everything = command(["inspect", path, "--all"], ends=3)
    assert "--all shows" not in everything
    assert re.search(r"^12 +geoms #0 and #12 ", everything, re.MULTILINE)


def test_both_readings_are_on_the_screen(tmp_path, command):
    path = tmp_path / "golf.xml"
    path.write_text(field_scenes.golf())
    out = command(["inspect", path], ends=3)
    assert re.search(r"^1 +as now +0\.79\d? +0\.0076\d* +-\S+ -\S+ +3 +1 1 0.005 ", out, re.MULTILINE)
    assert re.search(r"^1 +200000 N/m, 70 N s/m +0\.33\d? ", out, re.MULTILINE)


def test_a_second_solref_of_a_reading_is_another_one_with_its_own_friction(tmp_path, command):
    """Two solrefs for contacts of one group differ only because of their friction, to 0.1 %.

    With a pyramidal cone, the solref that keeps a restitution depends on the friction. Contacts of one group may differ
    in friction.
    """
    path = tmp_path / "scene.xml"
    body = '<body pos="{0} 0 1"><freejoint/><geom name="b{0}" size=".1" mass="{1}" friction="{2}"/></body>'
    path.write_text(
        '<mujoco><default><geom solref="-20000 -40"/></default><worldbody><geom type="plane" size="9 9 1"/>'
        f"{body.format(1, 0.3, 0.7)}{body.format(2, 4, 1.2)}</worldbody></mujoco>"
    )
    lines = [line for line in command(["inspect", path], ends=3).splitlines() if "  as now" in line]
    found = [re.search(r"(-\d+\S*) -\S+ +3 +(\S+) ", line).groups() for line in lines]
    assert {friction for _, friction in found} == {"1", "1.2"}
    # The cone multiplies the force along the normal by (condim - 1)/(mu^2 (1 + mu^2)).
    scaled = [float(solref) / (float(mu) ** 2 * (1 + float(mu) ** 2)) for solref, mu in found]
    assert scaled[0] == pytest.approx(scaled[1], rel=1e-3)


def test_frictionless_contacts_are_said_to_be_and_stay_so(tmp_path, command):
    path = tmp_path / "scene.xml"
    path.write_text(field_scenes.cradle("-20000 -15", 1e-3))
    out = command(["inspect", path], ends=3)
    assert "1, frictionless" in out
    assert re.search(r"^1 +as now .* -\S+ +1 +\d", out, re.MULTILINE)  # condim 1 means no friction
    assert "dashpot" not in out  # the output does not mention a dashpot of friction


@pytest.mark.parametrize("reading", ["keep", "newton-metre"])
def test_a_written_scene_does_what_was_meant(reading, tmp_path, command):
    included = tmp_path / "ball.xml"
    included.write_text(
        '<mujocoinclude><body pos="0 0 1"><freejoint/><geom size=".1" mass=".5" solref="-20000 -15"/></body>'
        '<body pos="2 0 1"><freejoint/><geom name="other" type="mesh" mesh="tetra" mass="2"/></body></mujocoinclude>'
    )
    (tmp_path / "tetra.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    scene, folder = tmp_path / "scene.xml", tmp_path / "elsewhere"
    folder.mkdir()
    scene.write_text(
        '<mujoco><option timestep="1e-3"/><asset><mesh name="tetra" file="tetra.obj"/></asset><worldbody>'
        '<geom name="floor" type="plane" size="5 5 1" priority="-1"/><include file="ball.xml"/></worldbody>'
        '<contact><pair name="own" geom1="floor" geom2="other" solref="-9000 -12" condim="1"/></contact></mujoco>'
    )
    out = command(["inspect", scene, "--fix", folder / "fixed.xml", f"--{reading}"])
    assert "Changed: 3 <pair>s, the step, from 0.001 to " in out
    assert "names of 1 geoms" in out
    assert out.endswith("all measured contacts behave as meant, measured with two bodies alone\n")
    # the two balls and the floor can all touch at once
    assert "Bodies that are hit in two contacts at once behave otherwise than in" in out
    model = mujoco.MjModel.from_xml_path(str(folder / "fixed.xml"))
    assert (model.npair, model.ngeom, model.pair("own").dim[0]) == (3, 3, 1)
    # the ball without a name, dropped in a plain simulation
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    data.qpos[2], data.qvel[2] = 0.1, -1.0
    for _ in range(round(0.1 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    meant = {"keep": 0.85, "newton-metre": 0.79}[reading]
    assert data.qvel[2] == pytest.approx(meant, abs=0.02)


def test_a_written_pair_touches_where_its_geoms_do_and_not_by_the_scenes_default_for_pairs(tmp_path, command):
    """A written pair has the margin, gap and solreffriction of its geoms, not of the default for pairs."""
    scene, fixed = tmp_path / "scene.xml", tmp_path / "fixed.xml"
    # MuJoCo has adhesion from 3.11 on
    adhesion = 'adhesion="20"' if hasattr(mujoco.MjContact, "adhesion") else ""
    scene.write_text(
        '<mujoco><default><pair margin=".003" gap=".002" solreffriction="-100 -10"/>'
        f'<geom solref="-5000 -10" {adhesion}/></default><worldbody><geom type="plane" size="9 9 1"/>'
        '<body pos="0 0 .099"><freejoint/><geom size=".1" mass="3"/></body></worldbody></mujoco>'
    )
    command(["inspect", scene, "--fix", fixed, "--keep"])
    contacts = []
    for path in (scene, fixed):
        model = mujoco.MjModel.from_xml_path(str(path))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        (contact,) = data.contact
        contacts.append(
            [contact.includemargin, *contact.solreffriction, *([contact.adhesion] if adhesion else [])]
        )
    assert contacts[0] == contacts[1] == [0, 0, 0, *([40] if adhesion else [])]


def test_a_box_on_a_face_is_said_to_be_four_times_as_stiff_and_is(tmp_path, command):
    scene, fixed = tmp_path / "scene.xml", tmp_path / "fixed.xml"
    scene.write_text(
        '<mujoco><default><geom solref="-20000 -40" condim="1"/></default><worldbody>'
        '<geom type="plane" size="9 9 1"/><body pos="0 0 .1"><freejoint/><geom type="box" size=".1 .2 .1" mass="4"/>'
        "</body></worldbody></mujoco>"
    )
    says = "A box that lands on a face has four points of contact and is four times as stiff"
    assert says in command(["inspect", scene], ends=3)
    assert says in command(["inspect", scene, "--fix", fixed, "--keep"])
    model = mujoco.MjModel.from_xml_path(str(fixed))
    # solref is k and c divided by the mass of 4 kg
    point = KelvinVoigtContact(*(-4 * model.pair_solref[0]), 4)
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    data.qvel[2] = -1.0
    while data.time < 2 * point.duration:
        mujoco.mj_step(model, data)
    four = KelvinVoigtContact(4 * point.k, 4 * point.c, 4)
    assert four.restitution < point.restitution - 0.1
    assert data.qvel[2] == pytest.approx(four.restitution, abs=0.02)


def test_a_scene_that_cannot_be_written_costs_a_line(tmp_path, refused):
    scene, target = tmp_path / "scene.xml", tmp_path / "fixed.xml"
    scene.write_text(field_scenes.second_number_is_e())
    refused(
        ["inspect", scene, "--fix", target, "--keep"],
        "has direct numbers with two readings; nothing is written",
    )
    assert not target.exists()
    refused(
        ["inspect", scene, "--fix", target], "with neither of --keep and --newton-metre; legal: one of them"
    )
    refused(["inspect", scene, "--fix", scene, "--keep"], "legal: a new file that ends in .xml")
    refused(["inspect", scene, "--keep"], "without --fix; legal: beside --fix FILE")
    refused(["inspect", scene, "--geom", "nobody"], "--geom = 'nobody': the scene has no such geom")


def test_what_the_drops_leave_out_is_one_line(tmp_path, command):
    path = tmp_path / "robot.xml"
    path.write_text(
        '<mujoco><worldbody><geom type="plane" size="5 5 1"/><body pos="0 0 1"><joint name="j" axis="0 1 0" '
        'stiffness="3" range="-1 1" limited="true"/><geom size=".1" pos=".3 0 0"/></body>'
        '<flexcomp name="soft" type="grid" count="3 3 1" spacing=".1 .1 .1" pos="0 0 3" dim="2" radius=".01"/>'
        '</worldbody><actuator><motor joint="j"/></actuator></mujoco>'
    )
    head = command(["inspect", path], ends=3).splitlines()[0]
    for part in (
        "The drops leave out: the contacts of 1 flex (soft body)",
        "the force of 1 actuator",
        "the spring of 1 joint",
        "the limits of 1 joint",
    ):
        assert part in head


@pytest.mark.parametrize(
    ("size", "joint", "says"),
    [("1", "", "no body can move"), ("1e300", "<freejoint/>", "body ball has the mass inf kg")],
)
def test_a_scene_in_which_nothing_moves_or_masses_overflow_is_refused(tmp_path, refused, size, joint, says):
    scene = tmp_path / "scene.xml"
    scene.write_text(
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/>'
        f'<body name="ball">{joint}<geom size="{size}"/></body></worldbody></mujoco>'
    )
    refused(["inspect", scene], f"{scene}: {says}", "legal: ")


def test_a_folder_is_no_scene(tmp_path, refused):
    (tmp_path / "scene.xml").mkdir()
    refused(
        ["inspect", tmp_path / "scene.xml"], "scene.xml: a folder; legal: a file that ends in .xml or .mjb"
    )


#: A ball of 0.2 kg above a ball of 0.6 kg above a floor, for two attributes of all geoms.
TWO_BALLS = """<mujoco><option timestep="{step}"/><default><geom {contact}/></default><worldbody>
<geom name="floor" type="plane" size="1 1 .1"/>
<body pos="0 0 .05"><joint type="slide" axis="0 0 1"/><geom name="lower" size=".05" mass=".6"/></body>
<body pos="0 0 .3"><joint type="slide" axis="0 0 1"/><geom name="upper" size=".05" mass=".2"/></body>
</worldbody></mujoco>"""


def test_bodies_in_two_contacts_at_once_are_a_line_unless_the_impedance_is_small(tmp_path, command):
    scene, fixed = tmp_path / "scene.xml", tmp_path / "fixed.xml"
    says = (
        "If a body is hit in two contacts at once, MuJoCo's force in each contact is wrong by up to d times"
    )
    scene.write_text(TWO_BALLS.format(step=1e-4, contact='solref="-20000 -40"'))
    (line,) = (line for line in command(["inspect", scene], ends=3).splitlines() if says in line)
    assert "is up to 0.95 here" in line
    out = command(["inspect", scene, "--fix", fixed, "--keep"])
    assert "contacts that behave as before if two bodies collide alone" in out
    assert f"Bodies that are hit in two contacts at once behave otherwise than in {scene}." in out
    assert says not in command(["inspect", fixed])
    # the fixed floor is in two contacts, but each ball is in one
    apart = scene.read_text().replace('name="upper"', 'name="upper" contype="2" conaffinity="2"')
    scene.write_text(apart.replace('type="plane"', 'type="plane" contype="3"'))
    assert says not in command(["inspect", scene], ends=3)


def test_a_scene_that_follows_the_advice_has_no_trap(tmp_path, command):
    scene = tmp_path / "scene.xml"
    scene.write_text(TWO_BALLS.format(step=2e-3, contact='condim="3"'))
    out = command(["inspect", scene], ends=3)
    assert "if two bodies collide alone: this solref in both geoms\n" in out
    row = re.search(r"damping ratio 0.255, not 1 +0.5 +\S+ +(\S+ 0.255) +(\S+) ", out)
    scene.write_text(TWO_BALLS.format(step=row[2], contact=f'solref="{row[1]}"'))
    out = command(["inspect", scene])
    assert out.endswith(f"{scene}: no traps found\n")
    assert ", not 0.255 " in out
    assert not re.search(r"damping ratio 0.255, not", out)  # advice on what the contact has already


def test_each_place_of_advice_is_named_with_its_groups(tmp_path, command):
    scene = tmp_path / "scene.xml"
    scene.write_text(
        '<mujoco><worldbody><geom name="floor" type="plane" size="9 9 1"/>'
        '<body pos="0 0 1"><freejoint/><geom name="a" size=".1" mass="1"/></body>'
        '<body pos="1 0 1"><freejoint/><geom name="b" size=".1" mass="1" priority="1"/></body></worldbody>'
        '<contact><pair geom1="floor" geom2="a"/></contact></mujoco>'
    )
    out = command(["inspect", scene], ends=3)
    assert "this solref in the <pair> (group 1), in the geom of priority (group 2)\n" in out
