"""Commands about solvers and their scenes: what is there, what keeps the contract, which traps are set."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from impact_xval.experiments.commands.options import Json, argument, number, option, path, print_json
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.compliant_baselines.inspect_mujoco import Finding, Measured
    from impact_xval.experiments.presentation.document import Block

#: Seconds that a check of a solver may take, and a scene to be loaded, measured and examined.
_TO_CHECK, _TO_INSPECT = 300.0, 120.0


def solvers(
    name: str | None = argument("[NAME]", "Check whether this one keeps the contract.", default=None),
    law: str = option("LAW", "The exact solver whose law NAME has, or 'none'.", default=""),
) -> None:
    """List the solvers, or check one.

    What each is, its version, where it comes from, and why one cannot run here. With NAME: its checks of the
    contract, for authors of adapters; exit code 3 if one fails.

    Example: impact-xval solvers mujoco
    """
    from impact_xval.compliant_baselines.registry import description_of, get_solver, law_of, origins
    from impact_xval.experiments.presentation.document import Table
    from impact_xval.experiments.presentation.terminal import at_work, make_console, show
    from impact_xval.experiments.sweep.pool import Slot
    from impact_xval.experiments.sweep.warmup import stated

    if name is not None:
        _check(name, law)
        return
    rows = []
    with contextlib.closing(Slot()) as slot:
        for each, origin in origins().items():
            with at_work(f"asking {each} what it is"):
                version, reason = stated(slot, get_solver, each)
            what = [description_of(each), "" if reason is None else f"unavailable: {reason}"]
            rows.append((each, law_of(each) or "-", version or "-", origin, "; ".join(filter(None, what))))
    header = ("solver", "law asked for", "version", "from", "description")
    caption = "Solvers that are known here; those asked for the same law are one vote on it"
    show(make_console(), [Table(header, rows, caption, text=5)])


def _check(name: str, law: str) -> None:
    """Check a solver in a process of its own."""
    from impact_xval.compliant_baselines import conformance
    from impact_xval.compliant_baselines.registry import get_solver, law_of
    from impact_xval.experiments.config.experiment import solvers_problem
    from impact_xval.experiments.presentation.terminal import at_work, make_console, print_line
    from impact_xval.experiments.sweep.pool import Slot
    from impact_xval.experiments.sweep.process import FaultError, Worker
    from impact_xval.experiments.sweep.warmup import stated

    problem = solvers_problem([name])
    if problem:
        raise UserError(f"NAME {problem}")
    law = law or law_of(name) or "none"
    if law not in conformance.LAWS:
        raise UserError(f"--law = {law!r}; legal: {', '.join(conformance.LAWS)}")
    with at_work(f"asking {name} what it is"), contextlib.closing(Slot()) as slot:
        _, reason = stated(slot, get_solver, name)
    if reason is not None:
        raise UserError(f"{name}: unavailable: {reason}")
    console, failed = make_console(), 0
    with contextlib.closing(Worker((name, law))) as worker:
        for number, check in enumerate(conformance.checks(law)):
            words = check.__name__.replace("_", " ")
            try:
                with at_work(f"checking {name}: {words}"):
                    problem = worker.call(_found, number, timeout=_TO_CHECK)
            except FaultError as fault:
                problem = fault.reason
            failed += bool(problem)
            print_line(console, f"FAILED  {words}: {problem}" if problem else f"passed  {words}")
    if failed:
        print_line(console, f"{failed} checks failed; what each demands is in docs/adding-a-solver.md")
        raise typer.Exit(3)


def _found(context: tuple[str, str], number: int) -> str:
    """Say what a check finds of a solver."""
    from impact_xval.compliant_baselines.conformance import checks, problem_of
    from impact_xval.compliant_baselines.registry import get_solver

    name, law = context
    return problem_of(checks(law)[number], get_solver(name))


def inspect(
    scene: Path = argument("SCENE.xml", "An MJCF file, or .mjb.", path),
    speed: float = option("M/S", "At which bodies are dropped.", number, 1.0),
    json: Json = False,
) -> None:
    """Measure the contacts of a MuJoCo scene, and look for traps in them.

    Each two geoms that can touch are dropped and loaded alone: restitution, stiffness, steps in a contact, and what
    to write for what was probably meant. Then contact parameters that are replaced, ignored or not what they seem.
    Exit code 3 if there are any.

    Example: impact-xval inspect robot.xml
    """
    from impact_xval.compliant_baselines import get_solver
    from impact_xval.experiments.presentation.terminal import at_work, make_console, print_line, show

    if not 0 < speed < math.inf:
        raise UserError(f"--speed = {speed!r}; legal: a finite number > 0 (m/s)")
    if not scene.is_file() or scene.suffix not in (".xml", ".mjb"):
        raise UserError(f"{scene}: no such file of MuJoCo; legal: a file that ends in .xml or .mjb")
    reason = get_solver("mujoco").unavailable()
    if reason is not None:
        raise UserError(f"{scene}: mujoco is unavailable: {reason}")
    with at_work(f"dropping the contacts of {scene}"):
        contacts, findings = _examined(scene, speed)
    if json:
        # JSON knows no infinity.
        rows = [
            row._asdict() | {"masses": [m if m < math.inf else "inf" for m in row.masses]} for row in contacts
        ]
        print_json({"contacts": rows, "traps": [finding._asdict() for finding in findings]})
    else:
        from impact_xval.compliant_baselines.inspect_mujoco import called

        console = make_console()
        show(console, _contacts_shown(contacts, speed))
        for trap, where, says in findings:
            print_line(console, f"{trap}: {called(where)}: {says}")
        print_line(console, f"{scene}: {len(findings) or 'no'} trap{'s' if len(findings) != 1 else ''} found")
    if findings:
        raise typer.Exit(3)


def _contacts_shown(contacts: list[Measured], speed: float) -> list[Block]:
    """Table of what was measured, and what to change."""
    from impact_xval.compliant_baselines.inspect_mujoco import MOST_ROWS, called
    from impact_xval.experiments.presentation.document import Table
    from impact_xval.experiments.tables.numbers import number

    header = ("contact", "masses, kg", "e", "k, N/m", "c, N s/m", "duration, s", "steps", "at rest, m")
    rows, lines = [], []
    for contact in contacts:
        where = called(contact.where)
        values = [contact.stiffness, contact.damping, contact.duration, contact.steps, contact.penetration]
        low, high = (number(e) for e in contact.restitution_range or (None, None))
        rows.append(
            (
                where,
                " ".join(f"{mass:.4g}" for mass in contact.masses),
                low if low == high else f"{low} to {high}",
                *map(number, values),
            )
        )
        lines += [f"{where}: {said}" for said in (contact.reason, contact.change) if said]
    caption = (
        f"Dropped at {speed:g} m/s, and loaded with the weight of the lighter body, each two bodies alone"
    )
    if len(rows) == MOST_ROWS:
        caption += f"; the first {MOST_ROWS} combinations of parameters and masses"
    return [Table(header, rows, caption, text=2), *lines, ""] if rows else []


def _examined(scene: Path, speed: float) -> tuple[list[Measured], list[Finding]]:
    """Examine a file in a process of its own: a few bytes can be a scene of any size, and crash its engine."""
    from impact_xval.experiments.sweep.process import FaultError, Worker

    with contextlib.closing(Worker(speed)) as worker:
        try:
            found = worker.call(_findings, scene, timeout=_TO_INSPECT)
        except FaultError as fault:
            raise UserError(f"{scene}: cannot be examined: {fault.reason}; legal: a smaller scene") from None
    if isinstance(found, str):
        raise UserError(found)
    return found


def _findings(speed: float, scene: Path) -> tuple[list[Measured], list[Finding]] | str:
    """Return what was measured and found, or why nothing could be."""
    from importlib import import_module

    from impact_xval.compliant_baselines.inspect_mujoco import inspect_model, measure_model

    mujoco: Any = import_module("mujoco")
    load = mujoco.MjModel.from_binary_path if scene.suffix == ".mjb" else mujoco.MjModel.from_xml_path
    try:
        model = load(str(scene))
        return measure_model(model, speed), inspect_model(model)
    except Exception as error:  # of an engine that met what it does not expect
        return f"{scene}: MuJoCo does not compile it: {error}"
