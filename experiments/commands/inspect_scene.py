"""Command ``impact-xval inspect``: shows the contacts of a MuJoCo scene and the traps in their parameters.

A trap is a parameter that MuJoCo replaces, ignores or reads in another way. The command can also write a scene without
traps.
"""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from impact_xval.experiments.commands.options import (
    Json,
    argument,
    flag_option,
    option,
    parse_number,
    parse_path,
    print_json,
)
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:  # these modules import MuJoCo
    from impact_xval.compliant_baselines.inspect_mujoco import Examination
    from impact_xval.compliant_baselines.inspect_mujoco.readings import Kind

#: Time limit in s to load, measure and examine a scene.
_TO_INSPECT = 180.0


def inspect_command(
    scene: Path = argument("SCENE.xml", "MJCF file (.xml) or compiled scene (.mjb) to examine.", parse_path),
    speed: float = option("M/S", "Speed at which the bodies meet.", parse_number, 1.0),
    geom: str | None = option(
        "NAME", "Examine the contacts of this geom only. #3 is geom number 3; numbers begin at 0."
    ),
    all: bool = flag_option("--all", "Show all groups and traps, and a row for every measured contact."),
    fix: Path | None = option(
        "FILE", "Write a new file with other contacts: add --keep or --newton-metre.", parse_path
    ),
    keep: bool = flag_option(
        "--keep", "With --fix: two bodies alone collide as they do now, also at a shorter step."
    ),
    newton_metre: bool = flag_option(
        "--newton-metre", "With --fix: negative numbers of solref are meant in N/m and N s/m."
    ),
    json: Json = False,
) -> None:
    """Measure the contacts of a MuJoCo scene, and look for traps in them.

    Contacts with the same parameters form a group. Two bodies of each group collide without gravity and without the
    rest of the scene. You get their restitution, stiffness, time steps per contact and depth at rest (with gravity),
    and the parameters to write for another contact. All of these hold for two bodies alone, not for a body in two
    contacts at once. Under gravity a long, soft contact has a smaller restitution than the printed one.

    A trap is a parameter that the engine replaces, ignores or reads in another way. The exit code is 3 if
    the scene has traps.

    --fix changes only contacts whose solref is negative: it writes other parameters for them. A contact whose solref is
    positive stays as it is; to change it, copy the parameters that the command prints.

    Example: impact-xval inspect robot.xml

    Or, to write a scene: impact-xval inspect robot.xml --fix fixed.xml --keep
    """
    from impact_xval.compliant_baselines import get_solver
    from impact_xval.experiments.presentation.terminal import make_console, print_blocks, report_waiting
    from impact_xval.experiments.sweep.process import FaultError, Worker

    if not 0 < speed < math.inf:
        raise UserError(f"--speed = {speed!r}; legal: a finite number > 0 (m/s)")
    if not scene.is_file() or scene.suffix not in (".xml", ".mjb"):
        what = "a folder" if scene.is_dir() else "no such file of MuJoCo"
        raise UserError(f"{scene}: {what}; legal: a file that ends in .xml or .mjb")
    _check_fix(scene, fix, keep, newton_metre, json)
    engine = get_solver("mujoco")
    reason = engine.unavailable()
    if reason is not None:
        raise UserError(f"{scene}: mujoco is unavailable: {reason}")
    from impact_xval.compliant_baselines.inspect_mujoco import Examination
    from impact_xval.compliant_baselines.inspect_mujoco.requests import InspectionRequest, answer_request

    kind: Kind = "newton-metre" if newton_metre else "keep"
    request = InspectionRequest(speed, geom, all, fix, kind)
    # A worker process loads the scene: a small file can describe a huge scene, which may crash the engine.
    with report_waiting(f"dropping the contacts of {scene}"), contextlib.closing(Worker(request)) as worker:
        try:
            answer = worker.call(answer_request, scene, timeout=_TO_INSPECT)
        except FaultError as fault:
            raise UserError(f"{scene}: cannot be examined: {fault.reason}; legal: a smaller scene") from None
    if isinstance(answer, str):
        raise UserError(answer)
    if not isinstance(answer, Examination):
        from impact_xval.experiments.presentation.contacts import fixed_scene_blocks

        print_blocks(make_console(), fixed_scene_blocks(answer, str(scene), str(fix), engine.version()))
        if not answer.is_kept:
            raise typer.Exit(3)
        return
    if json:
        print_json({"version": engine.version(), **_describe_in_json(answer)})
    else:
        from impact_xval.experiments.presentation.contacts import scene_blocks

        blocks = scene_blocks(answer, str(scene), speed, engine.version(), everything=all)
        print_blocks(make_console(), blocks)
    if answer.findings:
        raise typer.Exit(3)


def _check_fix(scene: Path, fix: Path | None, keep: bool, newton_metre: bool, json: bool) -> None:
    """Raise a UserError if the options that belong to --fix are incomplete or contradict each other."""
    if fix is None:
        if keep or newton_metre:
            raise UserError("--keep and --newton-metre: without --fix; legal: beside --fix FILE")
        return
    if keep == newton_metre:
        given = "both" if keep else "neither"
        raise UserError(f"--fix = {str(fix)!r} with {given} of --keep and --newton-metre; legal: one of them")
    if json:
        raise UserError("--json: beside --fix; legal: one of them")
    if fix.suffix != ".xml" or fix.exists() or not fix.parent.is_dir():
        raise UserError(f"--fix = {str(fix)!r}; legal: a new file that ends in .xml, in a folder that exists")
    if scene.suffix != ".xml":
        raise UserError(f"--fix: {scene} is compiled; legal: an .xml file, which MuJoCo can write again")


def _describe_in_json(examination: Examination) -> dict[str, Any]:
    """Return an examination of a scene as values for JSON, in which an infinite mass is the text "inf"."""
    rows: list[dict[str, Any]] = []
    groups: list[dict[str, Any]] = []
    for number, group in enumerate(examination.groups, 1):
        for contact in group.examined:
            row = contact.row._asdict()
            where = row.pop("names")
            masses = [mass if mass < math.inf else "inf" for mass in contact.row.masses]
            more = {
                "group": number,
                "keep": contact.keep and contact.keep._asdict(),
                "newton_metre": contact.newton_metre and contact.newton_metre._asdict(),
                "advice": contact.advice and contact.advice._asdict(),
            }
            rows.append({"where": where, **row, "masses": masses, **more})
        bodies = group.group.contacts[0].bodies
        groups.append(
            {
                "group": number,
                "where": group.group.names,
                "from": bodies.rule,
                "parameters": {name: list(value) for name, value in bodies.pair},
                "restitution_range": group.restitution_range,
            }
        )
    traps = [
        {"trap": finding.trap, "where": finding.contacts, "says": finding.message}
        for finding in examination.findings
    ]
    return {
        "contacts": rows,
        "traps": traps,
        "groups": groups,
        "geoms": examination.geoms,
        "geoms_looked_at": examination.geoms_looked_at,
        "not_in_the_drops": examination.omissions,
    }
