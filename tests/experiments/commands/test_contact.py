"""The command `contact`, as a user meets it."""

import re

import pytest

from impact_xval.experiments.commands.cli import main


def _shown(capsys, *arguments):
    """Give the text, and by quantity what was asked, and the least and greatest that drops gave."""
    assert main(["contact", "--engine", "mujoco", *arguments]) == 0
    text = capsys.readouterr().out
    rows = re.findall(r"^(restitution|duration) +(\S+)(?: s)? +(\S+) to (\S+)", text, re.MULTILINE)
    return text, {name: [float(number) for number in numbers] for name, *numbers in rows}


def test_what_was_asked_what_to_paste_and_what_came_back(capsys):
    asked = ["--masses", "1.0", "0.5", "--restitution", "0.7", "--stiffness", "1e6"]
    text, drops = _shown(capsys, *asked)
    assert text.startswith("k = 1e+06 N/m, c = 141.121 N s/m (zeta = 0.1222) between bodies of reduced mass")
    assert float(re.search(r'solref="(\S+) ', text)[1]) == pytest.approx(-3e6)  # -k/M, M = 1/3 kg
    for asked, low, high in drops.values():
        assert 0.99 * asked <= low <= high <= 1.01 * asked
    assert drops["restitution"][0] == 0.7
    step = re.search(r'timestep="(\S+)"', text)[1]
    assert f"\n{float(step):g} s is the largest step tried" in text


def test_a_material_and_a_radius_are_a_contact(capsys):
    text, drops = _shown(capsys, "--material", "steel", "--radius", "0.02")
    mass = float(re.search(r"reduced mass (\S+) kg", text)[1])
    assert mass == pytest.approx(7850 * 4 / 3 * 3.14159 * 0.02**3, rel=1e-5)
    assert drops["restitution"][0] == 0.85
    hertz = float(re.search(r"it lasts 6.7% longer than (\S+) s, its peak force is -20%", text)[1])
    assert drops["duration"][0] / hertz == pytest.approx(1.067, rel=0.05)


def test_what_an_engine_refuses_is_one_line(capsys):
    asked = "--engine mujoco --masses 1 0.5 --restitution 0.7 --duration 1e-12"
    assert main(["contact", *asked.split()]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    *_, line = err.splitlines()
    assert line.startswith("impact-xval: --engine mujoco: unrepresentable: accelerations about ")
