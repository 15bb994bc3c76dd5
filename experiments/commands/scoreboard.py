"""The command that asks every engine what happens when several bodies meet at once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from impact_xval.experiments.commands.options import Solvers, Workers, folder_to_write, path
from impact_xval.experiments.config.errors import UserError


def scoreboard(
    solver: Solvers = None,
    out: Annotated[Path | None, folder_to_write("by default runs/scoreboard")] = None,
    baseline: Annotated[
        Path | None,
        typer.Option(metavar="DIR", parser=path("--baseline"), help="A scoreboard to hold this one against."),
    ] = None,
    workers: Workers = None,
) -> None:
    """Ask every engine what happens when bodies meet at once.

    Installed engines and their settings against every exact law: a table, a page. With --baseline, exit code 3 if an
    answer moved. The same command continues one that was stopped.

    Example: impact-xval scoreboard --out now --baseline before
    """
    from impact_xval.experiments.config.experiment import solvers_problem
    from impact_xval.experiments.scoreboard.judging import judge, laws, moved, read_answers

    problem = solvers_problem(solver) if solver else None
    if problem:
        raise UserError(f"--solver {problem}")
    before = read_answers(baseline) if baseline is not None else None
    from impact_xval.experiments.presentation.terminal import make_console, print_line, show, show_progress
    from impact_xval.experiments.scoreboard.page import answers_in_words, table_of, worst_of, write_all
    from impact_xval.experiments.scoreboard.playing import entrants, play
    from impact_xval.experiments.sweep.pool import available_cores

    console, root = make_console(), out or Path("runs") / "scoreboard"
    with show_progress(console) as progress:
        answers = play(entrants(solver or ()), root, workers or available_cores(), progress)
    judged = judge(answers)
    followed = laws(judged)
    write_all(answers, judged, followed, root)
    brief = worst_of(followed[["law", "farthest", "next", "next_farthest", "spread", "microseconds"]])
    show(console, [brief, *answers_in_words(judged, followed), f"the page is {root / 'report.html'}"])
    if before is None:
        return
    for name in sorted(set(before.solver) - set(answers.solver)):
        print_line(console, f"{name}: in {baseline}, and not here")
    found = moved(before, answers)
    if found.empty:
        print_line(console, f"no answer moved from those in {baseline}")
        return
    columns = ["solver", "case", "e", "arrangement", "status_before", "status_after", "change"]
    caption = f"{len(found)} answers moved from those in {baseline}; the largest"
    show(console, [table_of(found[columns].head(20), caption, 6)])
    raise typer.Exit(3)
