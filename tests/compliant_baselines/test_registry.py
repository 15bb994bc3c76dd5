import json
import re
import subprocess
import sys

import pytest

from impact_xval.compliant_baselines import SolverError, get_solver, registry, solver_names
from impact_xval.compliant_baselines.answers import answer
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.registry import one_solver_per_law, origins
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.layout import engines_with_ladders
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.presentation.findings import overall_table
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.model.collision import Collision
from impact_xval.model.graph import corner
from tests.compliant_baselines.third_party import ANVIL, TOY, install

ALL = solver_names(on_request=True)


def test_an_unknown_name_is_told_the_known_ones_in_the_order_of_the_tables():
    with pytest.raises(ValueError, match=r"solver 'bullet' is unknown; known: .*mujoco.*pybullet"):
        get_solver("bullet")


#: Compliant engines whose damping depends on the speed at which a contact begins.
LAWS_OF_THEIR_OWN = ("exudyn:impact-model-1", "exudyn:impact-model-2")


def test_kinds_and_laws_are_those_of_the_classes_and_laws_are_exact_solvers():
    for name in ALL:
        solver, kind, law = get_solver(name), registry.kind_of(name), registry.law_name_of(name)
        assert (solver.name, solver.kind, solver.law) == (name, kind, law)
        assert registry.is_engine(name) == isinstance(solver, Engine)
        assert registry.description_of(name)
        # Without a law are: rigid engines, which take a restitution; engines with their shipped parameters; engines
        # whose law no reference here solves.
        if law is None:
            assert kind == "rigid" or registry.has_fixed_mapping(name) or name in LAWS_OF_THEIR_OWN
            continue
        assert law in registry.exact_law_names(), name
        assert registry.law_name_of(law) == law
        assert (registry.kind_of(law) == "model") == (kind == "model"), name


def test_solvers_are_told_of_without_importing_them_and_made_without_importing_engines():
    code = (
        "import sys; from impact_xval.compliant_baselines import registry as r\n"
        "import impact_xval.experiments.commands.cli\n"
        "engines = ('mujoco', 'pydrake', 'pybullet')\n"
        "def there(*parts): return [m for m in sys.modules if m.startswith(engines) or any(p in m for p in parts)]\n"
        "names = r.solver_names(on_request=True)\n"
        "told = [(r.kind_of(n), r.law_name_of(n)) for n in names]; print(there('baselines.engines.'))\n"
        "made = [r.get_solver(n) for n in names]; print(there())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[]", "[]"]


CELL = Collision.two_balls(m1=1.0, m2=1.0, k1=1e6, k2=1e6, e1=0.9, e2=0.7)
SOLVE = "solve --stiffness-ratio 1 --mass-ratio 1 --e1 0.9 --e2 0.7"


@pytest.fixture
def site(tmp_path, monkeypatch):
    """Return a folder for distributions that Python can import; modules imported from it are dropped after the test."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) and str(tmp_path) in str(sys.modules[name].__file__):
            del sys.modules[name]


def _install_toy(site, distribution="toy-engine", module="toy_engine"):
    install(site, distribution, {"toy": f"{module}:ToyEngine"}, **{module: TOY})


def test_an_installed_engine_is_found_and_used(site, command):
    _install_toy(site)
    assert "toy" in solver_names()
    assert origins()["toy"] == "toy-engine 1.2"
    assert "toy_engine" not in sys.modules  # a plug-in is not imported before it is used
    toy = get_solver("toy")
    assert (toy.name, toy.version(), toy.unavailable()) == ("toy", "1.0", None)
    # Single impacts by hand: contact 1 gives -0.05 and -0.95 m/s, contact 2 gives 0.665; then contact 1 gives 0.62925
    # and -0.01425, contact 2 gives 0.009975.
    assert toy.solve(CELL).velocities == pytest.approx((0.62925, 0.009975), abs=1e-14)
    (graph,) = toy.solve_graphs([corner()], Settings())
    assert (graph.status, graph.reason) == (
        "unrepresentable",
        "toy solves balls in a line alone, no contact graphs",
    )
    with pytest.raises(SolverError, match=r"toy: unrepresentable: gravity = 9.81 m/s\^2"):
        toy.solve(CELL, Settings(scenario="drop"))
    # the second outcome is the model's
    ours, _ = json.loads(command(f"{SOLVE} --scenario impact --solver toy --json"))
    assert ours["v1"] == pytest.approx(0.62925, abs=1e-14)
    assert registry.description_of("toy").startswith("Adapter of the toy engine")


def test_the_examples_of_the_documentation_conform(site, command):
    _install_toy(site)
    install(site, "anvil", {"anvil": "anvil:Anvil"}, anvil=ANVIL)
    for name in ("toy", "anvil"):
        command(["solvers", name])


@pytest.mark.smoke
def test_a_run_writes_its_version_and_asks_it_for_no_law(site):
    _install_toy(site)
    grid = {"stiffness_ratio": [1.0, 2.0], "mass_ratio": [1.0], "e1": [0.9], "e2": [0.7]}
    config = parse_config({"solvers": ["kelvin-voigt", "toy"], "scenario": "impact", "grid": grid})
    folder = run_sweep(config, site / "run", isolate=False).folder
    assert folder.manifest()["versions"]["toy"] == "1.0"
    assert folder.read_table("ladder.parquet").num_rows == 0
    table = overall_table(summarise(folder))
    assert [row[:2] for row in table.rows] == [("kelvin-voigt", "kelvin-voigt"), ("-", "toy")]


BROKEN = {
    "no-module": ("gone:Engine", "", r"ModuleNotFoundError: No module named 'gone'"),
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
        "from impact_xval.compliant_baselines.references import StateTransitionSolver as Engine",
        "TypeError: its name is 'state-transition'",
    ),
}


def test_a_plug_in_states_its_kind_and_law(site):
    _install_toy(site)
    install(site, "broken", {"gone": "gone:Engine"})
    assert (registry.kind_of("toy"), registry.law_name_of("toy")) == ("rigid", None)
    for name in ("gone", "of a table from elsewhere"):
        assert (registry.kind_of(name), registry.law_name_of(name)) == ("compliant", "kelvin-voigt")
    assert one_solver_per_law(["toy", "gone", "kelvin-voigt"]) == ["toy", "kelvin-voigt"]
    config = parse_config({"solvers": ["toy", "gone", "kelvin-voigt"]})
    assert engines_with_ladders(config) == ["gone"]  # a rigid engine and a reference have no ladder


def test_broken_plug_ins_are_unavailable_with_the_reason_and_break_no_command(site, command):
    modules = {value.split(":")[0]: text for value, text, _ in BROKEN.values() if text}
    install(site, "broken", {name: value for name, (value, _, _) in BROKEN.items()}, **modules)
    for name, (value, _, says) in BROKEN.items():
        solver = get_solver(name)
        (outcome,) = answer(solver, [CELL], Settings())
        assert outcome.status == "unavailable"
        assert re.search(rf"broken 1.2 provides '{name}' as {value}, but .*{says}", outcome.reason)
        assert solver.version() == ""
    printed = command(SOLVE)  # the command asks all solvers, including the broken ones
    assert all(f"{name}: unavailable: broken 1.2" in printed for name in BROKEN)
    # The list shows no law for them, because they have stated none.
    listed = command("solvers")
    for name in BROKEN:
        assert not re.search(rf"kelvin-voigt +{name} ", printed), printed
        assert re.search(rf"^{name} +- ", listed, re.M), listed
    assert re.search(r"^mujoco +kelvin-voigt ", listed, re.M), listed
    command("solvers lacks", ends=2)


def test_two_distributions_that_provide_one_name_are_refused(site):
    _install_toy(site)
    _install_toy(site, "toy-fork", "toy_fork")
    assert "toy-engine 1.2 and toy-fork 1.2 both provide 'toy'" in str(get_solver("toy").unavailable())


def test_a_name_that_is_taken_stays_what_it_is(site):
    install(site, "rival", {"mujoco": "rival:Engine"})
    assert type(get_solver("mujoco")).__module__ == "impact_xval.compliant_baselines.engines.mujoco"
    assert solver_names().count("mujoco") == 1
    assert origins()["mujoco"] == "impact-xval (rival 1.2 ignored: the name is taken)"
