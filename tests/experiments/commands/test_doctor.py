"""The command `doctor`, on files a user might have."""

import ctypes
import json
import math
import os
import re
import subprocess
import sys
import time
from pathlib import Path

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
    *table, last = capsys.readouterr().out.splitlines()
    assert last == f"{sound}: no traps found"
    assert table[0].startswith("Two bodies at a time in mujoco ")
    assert table[0].endswith(", at 1 m/s and the scene's own step of 0.001 s")
    assert table[1].split()[-7:] == ["half", "step", "rebound,", "m/s", "T,", "s", "steps"]
    assert table[2].startswith("geoms #0 and ball")
    assert main(["doctor", str(bad)]) == 1
    out = capsys.readouterr().out
    assert "mixed-signs: geoms #0 and ball: solref (-100, 1) is neither" in out
    assert main(["doctor", str(bad), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {"pairs", "pairs_left_out", "traps"}
    assert "mixed-signs" in [row["trap"] for row in found["traps"]]
    (pair,) = found["pairs"]
    # What replaces it: the default, which returns 0.13 or so.
    assert 0.1 < pair["restitution"] < 0.2
    assert pair["masses"][0] == "inf"
    assert pair["status"] == "ok"


def test_a_contact_that_fails_is_no_success(tmp_path, capsys):
    scene = tmp_path / "soft.xml"
    scene.write_text(SCENE.format(step=1e-3, solref="-1e-6 -1e-9"), encoding="utf-8")
    assert main(["doctor", str(scene)]) == 1
    assert "not measured: 1 of 1" in capsys.readouterr().out.splitlines()[-1]


@needs_pybullet
def test_a_pybullet_script_is_run_up_to_its_first_step(tmp_path, capsys):
    script = tmp_path / "scene.py"
    script.write_text(SCRIPT.format(slop=0), encoding="utf-8")
    assert main(["doctor", str(script), "--yes"]) == 0
    script.write_text(SCRIPT.format(slop=1e-4), encoding="utf-8")
    assert main(["doctor", str(script), "--yes"]) == 1
    assert "slop: contactSlop: forces begin 0.0001 m inside a surface" in capsys.readouterr().out


@needs_pybullet
def test_a_link_without_a_shape_touches_nothing(tmp_path, capsys):
    """PyBullet gives a body of a URDF that has no collision shape a box of a millimetre."""
    urdf = tmp_path / "ghost.urdf"
    urdf.write_text('<robot name="ghost"><link name="base"/></robot>', encoding="utf-8")
    assert main(["doctor", str(urdf)]) == 0
    assert "No two bodies can touch" in capsys.readouterr().out


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
        (
            "step.xml",
            SCENE.format(step="nan", solref="0.05 1"),
            "timestep = nan; legal: a finite number > 0 (s)",
        ),
        ("bad.txt", "", "legal: .xml or .mjb (MuJoCo), .py or .urdf (PyBullet), .toml"),
        ("bad.toml", "scenario = 3", "scenario = 3; legal: 'impact' or 'drop'"),
        pytest.param(
            "raises.py", "1 / 0", "before its first step it raised ZeroDivisionError", marks=needs_pybullet
        ),
        pytest.param(
            "exits_at_once.py",
            "import os; os._exit(0)",
            "its process died: exit code 0",
            marks=needs_pybullet,
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
    assert main(["doctor", str(path), "--yes"]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert "Traceback" not in err
    assert err.count("\n") == 1


@needs_pybullet
def test_a_script_is_not_run_unasked(tmp_path, capsys):
    script = tmp_path / "scene.py"
    script.write_text(
        f"import os; os.mkdir({str(tmp_path / 'ran')!r})\n" + SCRIPT.format(slop=0), encoding="utf-8"
    )
    assert main(["doctor", str(script)]) == 2
    err = capsys.readouterr().err
    assert err == (
        f"impact-xval: {script}: examining a script runs it up to its first step; legal without a terminal: --yes\n"
    )
    assert not (tmp_path / "ran").exists()
    assert main(["doctor", str(script), "--yes"]) == 0
    assert (tmp_path / "ran").exists()


@needs_pybullet
def test_a_script_that_steps_in_a_thread_ends_without_a_word(tmp_path):
    script = tmp_path / "scene.py"
    steps = "import threading\nthread = threading.Thread(target=p.stepSimulation)\nthread.start()\nthread.join()\n"
    script.write_text(SCRIPT.format(slop=0).partition("for _")[0] + steps, encoding="utf-8")
    command = [sys.executable, "-m", "impact_xval", "doctor", str(script), "--yes"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@needs_pybullet
@pytest.mark.skipif(sys.platform == "win32", reason="no terminals of this kind there")
@pytest.mark.parametrize(("answer", "code"), [("y", 0), ("n", 2), ("", 2)])
def test_a_script_is_run_when_the_terminal_says_so(tmp_path, answer, code):
    import pty

    script = tmp_path / "scene.py"
    script.write_text(
        f"import os; os.mkdir({str(tmp_path / 'ran')!r})\n" + SCRIPT.format(slop=0), encoding="utf-8"
    )
    ours, theirs = pty.openpty()
    try:
        os.write(ours, f"{answer}\n".encode())
        command = [sys.executable, "-m", "impact_xval", "doctor", str(script), "--json"]
        done = subprocess.run(command, stdin=theirs, capture_output=True, text=True, check=False)
    finally:
        os.close(ours)
        os.close(theirs)
    assert done.returncode == code, done.stderr
    assert f"run {script} up to its first step? [y/N]" in done.stderr
    assert (tmp_path / "ran").exists() == (code == 0)
    if code == 0:  # the question is not in what a program reads
        assert len(json.loads(done.stdout)["pairs"]) == 1
    else:
        assert done.stderr.splitlines()[-1].endswith(f"{script}: not run, so not examined")


def test_the_help_says_that_a_script_is_run(capsys):
    assert main(["doctor", "--help"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "A PyBullet script is run, as python runs it, up to its first step" in said
    assert "--yes" in said


@needs_pybullet
def test_the_contacts_of_a_script_are_in_the_table(tmp_path, capsys):
    script = tmp_path / "scene.py"
    script.write_text(SCRIPT.format(slop=0), encoding="utf-8")
    assert main(["doctor", str(script), "--yes", "--json", "--speed", "0.5"]) == 0
    (pair,) = json.loads(capsys.readouterr().out)["pairs"]
    # 1e4 N/m and 1 N s/m, 1 kg: zeta = c/(2 sqrt(k m)) = 0.005, e = exp(-pi zeta) but for the step of 1/314 of T
    assert pair["stiffness"] == pytest.approx(1e4, rel=0.01)
    assert pair["duration"] == pytest.approx(math.pi / 100, rel=0.01)
    assert pair["restitution"] == pytest.approx(math.exp(-math.pi * 0.005), abs=0.02)
    assert pair["speed"] == 0.5
    assert pair["step"] == 1e-4


@pytest.mark.parametrize(
    "name", ["default.xml", *(pytest.param(f"{name}.py", marks=needs_pybullet) for name in ("unset", "both"))]
)
def test_the_page_shows_what_the_command_prints(tmp_path, capsys, monkeypatch, name):
    page = (Path(__file__).parents[3] / "docs/doctor.md").read_text(encoding="utf-8")
    (scene,) = re.findall(rf"<!-- {name} -->\n```\w+\n(.*?)```", page, re.S)
    (command, shown) = re.findall(rf"\n```\n\$ impact-xval (doctor {name}.*?)\n(.*?)```", page, re.S)[0]
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(scene, encoding="utf-8")
    main(command.split())
    printed = [line for line in capsys.readouterr().out.splitlines() if line and "Measured, " not in line]
    number = re.compile(r"[\d.]*\d")
    for said, line in zip(shown.splitlines(), printed, strict=True):
        if "Two bodies" in line:  # and the version
            assert said.split(", at ")[1] == line.split(", at ")[1]
        else:
            assert number.sub("#", said).split() == number.sub("#", line).split()
            numbers = ([float(each) for each in number.findall(text)] for text in (said, line))
            assert next(numbers) == pytest.approx(next(numbers), rel=0.01)


@pytest.mark.parametrize("speed", ["0", "-1", "inf", "nan", "fast", "1e999"])
def test_a_speed_that_is_none(tmp_path, capsys, speed):
    (tmp_path / "a.xml").write_text(SCENE.format(step=1e-3, solref="0.05 1"), encoding="utf-8")
    assert main(["doctor", str(tmp_path / "a.xml"), "--speed", speed]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"impact-xval: --speed = {speed!r}; legal: a ")
    assert err.count("\n") == 1


def test_an_experiment_has_no_speed(capsys):
    assert main(["doctor", "--speed", "2"]) == 2
    assert "--speed = '2': contacts of an experiment are not measured" in capsys.readouterr().err


def test_a_pair_that_is_not_measured_is_a_row_with_a_reason(tmp_path, capsys, monkeypatch):
    path = tmp_path / "a.xml"
    path.write_text(SCENE.format(step=1e-3, solref="-1e-3 0"), encoding="utf-8")
    assert main(["doctor", str(path), "--speed", "1e300"]) == 1
    out = capsys.readouterr().out
    assert re.search(r"geoms #0 and ball +4190 +- +- +- +- +- +- +-\n", out)
    assert re.search(r"geoms #0 and ball: (crashed|unconverged): ", out)
    monkeypatch.setattr(doctor, "_inspected", _die)
    assert main(["doctor", str(path)]) == 1
    assert "geoms #0 and ball: crashed: its process died: SIGSEGV" in capsys.readouterr().out
    assert main(["doctor", str(path), "--json"]) == 1
    (pair,) = json.loads(capsys.readouterr().out)["pairs"]
    assert (pair["status"], pair["restitution"]) == ("crashed", None)


def _die(*_):
    ctypes.string_at(0)


def test_only_so_many_kinds_of_pairs_are_measured(tmp_path, capsys):
    balls = "".join(
        f'<body pos="{3 * i} 0 1"><freejoint/><geom name="b{i}" size="1" mass="{i + 1}"/></body>'
        for i in range(8)
    )
    path = tmp_path / "many.xml"
    path.write_text(
        f"<mujoco><worldbody><geom name='floor' type='plane' size='1 1 1'/>{balls}</worldbody></mujoco>",
        encoding="utf-8",
    )
    assert main(["doctor", str(path)]) == 0
    out = capsys.readouterr().out
    assert len(re.findall(r"^geoms \w+ and b\d +\d", out, re.M)) == 20
    assert (
        "16 more kinds of pairs can touch, and are not measured (" in out
    )  # of 8 with the floor, 28 with each other
    assert main(["doctor", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["pairs_left_out"] == 16


def test_a_scene_in_which_nothing_can_touch(tmp_path, capsys):
    path = tmp_path / "a.xml"
    path.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", encoding="utf-8")
    assert main(["doctor", str(path)]) == 0
    assert capsys.readouterr().out.startswith("No two bodies can touch.\n")


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
    start = time.perf_counter()
    assert main(["doctor", str(path)]) == 2
    error = capsys.readouterr().err
    assert re.search(says, error)
    assert error.count("\n") == 1
    assert time.perf_counter() - start < 60


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
