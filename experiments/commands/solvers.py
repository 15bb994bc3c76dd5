"""Commands about solvers: which there are, and whether one keeps the contract."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.compliant_baselines.conformance import Check

#: Seconds that a check of a solver may take.
_LONGEST = 300.0


def solvers() -> None:
    """List the solvers: what each is, its version, where it comes from, and why one cannot run here."""
    from impact_xval.compliant_baselines.registry import description_of, get_solver, law_of, origins
    from impact_xval.experiments.presentation.pages import render
    from impact_xval.experiments.presentation.terminal import at_work, make_console, show
    from impact_xval.experiments.sweep.pool import Slot
    from impact_xval.experiments.sweep.warmup import stated

    rows = []
    with contextlib.closing(Slot()) as slot:
        for name, origin in origins().items():
            with at_work(f"asking {name} what it is"):
                version, reason = stated(slot, get_solver, name)
            what = [description_of(name), "" if reason is None else f"unavailable: {reason}"]
            rows.append((name, law_of(name) or "-", version or "-", origin, "; ".join(filter(None, what))))
    show(make_console(), render("solvers.md.j2", rows=rows))


def conform(
    name: Annotated[str, typer.Argument(metavar="SOLVER", help="Name of a solver.")],
    law: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="The exact solver whose law it has, or 'none'; by default what it states itself.",
        ),
    ] = "",
) -> None:
    """Check whether a solver keeps the contract; for authors of adapters. Exit code 1 if it does not."""
    from impact_xval.compliant_baselines import conformance
    from impact_xval.compliant_baselines.registry import get_solver, law_of
    from impact_xval.experiments.config.experiment import solvers_problem
    from impact_xval.experiments.presentation.terminal import at_work, make_console, print_line
    from impact_xval.experiments.sweep.pool import Slot
    from impact_xval.experiments.sweep.warmup import stated

    problem = solvers_problem([name])
    if problem:
        raise UserError(f"SOLVER {problem}")
    law = law or law_of(name) or "none"
    if law not in conformance.LAWS:
        raise UserError(f"--law = {law!r}; legal: {', '.join(conformance.LAWS)}")
    with at_work(f"asking {name} what it is"), contextlib.closing(Slot()) as slot:
        _, reason = stated(slot, get_solver, name)
    if reason is not None:
        raise UserError(f"{name}: unavailable: {reason}")
    console, failed = make_console(), 0
    for check, problem in _checked(name, law):
        failed += bool(problem)
        words = check.__name__.replace("_", " ")
        print_line(console, f"FAILED  {words}: {problem}" if problem else f"passed  {words}")
    if failed:
        contract = "compliant_baselines/solver.py"
        print_line(console, f"{failed} of the checks failed; the contract is in {contract}")
        raise typer.Exit(1)


def _checked(name: str, law: str) -> Iterator[tuple[Check, str]]:
    """Check a solver in a process of its own; each check, and what it found."""
    from impact_xval.compliant_baselines.conformance import checks
    from impact_xval.experiments.presentation.terminal import at_work
    from impact_xval.experiments.sweep.process import FaultError, Worker

    with contextlib.closing(Worker((name, law))) as worker:
        for number, check in enumerate(checks(law)):
            try:
                with at_work(f"checking {name}"):
                    found = worker.call(_found, number, timeout=_LONGEST)
            except FaultError as fault:
                found = fault.reason
            yield check, found


def _found(context: tuple[str, str], number: int) -> str:
    """Say what a check finds of a solver."""
    from impact_xval.compliant_baselines.conformance import checks, problem_of
    from impact_xval.compliant_baselines.registry import get_solver

    name, law = context
    return problem_of(checks(law)[number], get_solver(name))
