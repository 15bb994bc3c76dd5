"""Commands that put something to the test: a hypothesis, engines, scenes, solvers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from impact_xval.experiments.commands.options import (
    Workers,
    config_file,
    folder_to_write,
    path,
)


def hypothesis(
    config: Annotated[Path | None, config_file("What to test; without it, the built-in design.")] = None,
    out: Annotated[Path | None, folder_to_write("by default runs/hypothesis")] = None,
    workers: Workers = None,
) -> None:
    """Test the supplement's hypothesis that an infinitely stiff pair acts as one body.

    Writes hypothesis.md (a page of what was found), its tables and its figures.
    """
    from impact_xval.experiments.commands.hypothesis import run_command

    run_command(config, out, workers)


def calibrate(
    engine: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="An engine; may be repeated. By default all.")
    ] = None,
    out: Annotated[Path, folder_to_write("new or empty")] = Path("runs/calibration"),
) -> None:
    """Ask each engine for single contacts, and tabulate what restitution and duration it returns.

    One ball on the table, and one ball on another in free fall, over restitution, stiffness (6 decades) and
    time step; by the calibrated mapping of k and e to the engine's parameters, and by the naive one.
    """
    from impact_xval.experiments.commands import commands

    commands.calibrate(engine, out)


def doctor(
    scene: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SCENE]",
            parser=path("SCENE"),
            help="MJCF file, PyBullet script (run up to its first step), URDF, CONFIG.toml or folder of a run; "
            "without it, the built-in experiment.",
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print a JSON list, an object a trap.")] = False,
) -> None:
    """Look for the traps engines set: contact parameters that are replaced, ignored or not what they seem.

    Exit code 1 if there are any.
    """
    from impact_xval.experiments.commands import doctor as command

    command.doctor(scene, as_json=json)


def solvers() -> None:
    """List the solvers: their versions, where they come from, and why one cannot run here."""
    from impact_xval.experiments.commands import solver_commands

    solver_commands.show_solvers()


def conform(
    name: Annotated[str, typer.Argument(metavar="SOLVER", help="Name of a solver.")],
    law: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="What its contacts obey: 'kelvin-voigt', 'hunt-crossley' or 'none' to leave it out.",
        ),
    ] = "kelvin-voigt",
) -> None:
    """Check whether a solver keeps the contract; for authors of adapters. Exit code 1 if it does not."""
    from impact_xval.experiments.commands import solver_commands

    solver_commands.conform(name, law)
