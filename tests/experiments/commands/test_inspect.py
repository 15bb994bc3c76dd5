"""The command `inspect`, on files a user might have."""

import json
import math

import pytest

from impact_xval.experiments.commands import solvers
from impact_xval.experiments.commands.cli import main

BALL = '<body pos="0 0 {z}"><freejoint/><geom {name} size="1" solref="{solref}"/></body>'
SCENE = '<mujoco><option timestep="1e-3"/><worldbody><geom type="plane" size="1 1 1"/>{}</worldbody></mujoco>'


def inspected(path, text, *options):
    path.write_text(text, encoding="utf-8")
    return main(["inspect", str(path), *options])


def test_an_mjcf_file_and_its_names_as_they_are_written(tmp_path, capsys):
    path, name = tmp_path / "scene.xml", 'name="b&#x202e;&#x9b;ll"'
    assert inspected(path, SCENE.format(BALL.format(z=2, name='name="ball"', solref="0.05 1"))) == 0
    out = capsys.readouterr().out
    assert "geoms #0 and ball  4189 inf" in out  # of the density 1000 kg/m^3
    assert out.endswith(f"\n{path}: no traps found\n")
    balls = [BALL.format(z=z, name=name * (z == 2), solref="-100 1") for z in (2, 5)]
    assert inspected(path, bad := SCENE.format("".join(balls))) == 3
    out = capsys.readouterr().out
    # contacts that are alike are one line, and JSON names all of them
    assert r"geoms #0 and b\u202e\x9bll and 1 more  4189 inf" in out
    assert r"mixed-signs: geoms #0 and b\u202e\x9bll and 2 more: solref (-100, 1) is neither" in out
    assert inspected(path, bad, "--json") == 3
    found = json.loads(capsys.readouterr().out)
    ball = "b\u202e\x9bll"
    names = [f"geoms #0 and {ball}", "geoms #0 and #2", f"geoms {ball} and #2"]
    assert [row["where"] for row in found["traps"] if row["trap"] == "mixed-signs"] == [names]
    assert [row["where"] for row in found["contacts"]] == [names[:2], names[2:]]
    row = found["contacts"][0]
    assert row["masses"] == [pytest.approx(4000 * math.pi / 3), "inf"]
    assert row["damping"] == pytest.approx(row["masses"][0] * 100, rel=0.1)  # 2 M/(0.02 s): the default
    assert row["change"].startswith("for 100 N/m and 1 N s/m: <pair ")
    assert row["change"].split(": ", 1)[1] in out


ENDLESS = '<replicate count="1000000000" offset="0 0 1"><geom size="1"/></replicate>'


@pytest.mark.parametrize(
    ("inside", "seconds", "says"),
    [
        ("<oops/>", 120.0, "MuJoCo does not compile it"),
        pytest.param(ENDLESS, 3.0, "no answer within 3 s", marks=pytest.mark.slow),
    ],
)
def test_what_cannot_be_examined_costs_a_line(inside, seconds, says, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(solvers, "_TO_INSPECT", seconds)
    assert inspected(tmp_path / "bad.xml", SCENE.format(inside)) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1
