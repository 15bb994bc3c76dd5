import subprocess
import sys

import pytest

from impact_xval.compliant_baselines import get_solver, solver_names
from impact_xval.compliant_baselines.contract import registry
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.compliant_baselines.references.solver import ReferenceSolver

FIRST = ("state-transition", "mujoco", "pybullet")
ALL = solver_names(on_request=True)


def test_names_come_in_the_order_of_the_tables_and_an_unknown_one_is_told_the_known_ones():
    assert tuple(n for n in solver_names() if n in FIRST) == FIRST
    with pytest.raises(ValueError, match=r"solver 'bullet' is unknown; known: .*mujoco.*pybullet"):
        get_solver("bullet")


def test_kinds_and_laws_are_those_of_the_classes_and_laws_are_exact_solvers():
    kinds = {EngineSolver: "engine", ReferenceSolver: "reference"}
    for name in ALL:
        solver, kind, law = get_solver(name), registry.kind_of(name), registry.law_of(name)
        assert kind == next((k for cls, k in kinds.items() if isinstance(solver, cls)), "model"), name
        assert law in registry.engine_free_names(), name
        assert registry.law_of(law) == law
        assert (registry.kind_of(law) == "model") == (kind == "model"), name


def test_solvers_are_told_of_without_importing_them_and_made_without_importing_engines():
    code = (
        "import sys; from impact_xval.compliant_baselines.contract import registry as r\n"
        "import impact_xval.experiments.commands.cli\n"
        "engines = ('mujoco', 'pydrake', 'pybullet')\n"
        "def there(*parts): return [m for m in sys.modules if m.startswith(engines) or any(p in m for p in parts)]\n"
        "names = r.solver_names(on_request=True); r.engine_names(); r.exportable_names()\n"
        "told = [(r.kind_of(n), r.law_of(n), r.is_costly(n)) for n in names]; print(there('baselines.engines.'))\n"
        "made = [r.get_solver(n) for n in names]; print(there())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[]", "[]"]
