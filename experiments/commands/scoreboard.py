"""Command ``impact-xval scoreboard``: compares the answers of all engines to simultaneous impacts with exact laws."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from impact_xval.experiments.commands.options import (
    Solvers,
    Workers,
    known_solvers,
    option,
    parse_path,
    stop_if_unavailable,
)
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:  # these modules import NumPy
    from impact_xval.experiments.scoreboard.environments import Environment, NotInstalledError


def scoreboard_command(
    solver: Solvers = None,
    out: Path | None = option(
        "DIR", "Folder to write; by default runs/scoreboard. Answers in it are read.", parse_path
    ),
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
    for engines that solve balls in a plane, contact graphs. You get a table and a page. With --solver, only the exact
    laws and the named solvers are run.

    The folder of --out keeps the answers of each solver that has finished. The same command reads them, so it continues
    a scoreboard that was stopped. It reads them even if the code of a solver changed, as long as its version is the
    same. To ask every solver again, remove the folder or choose another one.

    With --baseline, the exit code is 3 if an answer changed, if an answer of the baseline is missing now, or if the
    baseline lacks an answer of a solver named by --solver. With --solver, the baseline's other solvers are ignored.

    Each version given by --with is installed in its own environment in your cache folder, with uv if you have it,
    otherwise with pip. Then the answers that differ between versions are printed.

    Example: impact-xval scoreboard --with mujoco==3.3.7 --with mujoco==4.0.0
    """
    names = known_solvers(solver) if solver else ()
    from impact_xval.experiments.presentation.terminal import make_console, print_blocks, show_progress
    from impact_xval.experiments.scoreboard.baseline import compare_with_baseline, read_baseline
    from impact_xval.experiments.scoreboard.page import write_scoreboard
    from impact_xval.experiments.scoreboard.plane import (
        collect_plane_answers,
        list_plane_entrants,
        list_stored_in_plane,
        write_plane,
    )
    from impact_xval.experiments.scoreboard.playing import collect_answers, list_entrants, list_stored
    from impact_xval.experiments.scoreboard.releases import compare_releases, write_releases
    from impact_xval.experiments.sweep.pool import available_cores

    root = out or Path("runs") / "scoreboard"
    before = None if baseline is None else read_baseline(baseline)
    if baseline is not None and root.exists() and root.samefile(baseline):
        raise UserError(
            f"--baseline = {baseline}: is the folder of --out, which is written; legal: another folder"
        )
    elsewhere, missing = _make_environments(requirements or (), names)
    console = make_console()
    entrants = list_entrants(names)
    entrants_in_plane = list_plane_entrants(entrants)
    stored = [*list_stored(entrants, root, elsewhere), *list_stored_in_plane(entrants_in_plane, root)]
    if stored:
        print_blocks(console, [_describe_stored(stored, root)])
    with show_progress(console) as progress:
        answers, answers_elsewhere = collect_answers(
            entrants, root, workers or available_cores(), progress, elsewhere
        )
        answers_in_plane = collect_plane_answers(
            entrants_in_plane, root, workers or available_cores(), progress
        )
    sections = [write_plane(answers_in_plane, root)]
    if requirements:
        sections.append(
            write_releases(compare_releases(answers, answers_elsewhere), missing, answers_elsewhere, root)
        )
    print_blocks(console, [*write_scoreboard(answers, root, sections), f"the page is {root / 'report.html'}"])
    for section in sections:
        print_blocks(console, ["", section.title, *section.blocks])
    differs = False
    if before is not None:
        section, differs = compare_with_baseline(before, answers, answers_in_plane, root, solver or ())
        print_blocks(console, ["", section.title, *section.blocks])
    if missing:
        raise _all_in_one(missing)
    if differs:
        raise typer.Exit(3)
    frames = (answers, answers_elsewhere)
    stop_if_unavailable(
        solver, (row for each in frames for row in zip(each.solver, each.status, strict=True))
    )


def _describe_stored(stored: Sequence[str], root: Path) -> str:
    """Return a line that names the solvers whose answers are read, and says how to ask these solvers again."""
    from impact_xval.compliant_baselines.registry import exact_law_names
    from impact_xval.experiments.tables.numbers import join_words

    laws = {*stored} & {*exact_law_names()}
    others = [name for name in dict.fromkeys(stored) if name not in laws]
    names = join_words([*others, *([f"{len(laws)} exact laws"] if laws else [])])
    return (
        f"answers of the same versions are read from {root}, not asked again: {names}; to ask again, remove this "
        "folder or choose another --out"
    )


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
