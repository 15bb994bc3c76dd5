"""Commands that take a collision, a contact or a plane of collisions from their options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from impact_xval.experiments.commands.options import (
    CUTOFF,
    E1,
    E2,
    GRAVITY,
    K1,
    M1,
    MAPPING,
    MASS_RATIO,
    SCENARIO,
    STEP_FRACTION,
    STIFFNESS_RATIO,
    V0,
    JsonObject,
    folder_to_write,
    path,
    whole,
)


def solve(
    stiffness_ratio: Annotated[str, STIFFNESS_RATIO],
    mass_ratio: Annotated[str, MASS_RATIO],
    e1: Annotated[str, E1],
    e2: Annotated[str, E2],
    solver: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A solver; may be repeated. By default all.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print a JSON list, an object a solver.")] = False,
    scenario: Annotated[str, SCENARIO] = "impact",
    gravity: Annotated[str, GRAVITY] = "9.81",
    m1: Annotated[str, M1] = "1",
    k1: Annotated[str, K1] = "1e8",
    v0: Annotated[str, V0] = "-1",
    step_fraction: Annotated[str, STEP_FRACTION] = "1e-3",
    mapping: Annotated[str, MAPPING] = "calibrated",
    cutoff: Annotated[str, CUTOFF] = "exact",
) -> None:
    """Solve one collision by every solver and show the results side by side.

    Velocities are per |v0|, those of the diagnostics too, impulses per m1 |v0|, times in s. Without gravity
    velocities and impulses depend on the four ratios only; mass, stiffness and velocity matter to a drop.
    """
    from impact_xval.experiments.commands import collision_commands

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


def export_scene(
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="[DIR]", parser=path("DIR"), help="Folder of a finished run, with --cell."),
    ] = None,
    cell: Annotated[str | None, typer.Option(metavar="N", help="Number of a cell of that run.")] = None,
    stiffness_ratio: Annotated[str | None, STIFFNESS_RATIO] = None,
    mass_ratio: Annotated[str | None, MASS_RATIO] = None,
    e1: Annotated[str | None, E1] = None,
    e2: Annotated[str | None, E2] = None,
    solver: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="'mujoco' or 'pybullet'; may be repeated. By default both."),
    ] = None,
    out: Annotated[Path | None, folder_to_write("by default in scenes/")] = None,
    scenario: Annotated[str | None, SCENARIO] = None,
    gravity: Annotated[str | None, GRAVITY] = None,
    m1: Annotated[str | None, M1] = None,
    k1: Annotated[str | None, K1] = None,
    v0: Annotated[str | None, V0] = None,
    step_fraction: Annotated[str | None, STEP_FRACTION] = None,
    mapping: Annotated[str | None, MAPPING] = None,
) -> None:
    """Write one cell as an MJCF file and as a PyBullet script that run in the engine alone.

    The cell is one of a finished run (DIR --cell N), or given by its ratios and, where they differ from what solve
    has by default, by the other options. The scripts print their velocities beside the tabulated ones and fail where
    they differ by more than 1e-12 of the speed.
    """
    from impact_xval.experiments.commands import collision_commands

    values = {
        "stiffness_ratio": stiffness_ratio,
        "mass_ratio": mass_ratio,
        "e1": e1,
        "e2": e2,
        "scenario": "impact" if scenario is None and folder is None else scenario,
        "gravity": gravity,
        "m1": m1,
        "k1": k1,
        "v0": v0,
        "step_fraction": step_fraction,
        "mapping": mapping,
    }
    collision_commands.export_scene(folder, cell, values, solver, out)


def contact(
    engine: Annotated[str, typer.Option(metavar="NAME", help="'mujoco', 'pybullet' or 'drake'.")],
    masses: Annotated[
        tuple[str, str],
        typer.Option(metavar="KG KG", help="Of the two bodies, 1e-15 to 1e15; inf for a fixed one."),
    ],
    restitution: Annotated[str, typer.Option(metavar="E", help="From 1e-4 to 1.")],
    stiffness: Annotated[str | None, typer.Option(metavar="N/M", help="Of the contact.")] = None,
    duration: Annotated[
        str | None, typer.Option(metavar="S", help="Of the contact; instead of a stiffness.")
    ] = None,
    speed: Annotated[str, typer.Option(metavar="M/S", help="Speed of approach, 1e-9 to 1e9.")] = "1",
    gravity: Annotated[
        str, typer.Option(metavar="G", help="In m/s^2: also show a drop onto the fixed body under it.")
    ] = "0",
    tolerance: Annotated[
        str, typer.Option(metavar="X", help="Allowed relative error of restitution and duration.")
    ] = "0.01",
    json: JsonObject = False,
) -> None:
    """Print what to paste into a scene for one contact, and the largest step at which it means what it says.

    Give the two masses, the restitution, and the stiffness or the duration. Beside what was asked stands what
    verifying drops in the engine gave.
    """
    from impact_xval.experiments.commands import contact as command

    values = {
        "masses": masses,
        "restitution": restitution,
        "stiffness": stiffness,
        "duration": duration,
        "speed": speed,
    }
    command.contact(engine, values, tolerance=tolerance, gravity=gravity, as_json=json)


def _side(text: str) -> int:
    return whole("--side", text, 2, 5000)


def draw_map(
    e1: Annotated[str, typer.Option(metavar="E", help="Restitution of ball on ball, above 0, at most 1.")],
    e2: Annotated[str, typer.Option(metavar="E", help="Restitution of ball on table, above 0, at most 1.")],
    stiffness_ratio: Annotated[
        tuple[str, str], typer.Option(metavar="LO HI", help="Least and largest k2/k1; logarithmic.")
    ] = ("1e-3", "1e3"),
    mass_ratio: Annotated[
        tuple[str, str], typer.Option(metavar="LO HI", help="Least and largest m2/m1; logarithmic.")
    ] = ("0.1", "10"),
    side: Annotated[
        int, typer.Option(metavar="N", parser=_side, help="Cells along each side, 2 to 5000.")
    ] = 1000,
    out: Annotated[Path | None, folder_to_write("by default maps/SCENARIO-e1-E-e2-E")] = None,
    scenario: Annotated[str, SCENARIO] = "drop",
    gravity: Annotated[str, GRAVITY] = "9.81",
    m1: Annotated[str, M1] = "1",
    k1: Annotated[str, K1] = "1e8",
    v0: Annotated[str, V0] = "-1",
    cutoff: Annotated[str, CUTOFF] = "exact",
) -> None:
    """Map where each cause of divergence matters that needs no engine, over k2/k1 and m2/m1.

    A million collisions by the model, by its law in real time and by spring and dashpot, all exact, in less than a
    minute: figures, and map.parquet with one row a cell. Mass, stiffness and velocity matter to a drop.
    """
    from impact_xval.experiments.commands import plane_commands

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
    plane_commands.draw_map(values, stiffness_ratio, mass_ratio, side, out)
