"""`impact_xval.plugins`, the only module that authors of solvers import from."""

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
