"""Rows whose solver has numbers but no result: the numbers are shown with a mark wherever a collision is shown."""

import dataclasses
import io
import json
import re

import pytest
from rich.console import Console

from impact_xval import Collision, solve
from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.cells.compared import SolverComparison
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.presentation.findings import describe_unsolved
from impact_xval.experiments.presentation.page.opened import collect_cells
from impact_xval.experiments.presentation.views import show_end, show_status
from impact_xval.experiments.sweep.status import status_of
from impact_xval.experiments.tables.folder import RunFolder
from tests.experiments import fakes
from tests.experiments.conftest import swept

PLAIN = Collision.from_ratios(2.0, 1.5, 0.9, 0.7)
CRADLE = Collision((1.0, 1.0, 1.0), (1e8, 1e8), (0.9, 0.9), (-1.0, 0.0, 0.0))
ONE_CELL = {"stiffness_ratio": [2.0], "mass_ratio": [1.5], "e1": [0.9], "e2": [0.7]}


class Withholding(fakes.Shifted):
    """A solver that gives numbers 0.01 m/s off, with a status that means that they are no result."""

    status, reason = "timeout", "not over after 5 steps"

    def moved(self, collision, settings):
        outcome = super().moved(collision, settings)
        return dataclasses.replace(outcome, status=self.status, reason=self.reason)


@pytest.mark.parametrize("status", ["timeout", "unconverged"])
@pytest.mark.parametrize("problem", [PLAIN, CRADLE], ids=["two balls", "cradle"])
def test_a_comparison_shows_numbers_without_a_result_marked_and_compares_none(problem, status):
    model = solve(problem)
    velocities = tuple(v + 0.01 for v in model.velocities)
    withheld = dataclasses.replace(model, velocities=velocities, status=status, reason="too slow", path=None)
    compared = SolverComparison(problem, {"state-transition": model, "mujoco": withheld})
    marked = [f"{v:.6f}*" for v in velocities]
    for shown in (str(compared), compared._repr_html_()):
        assert all(each in shown for each in marked)
        assert not any(f"{v:.6f}*" in shown for v in model.velocities)
        assert "*: the solver ended with these numbers, but they do not count as a result" in shown
        assert f"mujoco: {status}: too slow" in shown
    assert list(compared.scaled_velocities) == ["state-transition"]
    assert "*" not in str(SolverComparison(problem, {"state-transition": model}))


@pytest.mark.parametrize("status", ["timeout", "unconverged"])
def test_a_cell_of_a_run_shows_numbers_without_a_result_marked(status, tmp_path, command, monkeypatch):
    monkeypatch.setattr(Withholding, "status", status)
    root = tmp_path / "run"
    swept(root, Withholding.resolve, solvers=["mujoco"], grid=ONE_CELL)
    model = solve(PLAIN)
    shown = command(["show", root, "--cell", "0"])
    assert re.search(rf"mujoco +{status} +{model.v1 + 0.01:.6f}\* +{model.v2:.6f}\* +- ", shown)
    assert "*: the solver ended with these numbers, but they do not count as a result" in shown
    (found,) = (
        row
        for row in json.loads(command(["show", root, "--cell", "0", "--json"]))
        if row["solver"] == "mujoco"
    )
    assert (found["v1"], found["velocity_divergence"]) == (pytest.approx(model.v1 + 0.01), None)
    results = {row["solver"]: row for row in collect_cells(RunFolder(root), [0])[0]["results"]}
    assert [row["result"] for row in results.values()] == [True, False]
    assert results["mujoco"]["velocities"] == pytest.approx([model.v1 + 0.01, model.v2])


def test_a_limit_that_is_not_known_is_told_in_words(tmp_path, command):
    changes = {"convergence": {"tolerance": 1e-9, "halvings": 1}, "step_fraction": 0.02, "grid": ONE_CELL}
    folder = swept(tmp_path / "run", get_solver, solvers=["mujoco", "pybullet"], **changes)
    rows = json.loads(command(["show", folder.root, "--cell", "0", "--json"]))
    console = Console(file=io.StringIO(), width=300)
    show_status(console, "run", status_of(folder.root))
    for shown in (command(["show", folder.root, "--cell", "0"]), console.file.getvalue()):
        assert "dt -> 0" not in shown
    shown = " ".join(command(["show", folder.root, "--cell", "0"]).split())
    for row in rows:
        if row["solver"] != "state-transition":
            assert row["status"] == "unconverged"
            error = float(f"{100 * row['limit_error']:.1e}")
            percent = f"{error:g} % of |v0|, more than the 1e-07 %"
            assert f"{row['solver']}: unconverged: " in shown
            assert percent in shown
    assert "halving the step may still change v by" in shown


class Refusing(Withholding):
    """A solver whose limit stays unknown even with shorter steps."""

    status, reason = (
        "unconverged",
        "v is off by up to 20 % of |v0|, and halving the step does not help: it softens",
    )


def test_an_unconverged_run_names_the_settings_that_shorten_its_steps(tmp_path, monkeypatch):
    changes = {"solvers": ["mujoco"], "grid": ONE_CELL}
    monkeypatch.setattr(Withholding, "status", "unconverged")
    monkeypatch.setattr(Withholding, "reason", "halving the step may still change v by 20 % of |v0|")
    told = "a smaller step_fraction (now 0.02), or more halvings under [convergence] (now 1, at most 10)"
    folder = swept(
        tmp_path / "a", Withholding.resolve, step_fraction=0.02, convergence={"halvings": 1}, **changes
    )
    summary = summarise(folder)
    assert describe_unsolved(summary)[1].endswith(told)
    console = Console(file=io.StringIO(), width=300)
    show_end(console, summary, 1.0, "run")
    assert told in console.file.getvalue()
    folder = swept(tmp_path / "b", Withholding.resolve, convergence={"enabled": False}, **changes)
    assert describe_unsolved(summarise(folder))[1].endswith("a smaller step_fraction (now 0.001)")
    folder = swept(tmp_path / "c", Refusing.resolve, **changes)
    assert not any("step_fraction" in each for each in describe_unsolved(summarise(folder)))


def test_a_cell_says_of_which_step_the_d_of_an_unconverged_row_is(tmp_path, command):
    changes = {"convergence": {"tolerance": 1e-9, "halvings": 1}, "step_fraction": 0.02, "grid": ONE_CELL}
    folder = swept(tmp_path / "run", get_solver, solvers=["kelvin-voigt", "mujoco"], **changes)
    shown = " ".join(command(["show", folder.root, "--cell", "0"]).split())
    assert "ends D = " in shown
    assert "has no D" not in shown
    assert "causes of D for these numbers, D was computed with the time step of the run." in shown
