"""The command ``impact-xval``.

Exit codes: 0 done, 2 what the user asked for is wrong (one line on standard error), 1 anything else.
Everything heavy is imported inside the commands, so that help and usage errors come at once.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer

from experiments.errors import UserError

app = typer.Typer(
    help="Cross-validate physics engines against the state-transition model of simultaneous impacts.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a finished run.")]


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    show_version: Annotated[bool, typer.Option("--version", help="Print the version and end.")] = False,
) -> None:
    if show_version:
        typer.echo(f"impact-xval {version('impact-xval')}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command()
def run(
    config: Annotated[
        Path | None,
        typer.Argument(metavar="[CONFIG.toml]", help="The experiment; without it, the built-in grid."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder to write; by default runs/NAME.")
    ] = None,
    workers: Annotated[
        str | None, typer.Option(metavar="N", help="Processes; by default one for every core.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the run that is in the folder.")] = False,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Run on a Dask cluster: the address of its scheduler, or 'local' for one here.",
        ),
    ] = None,
) -> None:
    """Run an experiment over its cells: tables, summary, figures and a report in one folder."""
    from experiments import commands

    commands.run(config, out, commands.whole("--workers", workers, 1, 4096), resume, scheduler)


@app.command()
def search(
    config: Annotated[
        Path | None,
        typer.Argument(
            metavar="[CONFIG.toml]", help="The experiment, with a table [search]; by default built in."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder to write; by default runs/NAME-search.")
    ] = None,
    solver: Annotated[
        str | None, typer.Option(metavar="NAME", help="The solver, in place of the file's.")
    ] = None,
    workers: Annotated[
        str | None, typer.Option(metavar="N", help="Processes; by default one for every core.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the search that is in the folder.")
    ] = False,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Search on a Dask cluster: its scheduler, or 'local' for one here."
        ),
    ] = None,
) -> None:
    """Search a box of parameters for the worst divergence of a solver from the model."""
    from experiments import commands

    number = commands.whole("--workers", workers, 1, 4096)
    commands.search(config, out, solver, number, resume, scheduler)


@app.command()
def status(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run, finished or not.")],
    json: Annotated[bool, typer.Option("--json", help="Print a JSON object.")] = False,
) -> None:
    """Say what a run has done, what failed and why, and how fast it goes; also while it runs."""
    from experiments import commands

    commands.status(folder, as_json=json)


@app.command()
def solve(
    stiffness_ratio: Annotated[str, typer.Option(metavar="R", help="k2/k1, from 0 to inf.")],
    mass_ratio: Annotated[str, typer.Option(metavar="R", help="m2/m1, greater than 0.")],
    e1: Annotated[str, typer.Option(metavar="E", help="Restitution of ball on ball, from 0 to 1.")],
    e2: Annotated[str, typer.Option(metavar="E", help="Restitution of ball on table, from 0 to 1.")],
    solver: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A solver; may be repeated. By default all.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print a JSON list, an object a solver.")] = False,
    scenario: Annotated[
        str, typer.Option(metavar="NAME", help="'impact' (no gravity) or 'drop'.")
    ] = "impact",
    gravity: Annotated[str, typer.Option(metavar="G", help="In m/s^2; for a drop.")] = "9.81",
    m1: Annotated[str, typer.Option(metavar="KG", help="Mass of the upper ball.")] = "1",
    k1: Annotated[str, typer.Option(metavar="N/M", help="Stiffness of ball on ball.")] = "1e8",
    v0: Annotated[str, typer.Option(metavar="M/S", help="Velocity of the upper ball, less than 0.")] = "-1",
    step_fraction: Annotated[
        str, typer.Option(metavar="X", help="Time step over the period of the faster contact, at most 0.1.")
    ] = "1e-3",
    mapping: Annotated[str, typer.Option(metavar="NAME", help="'calibrated' or 'naive'.")] = "calibrated",
    cutoff: Annotated[
        str,
        typer.Option(metavar="X", help="Stiffness ratio beyond which the model takes a limit; inf: never."),
    ] = "1e5",
) -> None:
    """Solve one collision by every solver and show the results side by side.

    Velocities are per |v0| and impulses per m1 |v0|. Without gravity they depend on the four ratios only;
    masses, stiffness and velocity matter to a drop.
    """
    from experiments import commands

    values = {
        "stiffness_ratio": stiffness_ratio,
        "mass_ratio": mass_ratio,
        "e1": e1,
        "e2": e2,
        "scenario": scenario,
        "gravity": gravity,
        "m1": m1,
        "k1": k1,
        "v0": v0,
        "step_fraction": step_fraction,
        "mapping": mapping,
        "stiffness_ratio_cutoff": cutoff,
    }
    commands.solve(values, solver, as_json=json)


@app.command()
def table(folder: Folder) -> None:
    """Write the summary of a finished run again, and show it."""
    from experiments import commands

    commands.table(folder)


@app.command()
def figures(folder: Folder) -> None:
    """Draw the figures of a finished run again."""
    from experiments import commands

    commands.figures(folder)


@app.command()
def report(folder: Folder) -> None:
    """Write the report of a finished run again."""
    from experiments import commands

    commands.report(folder)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default those of the process.

    Returns
    -------
    int
        The exit code.
    """
    command = typer.main.get_command(app)
    # typer may carry its own copy of click: the class of usage errors is reached through typer alone.
    usage_error: Any = typer.BadParameter.__base__
    try:
        result = command.main(
            list(sys.argv[1:] if arguments is None else arguments),
            prog_name="impact-xval",
            standalone_mode=False,
        )
    except usage_error as error:
        return _fail(f"{error.format_message()} Try 'impact-xval --help'.", 2)
    except UserError as error:
        return _fail(str(error), 2)
    except (typer.Abort, KeyboardInterrupt):
        return _fail("interrupted", 1)
    except BrokenPipeError:
        return 1
    except OSError as error:
        return _fail(f"{error.filename or 'writing'}: {error.strerror or error}", 1)
    return result if isinstance(result, int) else 0


def _fail(message: str, code: int) -> int:
    print(f"impact-xval: {' '.join(message.split())}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
