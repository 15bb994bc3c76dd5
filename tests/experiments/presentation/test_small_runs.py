"""Runs with little in them, each a result: one cell, one solver, no difference at all, nothing but failures."""

import math

import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import fakes
from tests.experiments.conftest import SMALL

_ONE = {"stiffness_ratio": [2.0], "mass_ratio": [1.5], "e1": [0.9], "e2": [0.7]}
_LIMITS = {"stiffness_ratio": [0, 1, math.inf], "mass_ratio": [1.0], "e1": [0.0], "e2": [0.0, 1.0]}
_PAIR = {"balls": 2, "arrangement": "chain", "e": [0.5, 0.9], "stiffness_taper": 1.0}

RUNS = {
    "one cell": ({"grid": _ONE, "solvers": ["mujoco"]}, fakes.shifted),
    "the model alone": ({"grid": _ONE, "solvers": ["state-transition"]}, fakes.shifted),
    "no engine": ({"solvers": ["liu-zhao-brogliato", "kelvin-voigt"], "scenario": "drop"}, fakes.shifted),
    "limits": ({"grid": _LIMITS, "grazing_threshold": 0.0}, fakes.shifted),
    "one contact": ({"column": _PAIR, "grid": None, "solvers": ["kelvin-voigt"]}, fakes.shifted),
    "agreement": ({"solvers": ["mujoco"]}, fakes.perfect),
    "agreement beside a failure": ({}, fakes.perfect),
    "nothing but failures": ({"solvers": ["mujoco", "pybullet"]}, fakes.refusing),
    "the model fails too": ({"solvers": ["mujoco"]}, fakes.refusing_all),
}


@pytest.mark.parametrize("kind", RUNS)
def test_terminal_shows_it(kind, runs, capsys):
    assert main(["show", str(runs(kind))]) == 0, capsys.readouterr().err
    if kind == "agreement":
        shown = " ".join(capsys.readouterr().out.split())
        assert "MuJoCo ends where the model does: there is nothing to split." in shown


@pytest.mark.slow
@pytest.mark.parametrize("kind", RUNS)
def test_its_page_is_written(kind, runs, capsys):
    assert main(["report", str(runs(kind))]) == 0, capsys.readouterr().err
    page, said = (runs(kind) / "report.html").read_text(encoding="utf-8"), "in all but the model and Liu-Zhao"
    assert (f"Gravity acts {said}-Brogliato." in page) == (kind == "no engine")


def test_what_has_no_result_is_counted_with_the_most_frequent_reason(runs, capsys):
    assert main(["show", str(runs("agreement beside a failure"))]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "PyBullet has no result in 12 of 12 cells (12 unavailable), most often: " in shown
    assert "one vote" not in shown  # a solver without a result is no vote


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    made = {}

    def root(kind):
        if kind not in made:
            changes, resolve = RUNS[kind]
            made[kind] = tmp_path_factory.mktemp("run") / "run"
            data = {key: value for key, value in (SMALL | changes).items() if value is not None}
            run_sweep(parse_config(data), made[kind], isolate=False, resolve=resolve)
        return made[kind]

    return root
