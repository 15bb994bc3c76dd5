"""The commands `contact`, `inspect` and `scene`.

Their contacts are requested by numbers or read from a file, and scenes are exported from the cells of a run.
"""

import json
import math
import re

import pyarrow.parquet as pq
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.commands import inspect_scene
from impact_xval.experiments.commands.options import join_numbers
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.presentation.contacts import round_outward
from impact_xval.experiments.presentation.words import describe_restitution_product
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.model import Collision
from tests.compliant_baselines.test_paste import ENGINES, run_alone


def _shown(text):
    """Return for restitution and duration the requested value and the least and greatest value in drops."""
    rows = re.findall(r"^(restitution|duration) +(\S+)(?: s)? +(\S+) to (\S+)", text, re.MULTILINE)
    return {name: [float(number) for number in numbers] for name, *numbers in rows}


@pytest.mark.smoke
def test_what_was_asked_what_to_paste_and_what_came_back(command):
    text = command("contact --engine mujoco --masses 1.0 0.5 --restitution 0.7 --stiffness 1e6")
    drops = _shown(text)
    assert text.startswith(
        "k = 1e+06 N/m, c = 141.121 N s/m, damping ratio 0.1222, reduced mass 0.333333 kg\n"
    )
    # solref is -k/M, with M = 1/3 kg
    assert float(re.search(r'solref="(\S+) ', text)[1]) == pytest.approx(-3e6)
    for asked, low, high in drops.values():
        assert 0.99 * asked <= low <= high <= 1.01 * asked
    assert drops["restitution"][0] == 0.7
    assert 'solver="Newton" tolerance="0"/>' in text
    assert " with the lines above and nothing else\n" in text
    step = re.search(r'timestep="(\S+)"', text)[1]
    assert f"\n{float(step):g} s is the largest step tried" in text


@pytest.mark.parametrize("engine", ["pybullet-restitution", "dart", "pymunk"])
def test_what_is_said_of_the_restitutions_of_two_bodies_is_what_the_engine_does(engine):
    solver = get_solver(engine)
    if reason := solver.unavailable():
        pytest.skip(reason)
    pair = Collision((1.0, 1.0), (1e4,), (0.9,), (-1.0, 0.0), table=False)
    v1, v2 = solver.solve(pair, Settings(partner_restitution=0.9)).velocities
    gives = float(re.search(r"0.9 on both bodies gives (\S+)\.", describe_restitution_product([engine]))[1])
    # The balls meet with 1 m/s. DART softens its constraints by about 1e-5. A mean instead of a product would give 0.9.
    assert v1 - v2 == pytest.approx(gives, abs=1e-3)


def test_restitutions_that_multiply_are_said_where_one_goes_in(command):
    of_pybullet = command("contact --engine pybullet --masses 1 inf --restitution 0.7 --stiffness 1e6")
    assert (
        "PyBullet multiplies the restitutions of the two bodies of a contact: 0.7 on both bodies gives 0.49."
        in of_pybullet
    )
    assert "multiplies" not in command(
        "contact --engine mujoco --masses 1 inf --restitution 0.7 --stiffness 1e6"
    )
    assert "multiply the restitutions of the two bodies" in " ".join(command("contact --help").split())
    assert describe_restitution_product(["pymunk", "dart", "mujoco"]).startswith(
        "DART and Pymunk multiply the "
    )


def test_a_material_and_a_radius_are_a_contact(command):
    text = command("contact --engine mujoco --material steel --radius 0.02")
    drops = _shown(text)
    mass = float(re.search(r"reduced mass (\S+) kg", text)[1])
    assert mass == pytest.approx(7850 * 4 / 3 * 3.14159 * 0.02**3, rel=1e-5)
    assert drops["restitution"][0] == 0.85
    hertz = float(
        re.search(
            r"Their contact lasts (\S+) s\.\n.* it lasts 6.7% longer, and its peak force is 20% lower", text
        )[1]
    )
    assert drops["duration"][0] / hertz == pytest.approx(1.067, rel=0.05)
    numbers = "steel with Young's modulus 2.1e+11 Pa, Poisson's ratio 0.3, density 7850 kg/m^3"
    assert f"\nNumbers used: {numbers}.\n" in text


def test_the_materials_are_stated_for_an_engine_that_is_not_run_in_steps(command):
    text = command("contact --engine lammps --material ping-pong --material steel --radius 0.02")
    assert "The materials are ping-pong ball of 0.02 m radius on steel flat." in text
    assert "density 1370 kg/m^3, wall of 0.0004 m; steel with" in text


def test_a_spring_and_a_dashpot_in_newton_and_metre(command):
    # 3000 N/m and 100 N s/m are in the URDF of several reports. With 0.2 kg the damping ratio is 2.04.
    text = command("contact --engine mujoco --masses 0.2 inf --stiffness 3000 --damping 100")
    assert "k = 3000 N/m, c = 100 N s/m, damping ratio 2.041, reduced mass 0.2 kg" in text
    assert "\ndepth at rest 0.000654 m, under the weight of 0.2 kg at 9.81 m/s^2" in text
    drops = _shown(text)
    zeta = 100 / 2 / math.sqrt(3000 * 0.2)
    w = math.sqrt(zeta**2 - 1)
    for name, exact in (
        ("restitution", math.exp(-zeta / w * math.log((zeta + w) / (zeta - w)))),
        ("duration", math.log((zeta + w) / (zeta - w)) / w / math.sqrt(3000 / 0.2)),
    ):
        said, low, high = drops[name]
        assert said == pytest.approx(exact, rel=1e-5)
        assert 0.99 * exact <= low <= high <= 1.01 * exact


def test_three_bodies_and_a_step_are_one_answer(command):
    ask = "contact --engine mujoco --masses 0.45 3 inf --restitution 0.8 0.6 --step 2e-3 --tolerance 0.05"
    text = command(ask)
    numbers = re.findall(r"^([AB] on [BC]): k = (\S+) N/m.* reduced mass (\S+) kg$", text, re.MULTILINE)
    assert [name for name, *_ in numbers] == ["A on B", "B on C"]
    solrefs = re.findall(r'solref="(\S+) ', text)
    assert [float(solref) for solref in solrefs] == pytest.approx(
        [-float(k) / float(m) for _, k, m in numbers]
    )
    assert 'timestep="0.002"' in text
    assert "under the weight of 3.45 kg" in text  # ball B presses the floor with the weight of A, too
    for contact, e in (("A on B", 0.8), ("B on C", 0.6)):
        low, high = re.search(rf"^restitution, {contact} +{e} +(\S+) to (\S+) ", text, re.MULTILINE).groups()
        assert 0.95 * e <= float(low) <= float(high) <= 1.05 * e
    rows = {
        name: [
            float(number)
            for number in re.search(rf"^{re.escape(name)} .*?((?: +\S+){{3}})$", text, re.M)[1].split()
        ]
        for name in (
            "the model (state-transition)",
            "exact Kelvin-Voigt (kelvin-voigt)",
            "mujoco, the lines above at 0.0002 s",
        )
    }
    model, exact, engine = rows.values()
    collision = Collision.two_balls(0.45, 3.0, *(float(k) for _, k, _ in numbers), 0.8, 0.6, -1.0)
    for name, row in (("state-transition", model), ("kelvin-voigt", exact)):
        assert row[:2] == pytest.approx(get_solver(name).solve(collision).velocities, abs=1e-6)
    assert engine[:2] == pytest.approx(exact[:2], abs=2e-3)
    start = math.sqrt(0.45)  # kinetic norm of the initial velocities: A has 1 m/s
    apart = math.sqrt(sum(m * (a - b) ** 2 for m, a, b in zip((0.45, 3.0), exact, model, strict=False)))
    assert exact[2] == pytest.approx(apart / start, abs=1e-3)


def test_negative_numbers_after_solref_are_numbers(command):
    text = command("contact --masses 1 inf --solref -1e4 -20 --solimp .5 .5 --engine mujoco")
    assert text.startswith(
        "The engine reads solref -10000 -20 and solimp 0.5 0.5 0.001 0.5 2. For these masses they mean:"
    )
    assert "k = 10000 N/m, c = 20 N s/m, damping ratio 0.1, reduced mass 1 kg" in text
    # the depth is (1 - d) g/stiffness, with the impedance d = 0.5
    assert "\ndepth at rest 0.0004905 m, " in text
    assert 'solref="-10000.0 -20.0" solimp="0.5 0.5 0.001 0.5 2.0"' in text


@pytest.mark.parametrize(
    ("typed", "joined"),
    [
        ("--n 1 -2 --other 3", ["--n", "1 -2", "--other", "3"]),
        ("a --n -1e-3 inf b -h", ["a", "--n", "-1e-3 inf b", "-h"]),
        ("--n=1 2", ["--n=1", "2"]),
        ("--n --other", ["--n", "--other"]),
        ("--n -inf -x --n 2 3", ["--n", "-inf", "-x", "--n", "2 3"]),
    ],
)
def test_numbers_after_an_option_are_joined_up_to_the_next_option(typed, joined):
    assert join_numbers(typed.split(), ["--n"]) == joined


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (0.49641717, 0.50198436),
        (0.9999995, 1.0000005),
        (0.0992, 0.1),
        (1e-12, 3e-12),
        (5.0, 5.0),
        (99.9, 123456.7),
    ],
)
def test_an_interval_is_rounded_outward_by_a_ten_thousandth_of_its_width(low, high):
    shown = [float(number) for number in round_outward(low, high).split(" to ")]
    slack = 1e-4 * (high - low) + 1e-12 * high
    assert low - slack <= shown[0] <= low * (1 + 1e-15)
    assert high * (1 - 1e-15) <= shown[1] <= high + slack


BALL = '<body pos="0 0 {z}"><freejoint/><geom {name} size="1" solref="{solref}"/></body>'
SCENE = '<mujoco><option timestep="1e-3"/><worldbody><geom type="plane" size="1 1 1"/>{}</worldbody></mujoco>'


@pytest.mark.smoke
def test_an_mjcf_file_and_its_names_as_they_are_written(tmp_path, command):
    path, name = tmp_path / "scene.xml", 'name="b&#x202e;&#x9b;ll"'
    path.write_text(SCENE.format(BALL.format(z=2, name='name="ball"', solref="0.05 1")))
    out = command(["inspect", path], ends=3)
    assert re.search(r"^1 +geoms #0 and ball +1 +mixed by solmix +3 +0.035 1 ", out, re.MULTILINE)
    assert "1      4189 on fixed" in out  # the mass of the ball at a density of 1000 kg/m^3
    assert "mixed-default, group 1: geom ball has solref 0.05 1, and geom #0 has the default 0.02 1. " in out
    assert out.endswith(f"\n{path}: 1 trap found\n")
    path.write_text(SCENE.format(BALL.format(z=2, name='name="ball" priority="1"', solref="0.05 1")))
    assert command(["inspect", path]).endswith(f"\n{path}: no traps found\n")
    balls = [BALL.format(z=z, name=name * (z == 2), solref="-100 1") for z in (2, 5)]
    path.write_text(SCENE.format("".join(balls)))
    out = command(["inspect", path], ends=3)
    # contacts with equal parameters share a line, and JSON names all of them
    assert re.search(r"^1 +geoms #0 and b\\u202e\\x9bll +2 ", out, re.MULTILINE)
    assert "mixed-signs, groups 1, 2: in group 1 solref (-100, 1) has two signs" in out
    found = json.loads(command(["inspect", path, "--json"], ends=3))
    ball = "b\u202e\x9bll"
    names = [f"geoms #0 and {ball}", "geoms #0 and #2", f"geoms {ball} and #2"]
    assert [row["where"] for row in found["traps"] if row["trap"] == "mixed-signs"] == [names]
    assert [row["where"] for row in found["contacts"]] == [names[:2], names[2:]]
    row = found["contacts"][0]
    assert row["masses"] == [pytest.approx(4000 * math.pi / 3), "inf"]
    # the damping is 2 M/(0.02 s), by the default solref
    assert row["damping"] == pytest.approx(row["masses"][0] * 100, rel=0.1)
    assert "; or for 100 N/m and 1 N s/m: <pair " in row["change"]
    assert row["group"] == 1
    assert f" {row['newton_metre']['solref'][0]:.6g} " in out


ENDLESS = '<replicate count="1000000000" offset="0 0 1"><geom size="1"/></replicate>'


@pytest.mark.parametrize(
    ("inside", "seconds", "says"),
    [
        ("<oops/>", 120.0, "MuJoCo does not compile it"),
        pytest.param(ENDLESS, 3.0, "no answer within 3 s", marks=pytest.mark.slow),
    ],
)
def test_what_cannot_be_examined_costs_a_line(inside, seconds, says, tmp_path, refused, monkeypatch):
    monkeypatch.setattr(inspect_scene, "_TO_INSPECT", seconds)
    (tmp_path / "bad.xml").write_text(SCENE.format(inside))
    refused(["inspect", tmp_path / "bad.xml"], says)


def test_a_cell_of_a_run_gives_what_its_table_holds(tmp_path, command, refused):
    run = tmp_path / "run"
    grid = {"stiffness_ratio": [0.1, 10.0], "mass_ratio": [1.0], "e1": [0.7], "e2": [0.7, 0.0]}
    run_sweep(parse_config({"solvers": ENGINES, "step_fraction": 5e-3, "grid": grid}), run, isolate=False)
    said = command(["scene", run, "2", "--out", tmp_path / "scene"])
    assert said.count(" m/s (difference 0.0e+00 |v0|)") == len(ENGINES)
    assert f"to check: python {tmp_path / 'scene'}" in said
    rows = {r["solver"]: r for r in pq.read_table(run / "cells.parquet").to_pylist() if r["cell"] == 2}
    for engine in ENGINES:
        v1, v2 = run_alone(tmp_path / "scene" / engine / "run.py")
        assert max(abs(v1 - rows[engine]["v1"]), abs(v2 - rows[engine]["v2"])) <= 1e-12
    cell = "scene --stiffness-ratio 40 --mass-ratio 1.1547 --e1 0.9 --e2 0.7 --v0 -3.3 --solver mujoco --out"
    said = command([*cell.split(), tmp_path / "typed"])
    v1, v2 = run_alone(tmp_path / "typed" / "mujoco" / "run.py")
    assert f"mujoco: v1 = {v1!r} m/s, v2 = {v2!r} m/s" in said
    # a cell that cannot be exported is refused with a reason, and nothing is written
    for arguments, says in (
        (["1"], "unrepresentable: e2 = 0: no finite damping"),
        (["4"], "N = 4; legal: a whole number from 0 to 3"),
        (["1", "--solver", "kelvin-voigt"], "--solver = 'kelvin-voigt'; legal: mujoco, pybullet"),
    ):
        refused(["scene", run, *arguments, "--out", tmp_path / "nothing"], says)
        assert not (tmp_path / "nothing").exists()
