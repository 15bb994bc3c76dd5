"""``impact-xval scoreboard``: engines as people run them, beside exact laws; and what moved since another board."""

from __future__ import annotations

import math
import shlex
import time
from pathlib import Path
from typing import Annotated

import typer

from impact_xval.experiments.commands.options import Resume, Workers, folder_to_write, number, path
from impact_xval.experiments.config.errors import UserError

#: Exit codes: answers moved; a condition of --fail-if holds.
MOVED, HELD = 3, 4


def scoreboard(
    out: Annotated[Path | None, folder_to_write("by default scoreboard")] = None,
    setting: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="An engine with settings; may be repeated. By default all."),
    ] = None,
    fail_if: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CONDITION",
            help=f"Exit code {HELD} if it holds of an answer: 'energy > 1.01', or of divergence, law-divergence, "
            "spread, step-spread, momentum-error; or 'no answer'. May be repeated.",
        ),
    ] = None,
    baseline: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            parser=path("--baseline"),
            help=f"Another board: show what moved, exit code {MOVED} if something did.",
        ),
    ] = None,
    tolerance: Annotated[
        str, typer.Option(metavar="X", help="Largest change of a velocity per |v0| that is none.")
    ] = "1e-4",
    workers: Workers = None,
    resume: Resume = False,
) -> None:
    """Have all engines that are installed, with settings that people use, answer simultaneous impacts.

    Drops, cradles and a stack, at e = 1, 0.9 and 0.5, each also with a gap, at other steps and in another order: one
    table and one page, beside exact laws. Exit code 3 if answers moved since the baseline, 4 if a condition holds.
    """
    allowed = number("--tolerance", tolerance)
    if not 0 <= allowed < math.inf:
        raise UserError(f"--tolerance = {tolerance!r:.60}; legal: a finite number >= 0 (of |v0|)")
    # Imported when what was typed alone is known to be legal.
    from impact_xval.compliant_baselines.practical.practices import get_practice, practice_names
    from impact_xval.experiments.commands.supervision import last_word
    from impact_xval.experiments.presentation.pages import render
    from impact_xval.experiments.presentation.terminal import make_console, print_line, show, show_progress
    from impact_xval.experiments.scoreboard.board import answers_frame
    from impact_xval.experiments.scoreboard.judging import condition, moves, read_answers
    from impact_xval.experiments.scoreboard.page import run_facts, write_board
    from impact_xval.experiments.scoreboard.playing import play
    from impact_xval.experiments.sweep.executors import available_cores
    from impact_xval.experiments.tables.folders import new_folder
    from impact_xval.experiments.tables.lock import holding

    conditions = [(text, condition(text)) for text in fail_if or ()]
    names = list(dict.fromkeys(setting or practice_names()))
    for name in names:
        try:
            get_practice(name)
        except ValueError as error:
            raise UserError(f"--setting: {error}") from None
    before = read_answers(baseline) if baseline is not None else None
    root, start = out if out is not None else Path("scoreboard"), time.perf_counter()
    parts = root / "parts"
    if not (resume and parts.is_dir() and not parts.is_symlink()):
        new_folder(root)
        parts.mkdir()
    console = make_console()
    with holding(root):
        try:
            with show_progress(console, "settings") as progress:
                found = play(names, parts, workers or available_cores(), progress)
        except KeyboardInterrupt:
            words = ["impact-xval", "scoreboard", "--resume", "--out", str(root)]
            words += [word for name in setting or () for word in ("--setting", name)]
            last_word(f"interrupted; finished settings are kept; to continue: {shlex.join(words)}")
            raise typer.Exit(1) from None
        board, facts = write_board(root, found, time.perf_counter() - start)
    held = [(text, rows) for text, holds in conditions if len(rows := holds(board))]
    moved = None if before is None else moves(before, answers_frame(found), allowed)
    facts |= run_facts(board, held, moved, str(baseline))
    show(console, render("scoreboard_run.md.j2", **facts))
    print_line(
        console, f"{time.perf_counter() - start:.0f} s; {root / 'scoreboard.html'} is the page to read"
    )
    if moved is not None and len(moved.rows):
        raise typer.Exit(MOVED)
    if held:
        raise typer.Exit(HELD)
