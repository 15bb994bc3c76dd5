"""What is seen of work that goes on, on a terminal and in a log, and at the end of a run."""

import io
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest
from rich.console import Console

from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.presentation.terminal import show, show_progress
from impact_xval.experiments.presentation.views import show_end
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import fakes
from tests.experiments.conftest import SMALL

MEDIANS = [("bistiffness", "bistiffness", 16, 0.21534), ("kelvin-voigt", "mujoco", 8, 0.1)]


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands until it is set, for all that is said of time."""
    stopped = SimpleNamespace(now=100.0)
    stopped.perf_counter = lambda: stopped.now
    monkeypatch.setattr("impact_xval.experiments.presentation.terminal.time", stopped)
    return stopped


def test_a_log_has_a_line_for_the_first_rows_and_for_each_tenth(clock):
    console, medians = Console(file=io.StringIO(), width=150), []
    with show_progress(console, medians=lambda: medians) as progress:
        medians.append(MEDIANS[0])
        for done in range(0, 101):
            progress(done, 100, "")
            progress(done, 100, "")
            if done == 50:
                medians.append(MEDIANS[1])
    lines = console.file.getvalue().splitlines()
    assert len(lines) == 11
    assert lines[0] == "0 of 100 cells after 0 s; median D so far: bistiffness 0.215 (16)"
    assert lines[6].startswith("60 of 100 cells after 0 s, 0:00:00 left at this rate; ")
    assert lines[6].endswith("median D so far: bistiffness 0.215 (16), mujoco 0.1 (8)")


@pytest.mark.parametrize("output", ["/dev/full", "pipe"])
def test_an_output_that_takes_nothing_is_an_error_that_names_it(output):
    if output == "pipe":
        read, write = os.pipe()
        os.close(read)
    else:
        write = os.open(output, os.O_WRONLY)
    script = (
        "from impact_xval.experiments.presentation.terminal import make_console\n"
        "try:\n    make_console().print('a line')\nexcept OSError as error:\n    raise SystemExit(f'{error.filename}')"
    )
    done = subprocess.run([sys.executable, "-c", script], stdout=write, stderr=subprocess.PIPE, check=False)
    os.close(write)
    assert done.stderr.decode().splitlines()[0] == "standard output"


def test_a_log_without_medians_counts_only():
    console = Console(file=io.StringIO(), width=150)
    with show_progress(console, "contacts") as progress:
        progress(0, 0, "a line")
        progress(1, 2, "")
    assert console.file.getvalue().splitlines() == ["a line", "1 of 2 contacts after 0 s"]


@pytest.mark.parametrize("width", [40, 80, 120])
def test_a_terminal_shows_the_medians_above_the_bar(width):
    console = Console(file=io.StringIO(), width=width, height=24, force_terminal=True, color_system=None)
    with show_progress(console, medians=lambda: MEDIANS) as progress:
        progress(8, 32, "")
        progress(8, 32, "a line worth [b]saying[/b]")
    shown = console.file.getvalue()
    for text in ("solver", "median D", "bistiffness", "0.215", "mujoco", "8/32", "worth [b]saying[/b]"):
        assert text in shown
    plain = shown.replace("\r", "\n").splitlines()
    assert max(len(line.split("\x1b[2K")[-1].replace("\x1b[?25l", "")) for line in plain) <= width
    assert shown.rstrip().endswith("\x1b[2K")  # the table is gone once there is more to say


def test_what_was_shown_stays_where_work_is_stopped():
    console = Console(file=io.StringIO(), width=80, force_terminal=True, color_system=None)

    def stopped():
        with show_progress(console, medians=lambda: MEDIANS) as progress:
            progress(8, 32, "")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    *_, last, end = console.file.getvalue().splitlines()
    assert "8/32" in last
    assert "\x1b[2K" not in end


@pytest.fixture(scope="module")
def summary(tmp_path_factory):
    config = parse_config(SMALL | {"solvers": ["bistiffness", "kelvin-voigt", "mujoco", "pybullet"]})
    folder = tmp_path_factory.mktemp("shown") / "run"
    return summarise(run_sweep(config, folder, isolate=False, resolve=fakes.shifted))


@pytest.mark.parametrize(("width", "lines"), [(80, 30), (120, 24)])
def test_the_end_of_a_run_is_one_screen(summary, width, lines):
    console = Console(file=io.StringIO(), width=width, force_terminal=True, color_system=None)
    show_end(console, summary, 61.4, "/runs/default")
    printed = console.file.getvalue().splitlines()
    assert len(printed) <= lines
    assert max(map(len, printed)) <= width
    (row,) = (line.split() for line in printed if line.startswith("kelvin-voigt  mujoco"))
    assert row == ["kelvin-voigt", "mujoco", "12", "0.01", "0.01", "0.01", "100.0", "%", "0"]
    assert printed[-1] == "61 s; report.html is the page to read; everything is in /runs/default"


def test_a_page_is_shown_line_by_line():
    console = Console(file=io.StringIO(), width=80)
    show(console, "One\n\n**Of**\n\n| a | b |\n| --- | --: |\n| c | 1 |\n\nTwo\n")
    assert [line.rstrip() for line in console.file.getvalue().splitlines()] == [
        "One", "", "Of", "a  b", "c  1", "", "Two",
    ]  # fmt: skip


@pytest.mark.parametrize("terminal", [True, False])
def test_a_solver_has_the_colour_of_the_figures_on_a_terminal(terminal):
    page = "| solver | n |\n| --- | --- |\n| mujoco | 1 |\n| state-transition | 2 |\n"
    file = io.StringIO()
    show(
        Console(
            file=file, force_terminal=terminal, color_system="truecolor" if terminal else "auto", width=60
        ),
        page,
    )
    blue = "\x1b[38;2;0;114;178mmujoco"  # #0072B2
    assert (blue in file.getvalue()) == terminal
    assert ("\x1b" in file.getvalue()) == terminal
    assert re.search(r"^state-transition +2", file.getvalue(), re.M)
