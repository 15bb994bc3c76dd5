"""Command ``impact-xval solvers``: lists the solvers, or checks whether a solver fulfils the contract of solvers.

The contract is the set of conditions that every solver has to fulfil (docs/adding-a-solver.md).
"""

from __future__ import annotations

import contextlib

import typer

from impact_xval.experiments.commands.options import argument, option
from impact_xval.experiments.config.errors import UserError

#: Time limit in s of one check of a solver.
_TO_CHECK = 300.0


def solvers_command(
    name: str | None = argument(
        "[NAME]", "Check whether this solver does what every solver has to do.", default=None
    ),
    law: str = option("LAW", "With NAME: the exact solver of the law that NAME has, or 'none'.", default=""),
) -> None:
    """List the solvers, or check one solver.

    For each solver the list has the law, the version, the package that it comes from and, if the solver cannot run
    here, the reason.

    With NAME, the command checks that solver (for authors of solvers, see docs/adding-a-solver.md). The exit code is 3
    if a check fails. The command also prints how the engine combines the restitutions of two bodies.

    Example: impact-xval solvers mujoco
    """
    from impact_xval.compliant_baselines.registry import description_of, get_solver, origins, stated_law
    from impact_xval.experiments.presentation.document import Table
    from impact_xval.experiments.presentation.terminal import make_console, print_blocks, report_waiting
    from impact_xval.experiments.sweep.chunk import ask_version
    from impact_xval.experiments.sweep.pool import Slot

    if law and name is None:
        raise UserError(f"--law = {law!r} without NAME; legal: beside the solver that has this law")
    if name is not None:
        _check_solver(name, law)
        return
    rows: list[tuple[str, ...]] = []
    with contextlib.closing(Slot(None)) as slot:
        for solver, origin in origins().items():
            with report_waiting(f"asking {solver} for its version"):
                version, reason = ask_version(slot, get_solver, solver)
            remarks = [description_of(solver), "" if reason is None else f"unavailable: {reason}"]
            rows.append(
                (solver, stated_law(solver) or "-", version or "-", origin, "; ".join(filter(None, remarks)))
            )
    header = ("solver", "law asked for", "version", "from", "description")
    caption = "Known solvers. Solvers that are asked for the same law count as one vote on an outcome"
    print_blocks(make_console(), [Table(header, rows, caption, text=5)])


def _check_solver(name: str, law: str) -> None:
    """Run all checks of the contract on a solver in a worker process, and print their results.

    The command ends with exit code 3 if a check fails.
    """
    from impact_xval.compliant_baselines import conformance
    from impact_xval.compliant_baselines.registry import get_solver, law_name_of
    from impact_xval.experiments.config.experiment import solvers_problem
    from impact_xval.experiments.presentation.terminal import make_console, print_line, report_waiting
    from impact_xval.experiments.presentation.words import describe_restitution_product
    from impact_xval.experiments.sweep.chunk import ask_version
    from impact_xval.experiments.sweep.pool import Slot
    from impact_xval.experiments.sweep.process import FaultError, Worker

    problem = solvers_problem([name])
    if problem:
        raise UserError(f"NAME {problem}")
    law = law or law_name_of(name) or "none"
    if law not in conformance.LAWS:
        raise UserError(f"--law = {law!r}; legal: {', '.join(conformance.LAWS)}")
    with report_waiting(f"asking {name} for its version"), contextlib.closing(Slot(None)) as slot:
        _, reason = ask_version(slot, get_solver, name)
    if reason is not None:
        raise UserError(f"{name}: unavailable: {reason}")
    console, failed = make_console(), 0
    with contextlib.closing(Worker((name, law))) as worker:
        for number, check in enumerate(conformance.checks(law)):
            words = check.__name__.replace("_", " ")
            try:
                with report_waiting(f"checking {name}: {words}"):
                    problem = worker.call(_run_check, number, timeout=_TO_CHECK)
            except FaultError as fault:
                problem = fault.reason
            failed += bool(problem)
            print_line(console, f"FAILED  {words}: {problem}" if problem else f"passed  {words}")
    if product := describe_restitution_product([name]):
        print_line(console, product)
    if failed:
        print_line(console, f"{failed} checks failed; docs/adding-a-solver.md explains each check")
        raise typer.Exit(3)


def _run_check(context: tuple[str, str], number: int) -> str:
    """Run one check on a solver, and return a description of the problem; return an empty text if there is none.

    The worker process calls this function. `context` holds the name of the solver and the name of its law. `number` is
    the number of the check.
    """
    from impact_xval.compliant_baselines.conformance import checks, problem_of
    from impact_xval.compliant_baselines.registry import get_solver

    name, law = context
    return problem_of(checks(law)[number], get_solver(name))
