"""Commands that make a run, and those that show a run's folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from impact_xval.experiments.commands.options import (
    Folder,
    JsonObject,
    Resume,
    Scheduler,
    Workers,
    config_file,
    folder_to_write,
    path,
    whole,
)


def run(
    config: Annotated[Path | None, config_file("The experiment; without it, the built-in grid.")] = None,
    out: Annotated[Path | None, folder_to_write("by default runs/NAME")] = None,
    workers: Workers = None,
    resume: Resume = False,
    scheduler: Scheduler = None,
) -> None:
    """Run an experiment over its cells: tables, summary, figures and a report in one folder."""
    from impact_xval.experiments.commands import commands

    commands.run(config, out, workers, resume, scheduler)


def search(
    config: Annotated[
        Path | None, config_file("The experiment, with a table [search]; by default built in.")
    ] = None,
    out: Annotated[Path | None, folder_to_write("by default runs/NAME-search")] = None,
    solver: Annotated[
        str | None, typer.Option(metavar="NAME", help="The solver, in place of the file's.")
    ] = None,
    workers: Workers = None,
    resume: Resume = False,
    scheduler: Scheduler = None,
) -> None:
    """Search a box of parameters for the worst divergence of a solver from the model."""
    from impact_xval.experiments.commands import commands

    commands.search(config, out, solver, workers, resume, scheduler)


def status(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", parser=path("DIR"), help="Folder of a run, finished or not."),
    ],
    json: JsonObject = False,
) -> None:
    """Say what a run has done, what failed and why, and how fast it goes; also while it runs."""
    from impact_xval.experiments.commands import commands

    commands.status(folder, as_json=json)


def table(folder: Folder) -> None:
    """Write the summary of a finished run again, and show it."""
    from impact_xval.experiments.commands import commands

    commands.table(folder)


def figures(folder: Folder) -> None:
    """Draw the figures of a finished run again."""
    from impact_xval.experiments.commands import commands

    commands.figures(folder)


def report(folder: Folder) -> None:
    """Write the report of a finished run again."""
    from impact_xval.experiments.commands import commands

    commands.report(folder)


def _cell(text: str) -> int:
    return whole("--cell", text, 0, 10**7)


def ladder(
    folder: Folder,
    law: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="What if: the dissipation law on the way; kelvin-voigt, kelvin-voigt-anchored, "
            "kelvin-voigt-textbook or hunt-crossley.",
        ),
    ] = "kelvin-voigt",
    cell: Annotated[
        int | None, typer.Option(metavar="N", parser=_cell, help="Show one cell, from 0.")
    ] = None,
) -> None:
    """Show why the engines of a finished run diverge: frozen positions, law, gravity, mapping, time step.

    Another law than kelvin-voigt splits the rung of the dissipation law into what that law would leave and
    what the choice of the dashpot adds, and writes ladder-NAME.parquet and .csv into the folder.
    """
    from impact_xval.experiments.commands import ladder_commands

    ladder_commands.ladder(folder, law, cell)
