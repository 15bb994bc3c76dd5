"""Runs with little in them, each a result: one cell, one solver, no difference at all, nothing but failures."""

import math

import pytest

from impact_xval.compliant_baselines import get_solver
from tests.experiments import fakes
from tests.experiments.conftest import swept

_ONE = {"stiffness_ratio": [2.0], "mass_ratio": [1.5], "e1": [0.9], "e2": [0.7]}
_LIMITS = {"stiffness_ratio": [0, 1, math.inf], "mass_ratio": [1.0], "e1": [0.0], "e2": [0.0, 1.0]}
_PAIR = {"balls": 2, "arrangement": "chain", "e": [0.5, 0.9], "stiffness_taper": 1.0}
_GAPS = {"balls": 3, "arrangement": "cradle", "gap": [0.0, 1e-5], "e": 0.9, "stiffness_taper": 1.0}
_LIKE, _HELD = ["kelvin-voigt", "mujoco"], "The limits dt -> 0 of MuJoCo are "
_NOTHING = "Nothing could be compared."

#: What is run, by which solvers, and what is said of it.
RUNS = {
    "one cell": ({"grid": _ONE, "solvers": ["mujoco"]}, fakes.shifted, ""),
    "the model alone": ({"grid": _ONE, "solvers": ["state-transition"]}, fakes.shifted, _NOTHING),
    "no engine": ({"solvers": ["liu-zhao-brogliato", "kelvin-voigt"], "scenario": "drop"}, fakes.shifted, ""),
    "limits": ({"grid": _LIMITS, "grazing_threshold": 0.0}, fakes.shifted, ""),
    "one contact": ({"column": _PAIR, "grid": None, "solvers": ["kelvin-voigt"]}, fakes.shifted, ""),
    "the model refuses some": ({"column": _GAPS, "grid": None, "solvers": _LIKE}, get_solver, _HELD),
    "agreement": ({"solvers": ["mujoco"]}, fakes.perfect, "MuJoCo ends where the model does: there is "),
    "agreement beside a failure": ({}, fakes.perfect, "12 of 12 cells (12 unavailable), most often: no "),
    "nothing but failures": ({"solvers": ["mujoco", "pybullet"]}, fakes.refusing, _NOTHING),
    "the model fails too": ({"solvers": ["mujoco"]}, fakes.refusing_all, _NOTHING),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", RUNS)
def test_terminal_and_page_show_it(kind, tmp_path, command):
    changes, resolve, says = RUNS[kind]
    root = swept(tmp_path / "run", resolve, **changes).root
    shown = " ".join(command(["show", root]).split())
    assert says in shown
    assert ("one vote" in shown) == (kind == "the model refuses some")  # without a result it is no vote
    command(["report", root])
    page, said = (root / "report.html").read_text(encoding="utf-8"), "in all but the model and Liu-Zhao"
    assert (f"Gravity acts {said}-Brogliato." in page) == (kind == "no engine")
