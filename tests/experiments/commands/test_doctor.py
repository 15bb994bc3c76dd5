"""The command `doctor`, on files a user might have."""

import json

import pytest

from impact_xval.experiments.commands import doctor
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.experiment import load_config, parse_config
from impact_xval.experiments.sweep import examination
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import fakes

SCENE = """<mujoco><option timestep="{step}"/><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 2"><freejoint/><geom name="ball" size="1" solref="{solref}"/></body></worldbody></mujoco>"""


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


def test_an_experiment_and_the_built_in_one(tmp_path, capsys, monkeypatch):
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


def test_what_cannot_be_examined_is_said_in_one_line(tmp_path, capsys):
    for name, text, says in (
        ("gone.xml", None, "no such file"),
        ("bad.xml", "<mujoco><oops/></mujoco>", "MuJoCo does not compile it"),
        ("bad.txt", "", "legal: .xml or .mjb (MuJoCo), .toml"),
        ("bad.toml", "scenario = 3", "scenario = 3; legal: 'impact' or 'drop'"),
    ):
        path = tmp_path / name
        if text is not None:
            path.write_text(text, encoding="utf-8")
        assert main(["doctor", str(path)]) == 2, name
        err = capsys.readouterr().err
        assert says in err
        assert "Traceback" not in err


@pytest.mark.slow
def test_a_scene_without_end_costs_a_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(doctor, "_LONGEST", 3.0)
    path = tmp_path / "bad.xml"
    inside = '<replicate count="1000000000" offset="0 0 1"><geom size="1"/></replicate>'
    path.write_text(f"<mujoco><worldbody>{inside}</worldbody></mujoco>", encoding="utf-8")
    assert main(["doctor", str(path)]) == 2
    error = capsys.readouterr().err
    assert "no answer within 3 s" in error
    assert error.count("\n") == 1


def test_the_name_of_a_geom_is_shown_as_it_is_written(tmp_path, capsys):
    path = tmp_path / "bad.xml"
    text = SCENE.format(step=1e-3, solref="-100 1").replace('"ball"', '"b&#x202e;&#x9b;ll"')
    path.write_text(text, encoding="utf-8")
    assert main(["doctor", str(path)]) == 1
    assert r"mixed-signs: geoms #0 and b\u202e\x9bll" in capsys.readouterr().out


def test_the_report_of_a_run_says_what_was_found():
    small = {"grid": {"stiffness_ratio": [1.0], "mass_ratio": [1.0], "e1": [0.9], "e2": [0.7]}}
    note = examination.traps_note(parse_config(small))
    assert note["introduction"].endswith("no traps.")
    note = examination.traps_note(parse_config(small | {"mapping": "naive"}))
    assert any("not-newton-per-metre: mujoco, 1 of 1 cells examined" in found for found in note["found"])
