"""The command `inspect`, on files a user might have."""

import json
import math

import pytest

from impact_xval.experiments.commands import solvers
from impact_xval.experiments.commands.cli import main

SCENE = """<mujoco><option timestep="{step}"/><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 2"><freejoint/><geom name="ball" size="1" solref="{solref}"/></body></worldbody></mujoco>"""


def test_an_mjcf_file(tmp_path, capsys):
    sound, bad = tmp_path / "sound.xml", tmp_path / "bad.xml"
    sound.write_text(SCENE.format(step=1e-3, solref="0.05 1"), encoding="utf-8")
    bad.write_text(SCENE.format(step=1e-3, solref="-100 1"), encoding="utf-8")
    assert main(["inspect", str(sound)]) == 0
    out = capsys.readouterr().out
    assert "geoms #0 and ball  4189 inf" in out  # of the density 1000 kg/m^3
    assert out.endswith(f"\n{sound}: no traps found\n")
    assert main(["inspect", str(bad)]) == 3
    out = capsys.readouterr().out
    assert "mixed-signs: geoms #0 and ball: solref (-100, 1) is neither" in out
    assert main(["inspect", str(bad), "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert "mixed-signs" in [row["trap"] for row in found["traps"]]
    (row,) = found["contacts"]
    assert row["masses"] == [pytest.approx(4000 * math.pi / 3), "inf"]
    assert row["damping"] == pytest.approx(row["masses"][0] * 100, rel=0.1)  # 2 M/(0.02 s): the default
    assert row["change"].startswith("for 100 N/m and 1 N s/m: <pair ")
    assert row["change"].split(": ", 1)[1] in out


def test_what_cannot_be_examined_is_said_in_one_line(tmp_path, capsys):
    for name, text, says in (
        ("bad.xml", "<mujoco><oops/></mujoco>", "MuJoCo does not compile it"),
        ("bad.txt", "", "legal: a file that ends in .xml or .mjb"),
    ):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        assert main(["inspect", str(path)]) == 2, name
        err = capsys.readouterr().err
        assert says in err
        assert err.count("\n") == 1


@pytest.mark.slow
def test_a_scene_without_end_costs_a_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(solvers, "_TO_INSPECT", 3.0)
    path = tmp_path / "bad.xml"
    inside = '<replicate count="1000000000" offset="0 0 1"><geom size="1"/></replicate>'
    path.write_text(f"<mujoco><worldbody>{inside}</worldbody></mujoco>", encoding="utf-8")
    assert main(["inspect", str(path)]) == 2
    error = capsys.readouterr().err
    assert "no answer within 3 s" in error
    assert error.count("\n") == 1


def test_the_name_of_a_geom_is_shown_as_it_is_written(tmp_path, capsys):
    path = tmp_path / "bad.xml"
    text = SCENE.format(step=1e-3, solref="-100 1").replace('"ball"', '"b&#x202e;&#x9b;ll"')
    path.write_text(text, encoding="utf-8")
    assert main(["inspect", str(path)]) == 3
    assert r"mixed-signs: geoms #0 and b\u202e\x9bll" in capsys.readouterr().out
