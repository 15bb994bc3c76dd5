"""The command that asks every engine what happens when several bodies meet at once."""

from __future__ import annotations

from pathlib import Path

import typer

from impact_xval.experiments.commands.options import Solvers, Workers, known_solvers, option, path
from impact_xval.experiments.config.errors import UserError


def scoreboard(
    solver: Solvers = None,
    out: Path | None = option("DIR", "Folder to write; by default runs/scoreboard.", path),
    baseline: Path | None = option("DIR", "A scoreboard to hold this one against.", path),
    workers: Workers = None,
) -> None:
    """Ask every engine what happens when bodies meet at once.

    Installed engines and their settings against every exact law: a table, a page. With --baseline, exit code 3 if an
    answer moved, or a solver is gone. The same command continues one that was stopped.

    Example: impact-xval scoreboard --out now --baseline before
    """
    names = known_solvers(solver) if solver else ()
    import pandas as pd

    from impact_xval.experiments.presentation.terminal import make_console, show, show_progress
    from impact_xval.experiments.scoreboard.judging import moved
    from impact_xval.experiments.scoreboard.page import ANSWERS, table_of, write_all
    from impact_xval.experiments.scoreboard.playing import entrants, play
    from impact_xval.experiments.sweep.pool import available_cores

    try:
        before = None if baseline is None else pd.read_parquet(baseline / ANSWERS)
    except (OSError, ValueError) as error:
        raise UserError(f"--baseline = {baseline}: holds no {ANSWERS} of a scoreboard: {error}") from None
    console, root = make_console(), out or Path("runs") / "scoreboard"
    with show_progress(console) as progress:
        answers = play(entrants(names), root, workers or available_cores(), progress)
    show(console, [*write_all(answers, root), f"the page is {root / 'report.html'}"])
    if before is None:
        return
    gone = [] if solver else sorted(set(before.solver) - set(answers.solver))
    show(console, [f"{name}: in {baseline}, and not here" for name in gone])
    found = moved(before, answers)
    caption = f"{len(found)} answers moved from those in {baseline}; the largest"
    table = table_of(found.head(20), caption, 6)
    show(console, [f"no answer moved from those in {baseline}" if found.empty else table])
    if gone or len(found):
        raise typer.Exit(3)
