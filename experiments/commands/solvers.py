"""Commands about solvers: which there are, and whether one keeps the contract."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from impact_xval.experiments.config.errors import UserError


def solvers() -> None:
    """List the solvers: their versions, where they come from, and why one cannot run here."""
    from impact_xval.compliant_baselines.contract.registry import get_solver, law_of, origins
    from impact_xval.experiments.presentation.pages import render
    from impact_xval.experiments.presentation.terminal import make_console, show

    rows = []
    for name, origin in origins().items():
        solver = get_solver(name)
        reason = solver.unavailable()
        why = "" if reason is None else f"unavailable: {reason}"
        rows.append((name, law_of(name), solver.version() or "-", origin, why))
    show(make_console(), render("solvers.md.j2", rows=rows))


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
    from impact_xval.compliant_baselines.contract import conformance
    from impact_xval.compliant_baselines.contract.plugins import ThirdPartySolver
    from impact_xval.compliant_baselines.contract.registry import get_solver
    from impact_xval.experiments.config.configuration import solvers_problem
    from impact_xval.experiments.presentation.terminal import make_console, print_line

    problem = solvers_problem([name])
    if problem:
        raise UserError(f"SOLVER {problem}")
    if law not in conformance.LAWS:
        raise UserError(f"--law = {law!r}; legal: {', '.join(conformance.LAWS)}")
    solver: Any = get_solver(name)
    reason = solver.unavailable()
    if reason is not None:
        raise UserError(f"{name}: unavailable: {reason}")
    if isinstance(solver, ThirdPartySolver) and solver.solver is not None:
        solver = solver.solver  # the checks are of the solver itself, not of what keeps it from doing harm
    console, failed = make_console(), 0
    checked: Any = law
    for check, problem in conformance.conform(solver, checked):
        failed += bool(problem)
        words = check.__name__.replace("_", " ")
        print_line(console, f"FAILED  {words}: {problem}" if problem else f"passed  {words}")
    if failed:
        contract = "compliant_baselines/contract/solver.py"
        print_line(console, f"{failed} of the checks failed; the contract is in {contract}")
        raise typer.Exit(1)
