"""The command `contact`, as a user meets it."""

import json

import pytest

from impact_xval.experiments.commands.cli import main

ASK = ["contact", "--engine", "mujoco", "--masses", "1.0", "0.5", "--restitution", "0.7"]


def test_json_says_what_was_asked_what_to_paste_and_what_came_back(capsys):
    assert main([*ASK, "--stiffness", "1e6", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["contact"]["stiffness"] == 1e6
    assert said["contact"]["reduced_mass"] == pytest.approx(1 / 3)
    assert said["parameters"]["solref"][0] == pytest.approx(-3e6)
    low, high = said["verified"]["restitution"]
    assert 0.693 <= low <= high <= 0.707
    low, high = said["verified"]["duration"]
    assert 0.99 <= low / said["contact"]["duration"] <= high / said["contact"]["duration"] <= 1.01
    assert f'timestep="{said["largest_step"]!r}"' in said["paste"]


def test_impossible_requests_are_one_line_and_exit_code_2(capsys):
    for arguments, says in (
        (["--stiffness", "1", "--restitution", "0"], "--restitution = 0.0; legal: from 0.0001 to 1"),
        (["--stiffness", "1", "--restitution", "half"], "--restitution = 'half'; legal: a number"),
        (["--stiffness", "1", "--restitution", "1e-30"], "--restitution = 1e-30; legal: from 0.0001 to 1"),
        (["--duration", "1e-12"], "--engine mujoco: unrepresentable: accelerations about"),
        (["--duration", "1e-3", "--stiffness", "1"], "--stiffness, duration: both given"),
        ([], "--stiffness, duration: neither given"),
        (["--stiffness", "1", "--masses", "inf", "inf"], "two fixed bodies do not collide"),
        (
            ["--stiffness", "1", "--masses", "1e-12", "1e12"],
            "one is 1e+24 times the other; legal: at most 1e+12",
        ),
        (["--stiffness", "1", "--speed", "1e-30"], "--speed = 1e-30; legal: from 1e-09 to 1e+09 (m/s)"),
        (["--stiffness", "1", "--tolerance", "0"], "--tolerance = '0'; legal: greater than 0, at most 0.5"),
        (["--stiffness", "1", "--engine", "dart"], "--engine = 'dart'; legal: mujoco, pybullet, drake"),
    ):
        assert main([*ASK, *arguments]) == 2, arguments
        out, err = capsys.readouterr()
        assert out == ""
        assert says in err
        assert len([line for line in err.splitlines() if "trying steps" not in line]) == 1


def test_a_material_and_a_radius_are_a_contact(capsys):
    ask = ["contact", "--engine", "mujoco", "--material", "steel"]
    assert main([*ask, "--radius", "0.02", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["request"]["masses"] == [pytest.approx(7850 * 4 / 3 * 3.14159 * 0.02**3, rel=1e-5), "inf"]
    assert said["contact"]["restitution"] == 0.85
    elastic = said["contact"]["duration"] / said["hertz"]["duration"]
    assert elastic == pytest.approx(said["hertz"]["linear_over_hertz_duration"], rel=0.05)
    for arguments, says in (
        ([], "--radius: given 0 times; legal: once or twice"),
        (["--radius", "inf"], "--radius = inf inf: two flats"),
        (
            ["--radius", "0.02", "--material", "stone"],
            "--material = 'stone'; legal: steel, glass, brass, rubber, ping-pong",
        ),
        (["--radius", "0.02", "--material", "brass"], "--restitution of brass"),
        (["--radius", "0.02", "--stiffness", "1"], "--stiffness: given beside --material"),
        (["--radius", "0.02", "--speed", "0"], "--speed = 0.0; legal"),
    ):
        assert main([*ask, *arguments]) == 2, arguments
        (line,) = capsys.readouterr().err.splitlines()
        assert says in line
