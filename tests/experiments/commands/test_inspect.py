"""The command `inspect`, on files a user might have."""

import json
import math

import pytest

from impact_xval.experiments.commands import solvers
from impact_xval.experiments.commands.cli import main

SCENE = """<mujoco><option timestep="1e-3"/><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 2"><freejoint/><geom name="{name}" size="1" solref="{solref}"/></body></worldbody></mujoco>"""


def inspected(path, text, *options):
    path.write_text(text, encoding="utf-8")
    return main(["inspect", str(path), *options])


def test_an_mjcf_file_and_its_names_as_they_are_written(tmp_path, capsys):
    path, bad = tmp_path / "scene.xml", SCENE.format(name="b&#x202e;&#x9b;ll", solref="-100 1")
    assert inspected(path, SCENE.format(name="ball", solref="0.05 1")) == 0
    out = capsys.readouterr().out
    assert "geoms #0 and ball  4189 inf" in out  # of the density 1000 kg/m^3
    assert out.endswith(f"\n{path}: no traps found\n")
    assert inspected(path, bad) == 3
    out = capsys.readouterr().out
    assert r"mixed-signs: geoms #0 and b\u202e\x9bll: solref (-100, 1) is neither" in out
    assert inspected(path, bad, "--json") == 3
    found = json.loads(capsys.readouterr().out)
    assert "mixed-signs" in [row["trap"] for row in found["traps"]]
    (row,) = found["contacts"]
    assert row["masses"] == [pytest.approx(4000 * math.pi / 3), "inf"]
    assert row["damping"] == pytest.approx(row["masses"][0] * 100, rel=0.1)  # 2 M/(0.02 s): the default
    assert row["change"].startswith("for 100 N/m and 1 N s/m: <pair ")
    assert row["change"].split(": ", 1)[1] in out


def test_contacts_that_are_alike_are_one_line_and_all_of_them_are_named_in_json(tmp_path, capsys):
    path, balls = tmp_path / "scene.xml", 2 * '<body><freejoint/><geom size="1" solref="-1 1"/></body>'
    text = f'<mujoco><worldbody><geom type="plane" size="1 1 1"/>{balls}</worldbody></mujoco>'
    assert inspected(path, text) == 3
    out = capsys.readouterr().out
    assert "\ngeoms #0 and #1 and 1 more  4189 inf" in out
    assert "\nmixed-signs: geoms #0 and #1 and 2 more: solref (-1, 1) is neither" in out
    assert inspected(path, text, "--json") == 3
    found = json.loads(capsys.readouterr().out)
    names = [f"geoms #{a} and #{b}" for a, b in ("01", "02", "12")]
    assert [row["where"] for row in found["contacts"]] == [names[:2], names[2:]]
    assert [row["where"] for row in found["traps"] if row["trap"] == "mixed-signs"] == [names]


ENDLESS = '<worldbody><replicate count="1000000000" offset="0 0 1"><geom size="1"/></replicate></worldbody>'


@pytest.mark.parametrize(
    ("inside", "seconds", "says"),
    [
        ("<oops/>", 120.0, "MuJoCo does not compile it"),
        pytest.param(ENDLESS, 3.0, "no answer within 3 s", marks=pytest.mark.slow),
    ],
)
def test_what_cannot_be_examined_costs_a_line(inside, seconds, says, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(solvers, "_TO_INSPECT", seconds)
    assert inspected(tmp_path / "bad.xml", f"<mujoco>{inside}</mujoco>") == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1
