"""What is seen on a terminal and in a log: work that goes on, the end of a run, a column of it."""

import io

import pyarrow.parquet as pq
from rich.console import Console

from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.presentation.terminal import show_progress
from impact_xval.experiments.presentation.views import show_end


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


def test_a_terminal_shows_lines_above_the_bar():
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


def test_a_column_is_shown_with_its_ladder_or_why_it_has_none(column_run, command):
    ladder = pq.read_table(column_run / "ladder.parquet").to_pandas()
    assert (len(ladder), (ladder.status == "ok").sum()) == (24, 12)
    shown = " ".join(command(["show", column_run, "--cell", "0"]).split())
    assert "cell 0: balls = 2, arrangement = cradle" in shown
    assert ladder.sentence[0].replace("mujoco", "MuJoCo") in shown
    assert "mujoco: unrepresentable: exponent = 1.5" in command(["show", column_run, "--cell", "2"])


def test_a_command_for_two_balls_refuses_a_run_of_columns(column_run, refused):
    refused(["scene", column_run, "0"], "columns of N balls; legal: ")
