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
    from experiments import collision_commands

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
    collision_commands.solve(values, solver, as_json=json)


@app.command()
def hypothesis(
    config: Annotated[
        Path | None,
        typer.Argument(metavar="[CONFIG.toml]", help="What to test; without it, the built-in design."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder to write; by default runs/hypothesis.")
    ] = None,
    workers: Annotated[
        str | None, typer.Option(metavar="N", help="Processes; by default one for every core.")
    ] = None,
) -> None:
    """Test the supplement's hypothesis that an infinitely stiff pair acts as one body.

    Writes hypothesis.md (a page of what was found), its tables and its figures.
    """
    from experiments import commands
    from experiments.hypothesis.command import run_command

    run_command(config, out, commands.whole("--workers", workers, 1, 4096))


@app.command()
def calibrate(
    engine: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="An engine; may be repeated. By default all.")
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write; new or empty.")] = Path(
        "runs/calibration"
    ),
) -> None:
    """Ask each engine for single contacts, and tabulate what restitution and duration it returns.

    One ball on the table, and one ball on another in free fall, over restitution, stiffness (6 decades) and
    time step; by the calibrated mapping of k and e to the engine's parameters, and by the naive one.
    """
    from experiments import commands

    commands.calibrate(engine, out)


@app.command()
def export_scene(
    folder: Annotated[
        Path | None, typer.Argument(metavar="[DIR]", help="Folder of a finished run, with --cell.")
    ] = None,
    cell: Annotated[str | None, typer.Option(metavar="N", help="Number of a cell of that run.")] = None,
    stiffness_ratio: Annotated[str | None, typer.Option(metavar="R", help="k2/k1, without a run.")] = None,
    mass_ratio: Annotated[str | None, typer.Option(metavar="R", help="m2/m1, without a run.")] = None,
    e1: Annotated[str | None, typer.Option(metavar="E", help="Restitution of ball on ball.")] = None,
    e2: Annotated[str | None, typer.Option(metavar="E", help="Restitution of ball on table.")] = None,
    solver: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="'mujoco' or 'pybullet'; may be repeated. By default both."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder to write; by default in scenes/.")
    ] = None,
    scenario: Annotated[
        str | None, typer.Option(metavar="NAME", help="'impact' (default) or 'drop'.")
    ] = None,
    gravity: Annotated[str | None, typer.Option(metavar="G", help="In m/s^2; for a drop.")] = None,
    m1: Annotated[str | None, typer.Option(metavar="KG", help="Mass of the upper ball.")] = None,
    k1: Annotated[str | None, typer.Option(metavar="N/M", help="Stiffness of ball on ball.")] = None,
    v0: Annotated[str | None, typer.Option(metavar="M/S", help="Velocity of the upper ball.")] = None,
    step_fraction: Annotated[
        str | None, typer.Option(metavar="X", help="Time step over the period of the faster contact.")
    ] = None,
    mapping: Annotated[
        str | None, typer.Option(metavar="NAME", help="'calibrated' (default) or 'naive'.")
    ] = None,
) -> None:
    """Write one cell as an MJCF file and as a PyBullet script that run in the engine alone.

    The cell is one of a finished run (DIR --cell N), or given by its ratios. The scripts print their velocities beside
    the tabulated ones and fail where they differ by more than 1e-12 of the speed.
    """
    from experiments import collision_commands

    values = {
        "stiffness_ratio": stiffness_ratio,
        "mass_ratio": mass_ratio,
        "e1": e1,
        "e2": e2,
        "scenario": scenario or ("impact" if folder is None else None),
        "gravity": gravity,
        "m1": m1,
        "k1": k1,
        "v0": v0,
        "step_fraction": step_fraction,
        "mapping": mapping,
    }
    collision_commands.export_scene(folder, cell, values, solver, out)


@app.command()
def contact(
    engine: Annotated[str, typer.Option(metavar="NAME", help="'mujoco', 'pybullet' or 'drake'.")],
    masses: Annotated[
        tuple[str, str], typer.Option(metavar="KG KG", help="Of the two bodies; inf for a fixed one.")
    ],
    restitution: Annotated[str, typer.Option(metavar="E", help="Greater than 0, at most 1.")],
    stiffness: Annotated[str | None, typer.Option(metavar="N/M", help="Of the contact.")] = None,
    duration: Annotated[
        str | None, typer.Option(metavar="S", help="Of the contact; instead of a stiffness.")
    ] = None,
    speed: Annotated[str, typer.Option(metavar="M/S", help="Speed of approach.")] = "1",
    gravity: Annotated[
        str, typer.Option(metavar="G", help="In m/s^2: also show a drop onto the fixed body under it.")
    ] = "0",
    tolerance: Annotated[
        str, typer.Option(metavar="X", help="Allowed relative error of restitution and duration.")
    ] = "0.01",
    json: Annotated[bool, typer.Option("--json", help="Print a JSON object.")] = False,
) -> None:
    """Print what to paste into a scene for one contact, and the largest step at which it means what it says.

    Give the two masses, the restitution, and the stiffness or the duration. Beside what was asked stands what
    verifying drops in the engine gave.
    """
    from experiments import contact as command

    values = {
        "masses": masses,
        "restitution": restitution,
        "stiffness": stiffness,
        "duration": duration,
        "speed": speed,
    }
    command.contact(engine, values, tolerance=tolerance, gravity=gravity, as_json=json)


@app.command()
def doctor(
    scene: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SCENE]",
            help="MJCF file, PyBullet script (run up to its first step), URDF, CONFIG.toml or folder of a run; "
            "without it, the built-in experiment.",
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print a JSON list, an object a trap.")] = False,
) -> None:
    """Look for the traps engines set: contact parameters that are replaced, ignored or not what they seem.

    Exit code 1 if there are any.
    """
    from experiments import doctor as command

    command.doctor(scene, as_json=json)


@app.command()
def solvers() -> None:
    """List the solvers: their versions, where they come from, and why one cannot run here."""
    from experiments import third_party

    third_party.show_solvers()


@app.command()
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
    from experiments import third_party

    third_party.conform(name, law)


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


@app.command()
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
    cell: Annotated[str | None, typer.Option(metavar="N", help="Show one cell, from 0.")] = None,
) -> None:
    """Show why the engines of a finished run diverge: frozen positions, law, gravity, mapping, time step.

    Another law than kelvin-voigt splits the rung of the dissipation law into what that law would leave and
    what the choice of the dashpot adds, and writes ladder-NAME.parquet and .csv into the folder.
    """
    from experiments import commands, ladder_commands

    ladder_commands.ladder(folder, law, commands.whole("--cell", cell, 0, 10**7))


@app.command("map")
def draw_map(
    e1: Annotated[str, typer.Option(metavar="E", help="Restitution of ball on ball, above 0, at most 1.")],
    e2: Annotated[str, typer.Option(metavar="E", help="Restitution of ball on table, above 0, at most 1.")],
    stiffness_ratio: Annotated[
        tuple[str, str], typer.Option(metavar="LO HI", help="Least and largest k2/k1; logarithmic.")
    ] = ("1e-3", "1e3"),
    mass_ratio: Annotated[
        tuple[str, str], typer.Option(metavar="LO HI", help="Least and largest m2/m1; logarithmic.")
    ] = ("0.1", "10"),
    side: Annotated[str, typer.Option(metavar="N", help="Cells along each side, 2 to 5000.")] = "1000",
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder to write; by default maps/SCENARIO-e1-E-e2-E."),
    ] = None,
    scenario: Annotated[str, typer.Option(metavar="NAME", help="'drop', or 'impact' (no gravity).")] = "drop",
    gravity: Annotated[str, typer.Option(metavar="G", help="In m/s^2; for a drop.")] = "9.81",
    m1: Annotated[str, typer.Option(metavar="KG", help="Mass of the upper ball; for a drop.")] = "1",
    k1: Annotated[str, typer.Option(metavar="N/M", help="Stiffness of ball on ball; for a drop.")] = "1e8",
    v0: Annotated[
        str, typer.Option(metavar="M/S", help="Velocity of the upper ball, less than 0; for a drop.")
    ] = "-1",
    cutoff: Annotated[
        str,
        typer.Option(metavar="X", help="Stiffness ratio beyond which the model takes a limit; inf: never."),
    ] = "1e5",
) -> None:
    """Map where each cause of divergence matters that needs no engine, over k2/k1 and m2/m1.

    A million collisions by the model, by its law in real time and by spring and dashpot, all exact, in less than a
    minute: figures, and map.parquet with one row a cell.
    """
    from experiments import commands, plane_commands

    values = {
        "e1": e1,
        "e2": e2,
        "scenario": scenario,
        "gravity": gravity,
        "m1": m1,
        "k1": k1,
        "v0": v0,
        "stiffness_ratio_cutoff": cutoff,
    }
    cells = commands.whole("--side", side, 2, 5000)
    plane_commands.draw_map(values, stiffness_ratio, mass_ratio, cells or 1000, out)


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
