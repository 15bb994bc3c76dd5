"""The command `doctor`, on files a user might have."""

import ctypes
import json
import re

import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.commands import doctor
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.configuration import load_config
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import fakes

SCENE = """<mujoco><option timestep="{step}"/><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 2"><freejoint/><geom name="ball" size="1" solref="{solref}"/></body></worldbody></mujoco>"""
SCRIPT = """
import sys
import pybullet as p
p.connect(p.DIRECT)
p.setPhysicsEngineParameter(contactSlop={slop}, fixedTimeStep=1e-4)
plane = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE))
ball = p.createMultiBody(1, p.createCollisionShape(p.GEOM_SPHERE, radius=1), basePosition=[0, 0, 2])
p.changeDynamics(ball, -1, contactStiffness=1e4, contactDamping=1)
p.changeDynamics(plane, -1, contactStiffness=1e30, contactDamping=0)
for _ in range(10**9):
    p.stepSimulation()
"""
URDF = """<robot name="ball"><link name="base"><contact><stiffness value="1e4"/><damping value="1"/></contact>
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><sphere radius="1"/></geometry></collision></link></robot>"""

needs_pybullet = pytest.mark.skipif(
    bool(get_solver("pybullet").unavailable()), reason="PyBullet is not installed"
)


def test_an_mjcf_file(tmp_path, capsys):
    sound, bad = tmp_path / "sound.xml", tmp_path / "bad.xml"
    sound.write_text(SCENE.format(step=1e-3, solref="0.05 1"), encoding="utf-8")
    bad.write_text(SCENE.format(step=1e-3, solref="-100 1"), encoding="utf-8")
    assert main(["doctor", str(sound)]) == 0
    assert capsys.readouterr().out == f"{sound}: no traps found\n"
    assert main(["doctor", str(bad)]) == 1
    out = capsys.readouterr().out
    assert "mixed-signs: geoms #0 and ball: solref (-100, 1) is neither" in out
    assert main(["doctor", str(bad), "--json"]) == 1
    assert "mixed-signs" in [row["trap"] for row in json.loads(capsys.readouterr().out)]


@needs_pybullet
def test_a_pybullet_script_is_run_up_to_its_first_step(tmp_path, capsys):
    script = tmp_path / "scene.py"
    script.write_text(SCRIPT.format(slop=0), encoding="utf-8")
    assert main(["doctor", str(script)]) == 0
    script.write_text(SCRIPT.format(slop=1e-4), encoding="utf-8")
    assert main(["doctor", str(script)]) == 1
    assert "slop: contactSlop: forces begin 0.0001 m inside a surface" in capsys.readouterr().out


@needs_pybullet
def test_a_urdf_file_over_a_plane_of_which_nothing_is_set(tmp_path, capsys):
    urdf = tmp_path / "ball.urdf"
    urdf.write_text(URDF, encoding="utf-8")
    assert main(["doctor", str(urdf)]) == 1
    assert "unset-body: body 0" in capsys.readouterr().out


def test_an_experiment_and_the_built_in_one(tmp_path, capsys, monkeypatch):
    from impact_xval.experiments.sweep import examination

    monkeypatch.setattr(examination.experiment_findings, "__defaults__", (20, None))
    assert main(["doctor"]) == 0
    assert "scenes of 'default' (mujoco" in capsys.readouterr().out
    config = tmp_path / "naive.toml"
    config.write_text('mapping = "naive"\nstep_fraction = 0.1\n', encoding="utf-8")
    assert main(["doctor", str(config)]) == 1
    out = capsys.readouterr().out
    assert "not-newton-per-metre: mujoco, " in out
    assert "long-step: mujoco, 20 of 20 cells examined" in out


def test_a_finished_run_of_a_list_is_examined_wherever_its_list_is(tmp_path, capsys, monkeypatch):
    (tmp_path / "there").mkdir()
    monkeypatch.chdir(tmp_path / "there")
    (tmp_path / "there" / "cells.csv").write_text(
        "stiffness_ratio,mass_ratio,e1,e2\n1,1,0.9,0.7\n2,1,0.9,0.7\n"
    )
    (tmp_path / "there" / "c.toml").write_text(
        "cells = 'cells.csv'\nsolvers = ['mujoco']\nmapping = 'naive'\n"
    )
    run_sweep(load_config("c.toml"), tmp_path / "run", isolate=False, resolve=fakes.shifted)
    monkeypatch.chdir(tmp_path)
    assert main(["doctor", "run"]) == 1
    out, err = capsys.readouterr()
    assert "not-newton-per-metre: mujoco, 2 of 2 cells examined" in out
    assert not err


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("gone.xml", None, "no such file"),
        ("bad.xml", "<mujoco><oops/></mujoco>", "MuJoCo does not compile it"),
        ("bad.txt", "", "legal: .xml or .mjb (MuJoCo), .py or .urdf (PyBullet), .toml"),
        ("bad.toml", "scenario = 3", "scenario = 3; legal: 'impact' or 'drop'"),
        pytest.param(
            "raises.py", "1 / 0", "before its first step it raised ZeroDivisionError", marks=needs_pybullet
        ),
        pytest.param("idle.py", "x = 1", "it ended without a stepSimulation()", marks=needs_pybullet),
        pytest.param(
            "exits.py",
            "import sys; sys.exit(3)",
            "it ended with 3 before its first step",
            marks=needs_pybullet,
        ),
        pytest.param("bad.urdf", "<robot", "PyBullet does not load it", marks=needs_pybullet),
    ],
)
def test_what_cannot_be_examined_is_said_in_one_line(tmp_path, capsys, name, text, says):
    path = tmp_path / name
    if text is not None:
        path.write_text(text, encoding="utf-8")
    assert main(["doctor", str(path)]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert "Traceback" not in err


REPLICATE = '<replicate count="1000" offset="0 0 1">'
BODY = "<body><freejoint/><geom size='1'/></body>"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("inside", "says"),
    [
        ('<replicate count="1000000000" offset="0 0 1"><geom size="1"/></replicate>', "no answer within 3 s"),
        (
            REPLICATE * 3 + BODY + "</replicate>" * 3,
            "no answer within 3 s",
        ),
        ('<geom type="hfield" hfield="a"/>', "cannot be examined|MuJoCo does not compile it"),
        ('<geom size="1"/></worldbody><include file="bad.xml"/><worldbody>', "already included"),
    ],
    ids=["replicate", "nested", "field", "loop"],
)
def test_a_scene_without_end_costs_a_line(tmp_path, capsys, monkeypatch, inside, says):
    if "replicate" in inside:
        monkeypatch.setattr(doctor, "_LONGEST", 3.0)
    path = tmp_path / "bad.xml"
    field = '<asset><hfield name="a" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>' * (
        "hfield" in inside
    )
    path.write_text(f"<mujoco>{field}<worldbody>{inside}</worldbody></mujoco>", encoding="utf-8")
    assert main(["doctor", str(path)]) == 2
    error = capsys.readouterr().err
    assert re.search(says, error)
    assert error.count("\n") == 1


@needs_pybullet
@pytest.mark.slow
def test_a_mesh_that_crashes_the_engine_costs_a_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(doctor, "_urdf", _crash)
    (tmp_path / "bad.urdf").write_text(URDF)
    assert main(["doctor", str(tmp_path / "bad.urdf")]) == 2
    error = capsys.readouterr().err
    assert "cannot be examined: its process died: SIGSEGV; legal: a scene that is loaded within 40 s" in error
    assert error.count("\n") == 1


def _crash(path):
    ctypes.string_at(0)


def test_the_name_of_a_geom_is_shown_as_it_is_written(tmp_path, capsys):
    path = tmp_path / "bad.xml"
    text = SCENE.format(step=1e-3, solref="-100 1").replace('"ball"', '"b&#x202e;&#x9b;ll"')
    path.write_text(text, encoding="utf-8")
    assert main(["doctor", str(path)]) == 1
    assert r"mixed-signs: geoms #0 and b\u202e\x9bll" in capsys.readouterr().out


def test_the_report_of_a_run_says_what_was_found(monkeypatch):
    from impact_xval.experiments.config.configuration import parse_config
    from impact_xval.experiments.sweep import examination

    small = {"grid": {"stiffness_ratio": [1.0], "mass_ratio": [1.0], "e1": [0.9], "e2": [0.7]}}
    note = examination.traps_note(parse_config(small))
    assert note["introduction"].endswith("no traps.")
    note = examination.traps_note(parse_config(small | {"mapping": "naive"}))
    assert any("not-newton-per-metre: mujoco, 1 of 1 cells examined" in found for found in note["found"])
    none = examination.traps_note(parse_config(small | {"solvers": ["kelvin-voigt"]}))
    assert none == {
        "introduction": "This run has no engine whose scenes could be examined here.",
        "found": [],
    }
    monkeypatch.setattr(examination, "column_findings", lambda *_: 1 / 0)
    assert "which failed: ZeroDivisionError" in examination.traps_note(parse_config(small))["introduction"]
