"""Output on a terminal and in a log: progress, the end of a run, single cells and chains, and small runs."""

import io
import math
import re
import shlex

import pyarrow.parquet as pq
import pytest
from rich.console import Console

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.config.collision_options import parse_collision
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.presentation.page.opened import collect_cells
from impact_xval.experiments.presentation.terminal import show_progress
from impact_xval.experiments.presentation.views import show_end
from tests.experiments import fakes
from tests.experiments.conftest import swept


def test_a_log_has_a_line_for_the_first_rows_and_for_each_tenth():
    console = Console(file=io.StringIO(), width=150)
    with show_progress(console) as progress:
        for done in range(0, 101):
            progress(done, 100, "")
            progress(done, 100, "")
    lines = console.file.getvalue().splitlines()
    assert len(lines) == 11
    assert lines[0].startswith("0 of 100 cells after ")
    assert lines[6].startswith("60 of 100 cells after ")


def test_a_terminal_shows_lines_above_the_bar(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")  # a dumb terminal gets the lines of a log
    console = Console(file=io.StringIO(), width=40, height=24, force_terminal=True, color_system=None)
    with show_progress(console) as progress:
        progress(8, 32, "")
        progress(8, 32, "a line worth [b]saying[/b]")
    shown = console.file.getvalue()
    assert "8/32" in shown
    assert "worth [b]saying[/b]" in shown


def test_the_end_of_a_run_is_one_screen(fake_run):
    summary = summarise(fake_run)
    for width, lines in ((80, 30), (120, 24)):
        console = Console(file=io.StringIO(), width=width, force_terminal=True, color_system=None)
        show_end(console, summary, 61.4, "/runs/default")
        printed = console.file.getvalue().splitlines()
        assert len(printed) <= lines
        assert max(map(len, printed)) <= width
        (row,) = (line.split() for line in printed if line.startswith("kelvin-voigt  mujoco"))
        assert row == ["kelvin-voigt", "mujoco", "12", "0.01", "0.01", "0.01", "100.0", "%", "0"]


def test_a_chain_is_shown_with_its_ladder_or_why_it_has_none(chain_run, command):
    ladder = pq.read_table(chain_run / "ladder.parquet").to_pandas()
    assert (len(ladder), (ladder.status == "ok").sum()) == (24, 12)
    shown = " ".join(command(["show", chain_run, "--cell", "0"]).split())
    assert "cell 0: balls = 2, arrangement = cradle" in shown
    assert ladder.sentence[0].replace("mujoco", "MuJoCo") in shown
    assert "mujoco: unrepresentable: exponent = 1.5" in command(["show", chain_run, "--cell", "2"])
    shown = " ".join(command(["show", chain_run]).split())
    assert "Over the 12 chains in which all causes are known, the mean D of MuJoCo is " in shown


def test_a_cell_of_a_grid_in_si_units_is_named_and_opened_again_in_them(tmp_path, command):
    grid = {"m1": [0.5, 2.0], "m2": [0.3], "k1": [1e5], "k2": [7e5], "e": [0.9]}
    folder = swept(tmp_path / "run", fakes.shifted, grid=grid, solvers=["mujoco"], v0=-3.0)
    shown = command(["show", folder.root, "--cell", "1"])
    assert "m1 = 2 kg, m2 = 0.3 kg, k1 = 100000 N/m, k2 = 700000 N/m" in shown
    cell = collect_cells(folder, [1])[1]
    assert (cell["at"]["m2/m1"], cell["at"]["m1 in kg"], cell["at"]["k2 in N/m"]) == ("0.15", "2", "700000")
    (again,) = (line for what, line in cell["commands"] if what.startswith("solve again"))
    options = dict(zip(*[iter(shlex.split(again)[2:])] * 2, strict=True))
    collision, _, _ = parse_collision({name[2:].replace("-", "_"): value for name, value in options.items()})
    assert collision.masses == (2.0, 0.3)
    assert collision.stiffnesses == pytest.approx((1e5, 7e5), rel=1e-15)


def test_the_scenario_is_said(fake_run, tmp_path, command):
    drop = swept(tmp_path / "run", fakes.shifted, scenario="drop", solvers=["mujoco"])
    words = "solve --stiffness-ratio 2 --mass-ratio 1.5 --e1 0.9 --e2 0.7 --solver state-transition"
    without, gravity = "without gravity (scenario impact)", "with gravity 9.81 m/s^2 (scenario drop)"
    for start, option, end in (("show", fake_run.root, drop.root), (words, "", "--scenario drop")):
        for more in ("", "--cell 1") if start == "show" else ("",):
            impact, fall = (command(f"{start} {scenario} {more}") for scenario in (option, end))
            assert without in impact.lower()
            assert gravity in fall.lower()


def test_the_cell_with_the_largest_d_is_named_by_its_number(fake_run, command):
    shown = " ".join(command(["show", fake_run.root]).split())
    (number,) = re.findall(r"MuJoCo has its largest D at k2/k1 = [^()]* \(cell (\d+)\)\.", shown)
    cells = pq.read_table(fake_run.table_path("divergence.parquet")).to_pandas()
    rows = cells[cells.solver == "mujoco"].set_index("cell")
    assert rows.velocity_divergence[int(number)] == rows.velocity_divergence.max()


def test_a_command_for_two_balls_refuses_a_run_of_chains(chain_run, refused):
    refused(["scene", chain_run, "0"], "chains of N balls; legal: ")


#: Parts of configurations of small runs.
_ONE = {"stiffness_ratio": [2.0], "mass_ratio": [1.5], "e1": [0.9], "e2": [0.7]}
_LIMITS = {"stiffness_ratio": [0, 1, math.inf], "mass_ratio": [1.0], "e1": [0.0], "e2": [0.0, 1.0]}
_PAIR = {"balls": 2, "arrangement": "row", "e": [0.5, 0.9], "stiffness_taper": 1.0}
_GAPS = {"balls": 3, "arrangement": "cradle", "gap": [0.0, 1e-5], "e": 0.9, "stiffness_taper": 1.0}
_LIKE, _HELD = ["kelvin-voigt", "mujoco"], "Extrapolated to a time step of zero, MuJoCo differs "
_NOTHING = "Nothing could be compared."

#: Configuration, solvers, and a part of the output.
RUNS = {
    "one cell": ({"grid": _ONE, "solvers": ["mujoco"]}, fakes.shifted, ""),
    "the model alone": ({"grid": _ONE, "solvers": ["state-transition"]}, fakes.shifted, _NOTHING),
    "no engine": ({"solvers": ["liu-zhao-brogliato", "kelvin-voigt"], "scenario": "drop"}, fakes.shifted, ""),
    "limits": ({"grid": _LIMITS, "grazing_threshold": 0.0}, fakes.shifted, ""),
    "one contact": ({"chain": _PAIR, "grid": None, "solvers": ["kelvin-voigt"]}, fakes.shifted, ""),
    "the model refuses some": ({"chain": _GAPS, "grid": None, "solvers": _LIKE}, get_solver, _HELD),
    "agreement": (
        {"solvers": ["mujoco"]},
        fakes.perfect,
        "MuJoCo ends where the model does, so there is no difference ",
    ),
    "agreement beside a failure": (
        {},
        fakes.perfect,
        "12 of 12 cells (12 unavailable). The most frequent reason: no ",
    ),
    "nothing but failures": ({"solvers": ["mujoco", "pybullet"]}, fakes.refusing, _NOTHING),
    "the model fails too": ({"solvers": ["mujoco"]}, fakes.refusing_all, _NOTHING),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", RUNS)
def test_terminal_and_page_show_small_runs(kind, tmp_path, command):
    changes, resolve, says = RUNS[kind]
    root = swept(tmp_path / "run", resolve, **changes).root
    shown = " ".join(command(["show", root]).split())
    assert says in shown
    # A solver without a result confirms nothing.
    assert ("no independent confirmation" in shown) == (kind == "the model refuses some")
    command(["report", root])
    page, said = (
        (root / "report.html").read_text(encoding="utf-8"),
        "in all solvers except the model and Liu-Zhao",
    )
    assert (f"Gravity acts {said}-Brogliato." in page) == (kind == "no engine")
