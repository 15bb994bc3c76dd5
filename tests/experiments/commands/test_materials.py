"""The command `materials`, as a user meets it."""

import json
import re

import pytest

from impact_xval.compliant_baselines.contact.materials import MATERIALS
from impact_xval.experiments.commands.cli import main


def _json(arguments, capsys):
    assert main(["materials", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_without_bodies_every_material_is_shown_with_its_source(capsys):
    assert main(["materials"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    for name, material in MATERIALS.items():
        assert name in shown
        assert material.source.split(",")[0] in shown
    listed = _json([], capsys)
    assert [each["name"] for each in listed["materials"]] == list(MATERIALS)
    assert listed["restitutions"][0]["source"]


def test_two_bodies_are_a_contact_with_a_command_to_go_on_with(capsys):
    (contact,) = _json(["steel:0.01", "steel:inf", "--speed", "2"], capsys)["contacts"]
    assert contact["reduced_mass"] == pytest.approx(8000 * 4e-6 / 3 * 3.141592653589793)
    assert contact["restitution_source"] == "not known: elastic"
    assert main(["materials", "steel:0.01", "steel:inf", "--speed", "2"]) == 0
    shown = capsys.readouterr().out
    (line,) = re.findall(r"^impact-xval (contact .*)$", shown, re.M)
    assert main([*line.split(), "--json"]) == 0  # what is printed can be pasted
    said = json.loads(capsys.readouterr().out)
    assert said["contact"]["duration"] == pytest.approx(contact["duration"], rel=1e-6)
    assert said["contact"]["penetration"] == pytest.approx(contact["linear_penetration"], rel=1e-6)


def test_three_bodies_are_the_basic_collision(capsys):
    arguments = ["steel:0.005", "steel:0.01", "steel:inf"]
    found = _json([*arguments, "--restitution", "0.9", "--restitution", "0.7"], capsys)["collision"]
    assert found["mass_ratio"] == pytest.approx(8)
    assert 0.01 < found["divergence"] < 0.05
    assert main(["materials", *arguments, "--restitution", "0.9", "--restitution", "0.7"]) == 0
    (line,) = re.findall(r"^impact-xval (solve .*)$", capsys.readouterr().out, re.M)
    assert main([*line.split(), "--solver", "state-transition", "--json"]) == 0
    (solved,) = json.loads(capsys.readouterr().out)
    assert [solved["v1"], solved["v2"]] == pytest.approx(found["linear_velocities"], abs=1e-6)


def test_a_known_restitution_is_taken_with_its_source_and_a_usual_radius(capsys):
    answer = _json(["glass", "glass"], capsys)
    assert answer["contacts"][0]["restitution"] == pytest.approx(0.97)
    assert "Foerster" in answer["contacts"][0]["restitution_source"]
    assert answer["bodies"][0]["radius"] == 1.5e-3


def test_bodies_that_go_deep_are_said_to(capsys):
    assert main(["materials", "rubber:0.01", "steel:inf", "--speed", "10"]) == 0
    assert "of a radius into each other" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["wood:1", "steel:1"], "MATERIAL = 'wood'; legal: steel, glass, brass, rubber, ping-pong"),
        (["steel:1"], "MATERIAL:RADIUS: 1 bodies; legal: two, or ball, ball and table"),
        (["steel:x", "steel"], "RADIUS of 'steel' = 'x'; legal: a number"),
        (["brass", "steel"], "RADIUS of 'brass': none given; legal: such as brass:0.01 (m)"),
        (["steel:-1", "steel"], "'steel:-1': radius = -1.0; legal: greater than 0"),
        (["ping-pong", "steel:inf"], "'ping-pong': material = 'ping-pong': a thin shell"),
        (["steel:inf", "steel:inf"], "two fixed bodies do not collide"),
        (["steel", "steel", "--speed", "0"], "speed = 0.0; legal: greater than 0"),
        (["steel", "steel", "--restitution", "2"], "--restitution = '2'; legal: from 0 to 1"),
        (["steel", "steel", "steel:inf", "--restitution", "1"], "--restitution: given 1 times; legal: 2"),
        (["steel", "steel", "steel"], "legal for two balls on a table: finite, finite, inf"),
    ],
)
def test_what_is_typed_wrongly_is_one_line(arguments, says, capsys):
    assert main(["materials", *arguments]) == 2
    said = capsys.readouterr()
    assert says in said.err
    assert said.err.count("\n") == 1
    assert said.out == ""
