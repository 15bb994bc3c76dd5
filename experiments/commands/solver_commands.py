"""What ``impact-xval solvers`` and ``impact-xval conform`` do."""

from __future__ import annotations

from typing import Any

import typer

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract import conformance
from impact_xval.compliant_baselines.contract.plugins import ThirdPartySolver
from impact_xval.compliant_baselines.contract.registry import law_of, origins
from impact_xval.experiments.config.configuration import solvers_problem
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.presentation.terminal import make_console, print_line, print_table
from impact_xval.experiments.tables.document import Table


def show_solvers() -> None:
    """Print a line for every solver that is known."""
    rows = []
    for name, origin in origins().items():
        solver = get_solver(name)
        reason = solver.unavailable()
        said = "" if reason is None else f"unavailable: {reason}"
        rows.append((name, law_of(name), solver.version() or "-", origin, said))
    header = ("solver", "law asked for", "version", "from", "")
    caption = "Solvers that are known here; those that are asked for the same law are one vote on it"
    print_table(make_console(), Table(caption, header, rows, text_columns=5))


def conform(name: str, law: Any) -> None:
    """Run the conformance checks on a solver and print what each found.

    Raises
    ------
    UserError
        If there is no such solver or law, or it cannot run here.
    typer.Exit
        With code 1, if a check failed.
    """
    problem = solvers_problem([name])
    if problem:
        raise UserError(f"SOLVER {problem}")
    if law not in conformance.LAWS:
        raise UserError(f"--law = {law!r}; legal: {', '.join(conformance.LAWS)}")
    solver = get_solver(name)
    reason = solver.unavailable()
    if reason is not None:
        raise UserError(f"{name}: unavailable: {reason}")
    if isinstance(solver, ThirdPartySolver) and solver.solver is not None:
        solver = solver.solver  # the checks are of the solver itself, not of what keeps it from doing harm
    console, failed = make_console(), 0
    for check, problem in conformance.conform(solver, law):
        failed += bool(problem)
        words = check.__name__.replace("_", " ")
        print_line(console, f"FAILED  {words}: {problem}" if problem else f"passed  {words}")
    if failed:
        print_line(
            console,
            f"{failed} of the checks failed; the contract is in compliant_baselines/contract/solver.py",
        )
        raise typer.Exit(1)
