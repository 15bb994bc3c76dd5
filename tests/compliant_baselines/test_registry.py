import json
import os
import re
import subprocess
import sys

import pyarrow as pa
import pytest

from impact_xval.compliant_baselines import SolverError, get_solver, registry, solver_names
from impact_xval.compliant_baselines.answers import answer
from impact_xval.compliant_baselines.conformance import conform
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.registry import origins
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.measures.ladder_table import engines_of
from impact_xval.experiments.measures.laws import voters
from impact_xval.model.collision import Collision
from tests.compliant_baselines.third_party import GOOD, install

ALL = solver_names(on_request=True)


def test_an_unknown_name_is_told_the_known_ones_in_the_order_of_the_tables():
    with pytest.raises(ValueError, match=r"solver 'bullet' is unknown; known: .*mujoco.*pybullet"):
        get_solver("bullet")


def test_kinds_and_laws_are_those_of_the_classes_and_laws_are_exact_solvers():
    for name in ALL:
        solver, kind, law = get_solver(name), registry.kind_of(name), registry.law_of(name)
        assert (solver.name, solver.kind, solver.law) == (name, kind, law)
        assert registry.is_engine(name) == isinstance(solver, Engine)
        assert registry.description_of(name)
        assert law in registry.engine_free_names(), name
        assert registry.law_of(law) == law
        assert (registry.kind_of(law) == "model") == (kind == "model"), name


def test_solvers_are_told_of_without_importing_them_and_made_without_importing_engines():
    code = (
        "import sys; from impact_xval.compliant_baselines import registry as r\n"
        "import impact_xval.experiments.commands.cli\n"
        "engines = ('mujoco', 'pydrake', 'pybullet')\n"
        "def there(*parts): return [m for m in sys.modules if m.startswith(engines) or any(p in m for p in parts)]\n"
        "names = r.solver_names(on_request=True); r.engine_names(); r.exportable_names()\n"
        "told = [(r.kind_of(n), r.law_of(n), r.is_costly(n)) for n in names]; print(there('baselines.engines.'))\n"
        "made = [r.get_solver(n) for n in names]; print(there())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[]", "[]"]


CELL = Collision.two_balls(m1=1.0, m2=1.0, k1=1e6, k2=1e6, e1=0.9, e2=0.7)
RATIOS = ["--stiffness-ratio", "1", "--mass-ratio", "1", "--e1", "0.9", "--e2", "0.7"]


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder of installed distributions; what is imported from it is forgotten afterwards."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) and str(tmp_path) in str(sys.modules[name].__file__):
            del sys.modules[name]


def test_an_installed_solver_is_found_used_and_conforms(site, capsys):
    install(site, "tiny-engine", {"tiny": "tiny_engine:TinyEngine"}, tiny_engine=GOOD)
    assert "tiny" in solver_names()
    assert origins()["tiny"] == "tiny-engine 1.2"
    assert "tiny_engine" not in sys.modules  # nothing is imported before it is asked for
    tiny = get_solver("tiny")
    assert (tiny.name, tiny.version(), tiny.unavailable()) == ("tiny", "1.2", None)
    exact = get_solver("kelvin-voigt").solve(CELL)
    assert tiny.solve(CELL, Settings(step_fraction=1e-4)).v1 == pytest.approx(exact.v1, abs=1e-3)
    with pytest.raises(SolverError, match="tiny: unrepresentable: e1 = 0"):
        tiny.solve(Collision.two_balls(1.0, 1.0, 1.0, 1.0, 0.0, 0.5))
    assert [(check.__name__, problem) for check, problem in conform(tiny) if problem] == []
    assert main(["solve", *RATIOS, "--solver", "tiny", "--solver", "kelvin-voigt", "--json"]) == 0
    ours, exact, _ = json.loads(capsys.readouterr().out)  # and the model
    assert ours["v1"] == pytest.approx(exact["v1"], abs=0.01)


def test_a_run_uses_it_in_worker_processes_and_writes_its_version(site, tmp_path):
    install(site, "tiny-engine", {"tiny": "tiny_engine:TinyEngine"}, tiny_engine=GOOD)
    grid = {"stiffness_ratio": [1.0, 2.0], "mass_ratio": [1.0], "e1": [0.9], "e2": [0.7]}
    config = {"solvers": ["kelvin-voigt", "tiny"], "step_fraction": 0.02, "chunk_size": 1, "grid": grid}
    code = (
        "from pathlib import Path\nfrom impact_xval.experiments.config.configuration import parse_config\n"
        "from impact_xval.experiments.sweep.run import run_sweep\n"
        f"run_sweep(parse_config({config!r}), Path({str(tmp_path / 'run')!r}), workers=2)"
    )
    paths = {"PYTHONPATH": os.pathsep.join([str(site), *sys.path])}
    subprocess.run([sys.executable, "-c", code], env=os.environ | paths, check=True)
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["versions"]["tiny"] == "1.2"
    assert manifest["statuses"]["tiny"] == {"ok": 2}, manifest["statuses"]


BROKEN = {
    "no-module": ("gone:Engine", "", r"ModuleNotFoundError: No module named 'gone'"),
    "no-class": ("bad_one:Engine", "x = 1", r"AttributeError: .*Engine"),
    "raises": ("bad_two:Engine", "1 / 0", "ZeroDivisionError: division by zero"),
    "lacks": (
        "bad_five:Engine",
        "class Engine:\n name = 'lacks'",
        "TypeError: it is no impact_xval.compliant_baselines.solver.Solver",
    ),
    "abstract": (
        "bad_six:Engine",
        "from impact_xval.compliant_baselines import Solver\nclass Engine(Solver):\n name = 'abstract'",
        "TypeError: Can't instantiate abstract class Engine",
    ),
    "renamed": (
        "bad_seven:Engine",
        "from impact_xval.compliant_baselines.references import KelvinVoigtSolver as Engine",
        "TypeError: its name is 'kelvin-voigt'",
    ),
}

RIGID = """
from impact_xval.compliant_baselines.solver import OneByOne


class Rigid(OneByOne):
    name, kind, law = "rigid", "rigid", None

    def version(self):
        return "1"

    def solve_one(self, collision, settings):
        raise NotImplementedError
"""


def test_a_plug_in_states_its_kind_and_law(site):
    install(site, "rigid-engine", {"rigid": "rigid_engine:Rigid", "gone": "gone:Rigid"}, rigid_engine=RIGID)
    assert (registry.kind_of("rigid"), registry.law_of("rigid")) == ("rigid", None)
    for name in ("gone", "of a table from elsewhere"):
        assert (registry.kind_of(name), registry.law_of(name)) == ("compliant", "kelvin-voigt")
    assert voters(["rigid", "gone", "kelvin-voigt"]) == ["rigid", "kelvin-voigt"]
    cells = pa.table({"solver": ["rigid", "gone", "kelvin-voigt"]})
    assert engines_of(cells)["solver"].to_pylist() == ["gone"]  # the others have no ladder


def test_broken_ones_are_unavailable_with_the_reason_and_break_no_command(site, capsys):
    modules = {value.split(":")[0]: text for value, text, _ in BROKEN.values() if text}
    install(site, "broken", {name: value for name, (value, _, _) in BROKEN.items()}, **modules)
    for name, (value, _, says) in BROKEN.items():
        solver = get_solver(name)
        (outcome,) = answer(solver, [CELL], Settings())
        assert outcome.status == "unavailable"
        assert re.search(rf"broken 1.2 provides '{name}' as {value}, but .*{says}", outcome.reason)
        assert solver.version() == ""
    assert main(["solve", *RATIOS]) == 0  # every solver, these included
    printed = capsys.readouterr().out
    assert all(f"{name}: unavailable: broken 1.2" in printed for name in BROKEN)
    assert main(["solvers"]) == 0
    assert main(["conform", "raises"]) == 2


def test_two_distributions_with_one_name_are_told(site):
    install(site, "tiny-engine", {"tiny": "tiny_engine:TinyEngine"}, tiny_engine=GOOD)
    install(site, "tiny-fork", {"tiny": "tiny_fork:TinyEngine"}, tiny_fork=GOOD)
    assert "tiny-engine 1.2 and tiny-fork 1.2 both provide 'tiny'" in str(get_solver("tiny").unavailable())


def test_a_name_that_is_taken_stays_what_it_is(site):
    install(site, "rival", {"mujoco": "rival:Engine"})
    assert type(get_solver("mujoco")).__module__ == "impact_xval.compliant_baselines.engines.mujoco_engine"
    assert solver_names().count("mujoco") == 1
    assert origins()["mujoco"] == "impact-xval (rival 1.2 ignored: the name is taken)"
