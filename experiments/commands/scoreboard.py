"""Command ``impact-xval scoreboard``: compares the answers of all engines to simultaneous impacts with exact laws."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from impact_xval.experiments.commands.options import Solvers, Workers, known_solvers, option, parse_path
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.renamed import CASES, STATUSES

if TYPE_CHECKING:  # these modules import NumPy
    from impact_xval.experiments.scoreboard.environments import Environment, NotInstalledError


def scoreboard_command(
    solver: Solvers = None,
    out: Path | None = option("DIR", "Folder to write; by default runs/scoreboard.", parse_path),
    baseline: Path | None = option("DIR", "Folder of an earlier scoreboard to compare with.", parse_path),
    requirements: Annotated[
        list[str] | None,
        typer.Option(
            "--with",
            metavar="REQUIREMENT",
            help="Version of an engine to install and ask, such as mujoco==3.3.7; may be repeated.",
        ),
    ] = None,
    workers: Workers = None,
) -> None:
    """Ask every engine what happens when bodies meet at once.

    The command compares installed engines, with several settings, with every exact law. The collisions are chains and,
    for engines that solve balls in a plane, contact graphs. You get a table and a page. With --baseline, the exit code
    is 3 if an answer changed or a solver is missing. The same command continues a scoreboard that was stopped.

    Each version given by --with is installed in its own environment in your cache folder, with uv if you have it,
    otherwise with pip. Then the answers that differ between versions are printed. With --solver, only these solvers
    are run.

    Example: impact-xval scoreboard --with mujoco==3.3.7 --with mujoco==4.0.0
    """
    names = known_solvers(solver) if solver else ()
    import pandas as pd

    from impact_xval.experiments.presentation.terminal import make_console, print_blocks, show_progress
    from impact_xval.experiments.scoreboard.judging import list_moved_answers
    from impact_xval.experiments.scoreboard.page import ANSWERS, frame_table, write_scoreboard
    from impact_xval.experiments.scoreboard.plane import (
        collect_plane_answers,
        list_plane_entrants,
        write_plane,
    )
    from impact_xval.experiments.scoreboard.playing import collect_answers, list_entrants
    from impact_xval.experiments.scoreboard.releases import compare_releases, write_releases
    from impact_xval.experiments.sweep.pool import available_cores

    try:
        before = None if baseline is None else pd.read_parquet(baseline / ANSWERS)
    except (OSError, ValueError) as error:
        raise UserError(f"--baseline = {baseline}: holds no {ANSWERS} of a scoreboard: {error}") from None
    if before is not None:
        # Files of version 0.4 have the old names of cases and statuses.
        before = before.replace({"case": CASES, "status": STATUSES})
    elsewhere, missing = _make_environments(requirements or (), names)
    console, root = make_console(), out or Path("runs") / "scoreboard"
    with show_progress(console) as progress:
        answers, answers_elsewhere = collect_answers(
            list_entrants(names), root, workers or available_cores(), progress, elsewhere
        )
        entrants = list_plane_entrants(list_entrants(names))
        answers_in_plane = collect_plane_answers(entrants, root, workers or available_cores(), progress)
    sections = [write_plane(answers_in_plane, root)]
    if requirements:
        sections.append(
            write_releases(compare_releases(answers, answers_elsewhere), missing, answers_elsewhere, root)
        )
    print_blocks(console, [*write_scoreboard(answers, root, sections), f"the page is {root / 'report.html'}"])
    for section in sections:
        print_blocks(console, ["", section.title, *section.blocks])
    gone: list[str] = []
    moved = answers.head(0)
    if before is not None:
        gone = [] if solver else sorted(set(before.solver) - set(answers.solver))
        print_blocks(console, [f"{name}: is in {baseline}, but not in this scoreboard" for name in gone])
        moved = list_moved_answers(before, answers)
        caption = f"{len(moved)} answers differ from those in {baseline}; the largest differences"
        table = frame_table(moved.head(20), caption, 6)
        print_blocks(console, [f"no answer differs from those in {baseline}" if moved.empty else table])
    if missing:
        raise _all_in_one(missing)
    if gone or len(moved):
        raise typer.Exit(3)


def _make_environments(
    texts: Sequence[str], names: Sequence[str]
) -> tuple[list[tuple[str, Environment]], list[NotInstalledError]]:
    """Install the versions of engines after --with, each in its own environment.

    Return two things: the environment of each solver of these engines, by solver, and the errors of versions that could
    not be installed. If `names` is not empty, only solvers with these names are returned. If no version can be
    installed, a `UserError` with the first reason is raised.
    """
    if not texts:
        return [], []
    from impact_xval.experiments.presentation.terminal import report_waiting
    from impact_xval.experiments.scoreboard.environments import (
        NotInstalledError,
        make_environment,
        read_requirement,
        solvers_by_distribution,
    )

    solvers = {
        distribution: [name for name in own if not names or name in names]
        for distribution, own in solvers_by_distribution().items()
    }
    requirements = list(map(read_requirement, dict.fromkeys(texts)))
    for requirement in requirements:
        if not solvers[requirement.name]:
            legal = ", ".join(solvers_by_distribution()[requirement.name])
            raise UserError(f"--with {str(requirement)!r}: no --solver is of this engine; legal: {legal}")
    elsewhere: list[tuple[str, Environment]] = []
    missing: list[NotInstalledError] = []
    for requirement in requirements:
        try:
            with report_waiting(f"installing {requirement} in its own environment"):
                environment = make_environment(requirement)
        except NotInstalledError as error:
            missing.append(error)
        else:
            elsewhere += [(name, environment) for name in solvers[requirement.name]]
    if not elsewhere:
        raise _all_in_one(missing)
    return elsewhere, missing


def _all_in_one(missing: Sequence[NotInstalledError]) -> UserError:
    """Return one error for several versions that could not be installed.

    The message has the reason why the first version could not be installed, and the names of the other versions.
    """
    first, *others = missing
    more = "".join(f", {other.requirement}" for other in others)
    return UserError(f"{first}" + (f" (and {len(others)} more:{more.removeprefix(',')})" if others else ""))
