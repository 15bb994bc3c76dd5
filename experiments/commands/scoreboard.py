"""The command that asks every engine what happens when several bodies meet at once."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Annotated

import typer

from impact_xval.experiments.commands.options import Solvers, Workers, folder_to_write, number, path
from impact_xval.experiments.config.errors import UserError


def scoreboard(
    solver: Solvers = None,
    out: Annotated[Path | None, folder_to_write("by default runs/scoreboard")] = None,
    baseline: Annotated[
        Path | None,
        typer.Option(metavar="DIR", parser=path("--baseline"), help="A scoreboard to hold this one against."),
    ] = None,
    tolerance: Annotated[
        str, typer.Option(metavar="T", help="With --baseline: change of a velocity per |v0| that is none.")
    ] = "1e-6",
    workers: Workers = None,
) -> None:
    """Ask every engine what happens when bodies meet at once.

    Installed engines and their settings against every exact law: a table, a page. With --baseline, exit code 3 if an
    answer moved. The same command continues one that was stopped.

    Example: impact-xval scoreboard --out now --baseline before
    """
    allowed = number("--tolerance", tolerance)
    if not 0 <= allowed < math.inf:
        raise UserError(f"--tolerance = {tolerance!r:.60}; legal: a finite number >= 0 (of |v0|)")
    from impact_xval.experiments.config.experiment import solvers_problem
    from impact_xval.experiments.scoreboard.judging import moved, read_answers

    problem = solvers_problem(solver) if solver else None
    if problem:
        raise UserError(f"--solver {problem}")
    before = read_answers(baseline) if baseline is not None else None
    from impact_xval.experiments.presentation.document import Table
    from impact_xval.experiments.presentation.terminal import make_console, print_line, show, show_progress
    from impact_xval.experiments.scoreboard.page import show_board, write_all
    from impact_xval.experiments.scoreboard.playing import entrants, play
    from impact_xval.experiments.sweep.pool import available_cores

    start, console = time.perf_counter(), make_console()
    root = out if out is not None else Path("runs") / "scoreboard"
    with show_progress(console) as progress:
        solvers, answers = play(entrants(solver or ()), root, workers or available_cores(), progress)
    show_board(console, write_all(solvers, answers, root))
    print_line(console, f"{time.perf_counter() - start:.0f} s; the page is {root / 'report.html'}")
    if before is None:
        return
    for name in sorted(set(before.solver) - set(answers.solver)):
        print_line(console, f"{name}: in {baseline}, and not here")
    found = moved(before, answers, allowed)
    if found.empty:
        print_line(console, f"no answer moved from those in {baseline}")
        return
    columns = ["solver", "case", "e", "arrangement", "status_before", "status_after", "change"]
    rows = found.sort_values("change", ascending=False)[columns].head(20).itertuples(index=False)
    show(
        console,
        [Table(columns, list(rows), f"{len(found)} answers moved from those in {baseline}; the largest", 6)],
    )
    raise typer.Exit(3)
