import subprocess
import sys

import pytest

from impact_xval.compliant_baselines import get_solver, solver_names
from impact_xval.compliant_baselines.contract import registry
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.compliant_baselines.references.bistiffness import BistiffnessSolver
from impact_xval.compliant_baselines.references.kelvin_voigt import KelvinVoigtSolver
from impact_xval.compliant_baselines.references.solver import ReferenceSolver
from impact_xval.compliant_baselines.rigid.solver import RigidSolver
from impact_xval.experiments.commands.cli import main

FIRST = ("state-transition", "mujoco", "pybullet")


def test_names_come_in_the_order_of_the_tables():
    assert tuple(n for n in solver_names() if n in FIRST) == FIRST


def test_unknown_name_is_named_with_the_known_ones():
    with pytest.raises(ValueError, match=r"solver 'bullet' is unknown; known: .*mujoco.*pybullet"):
        get_solver("bullet")


def test_engines_are_not_imported_before_they_are_asked_to_run():
    code = (
        "import sys, compliant_baselines as b; [b.get_solver(n) for n in b.solver_names()];"
        "print([m for m in ('mujoco', 'pybullet') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


ALL = solver_names(on_request=True)


@pytest.mark.parametrize("name", ALL)
def test_the_kind_of_a_solver_is_that_of_its_class(name):
    solver = get_solver(name)
    kinds = {EngineSolver: "engine", ReferenceSolver: "reference", RigidSolver: "rigid"}
    assert registry.kind_of(name) == next((k for cls, k in kinds.items() if isinstance(solver, cls)), "model")


@pytest.mark.parametrize("name", ALL)
def test_the_law_of_a_solver_is_that_of_an_exact_one(name):
    law = registry.law_of(name)
    assert law in registry.engine_free_names()
    assert registry.law_of(law) == law
    solver = get_solver(law)
    if registry.kind_of(name) in ("model", "rigid"):
        assert registry.kind_of(law) == registry.kind_of(name)
    else:
        assert isinstance(solver, BistiffnessSolver | KelvinVoigtSolver)


def test_what_is_not_of_this_project_is_taken_for_an_engine_of_springs_and_dashpots():
    name = "installed-elsewhere"
    found = registry.kind_of(name), registry.law_of(name), registry.is_costly(name)
    assert found == ("engine", "kelvin-voigt", False)
    assert name not in registry.engine_names(on_request=True)


def test_what_a_solver_is_can_be_told_without_importing_it():
    code = (
        "import sys; from impact_xval.compliant_baselines.contract import registry as r;"
        "names = r.solver_names(on_request=True);"
        "[(r.kind_of(n), r.law_of(n), r.is_costly(n)) for n in names]; r.engine_names(); r.exportable_names();"
        "print([m for m in sys.modules if m.startswith(('mujoco', 'pydrake', 'pybullet'))"
        " or '.engines' in m or '.references' in m])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


def test_every_solver_is_described_in_a_line_of_its_own(capsys):
    names = solver_names(on_request=True)
    described = [registry.description_of(name) for name in names]
    assert len(set(described)) == len(names)
    assert all(0 < len(text) <= 82 and text.isprintable() and text[-1] != "." for text in described)
    assert registry.description_of("no-such-solver") == ""
    assert main(["solvers"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()[2:] if line.strip()}
    for name, text in zip(names, described, strict=True):
        assert text[:40] in rows[name]  # the rest may be on the next line
