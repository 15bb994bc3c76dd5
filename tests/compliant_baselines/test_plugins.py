"""`impact_xval.plugins`, the only module that authors of solvers import from."""

import re
from pathlib import Path

import numpy as np
import pytest

from impact_xval import plugins
from impact_xval.compliant_baselines import registry
from impact_xval.compliant_baselines.rigid.lines import RigidWorld
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision
from tests.compliant_baselines.conftest import installed
from tests.compliant_baselines.third_party import ANVIL, TOY


def test_every_public_name_is_there():
    assert all(hasattr(plugins, name) for name in plugins.__all__)


@pytest.mark.parametrize("source", [TOY, ANVIL], ids=["toy_engine", "anvil"])
def test_the_examples_import_nothing_else_of_this_project(source):
    imports = [line for line in source.splitlines() if line.startswith(("import ", "from "))]
    assert [line for line in imports if "impact_xval" in line and "impact_xval.plugins" not in line] == []


def test_the_guide_says_how_a_world_of_springs_places_balls_in_a_drop():
    guide = (Path(__file__).parents[2] / "docs" / "adding-a-solver.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", guide, re.M | re.S)
    names = {}
    exec(next(code for code in blocks if "class SpringWorld" in code), names)

    class SpringWorld(names["SpringWorld"]):
        def advance(self, n):
            raise NotImplementedError

        def weightless(self, velocities, heights):
            raise NotImplementedError

    collision = Collision.two_balls(m1=1.0, m2=2.0, k1=1e4, k2=5e3, e1=0.9, e2=0.7)
    scene = plugins.Scene.of(collision, Settings(scenario="drop", gravity=9.81))
    world = SpringWorld(scene)
    assert world.rest == pytest.approx(2 * 9.81 / 5e3)
    assert world.heights == pytest.approx([-world.rest, -world.rest], rel=1e-9)
    assert world.places == pytest.approx([3 * world.radius, world.radius])
    assert world.radius > 4 * scene.depth(scene.stiffnesses)


def test_points_in_space_become_coordinates_again():
    coordinates = np.array([[1.0, 2.0, 3.0, 4.0]])
    points = plugins.in_space(coordinates, axes=2)
    assert points.tolist() == [[[1.0, 0.0, 2.0], [3.0, 0.0, 4.0]]]
    assert plugins.along_axes(points, axes=2).tolist() == coordinates.tolist()


def test_names_and_titles_of_solvers_are_unique():
    for values in zip(*((spec.name, spec.title) for spec in registry.SOLVERS), strict=True):
        assert len(set(values)) == len(registry.SOLVERS)


@pytest.mark.parametrize("name", ["dart", "pymunk", "pybullet-restitution", "rapier"])
def test_the_restitution_of_the_body_below_is_a_setting_of_one_call(name):
    solver = installed(name)
    pair = Collision((1, 1), (1e4,), (0.8,), (-1, 0), table=False)
    for partner, product in ((0.5, 0.4), (1.0, 0.8)):
        v1, v2 = solver.solve(pair, Settings(partner_restitution=partner)).velocities
        assert v1 - v2 == pytest.approx(product, abs=1e-4)


def test_a_restitution_of_the_body_below_above_one_is_refused():
    with pytest.raises(ValueError, match=r"partner_restitution = 1.5; legal: from 0 to 1"):
        Settings(partner_restitution=1.5)


def test_the_class_attribute_of_0_4_is_refused_and_not_ignored(monkeypatch):
    solver = installed("pymunk")
    monkeypatch.setattr(RigidWorld, "partner", 0.5, raising=False)
    with pytest.raises(TypeError, match=r"Settings\(partner_restitution=\.\.\.\) now"):
        solver.solve(Collision((1, 1), (1e4,), (0.8,), (-1, 0)))
