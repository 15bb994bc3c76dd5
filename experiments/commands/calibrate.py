"""``impact-xval calibrate``: whether an engine, contact by contact, reproduces the contact requested."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from impact_xval.experiments.commands.options import folder_to_write
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.compliant_baselines.engines.engine import EngineSolver

#: Contacts that are tried together.
_BATCH = 64


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
    from impact_xval.experiments.commands import calibration
    from impact_xval.experiments.commands.runs import compile_notice
    from impact_xval.experiments.presentation.pages import render
    from impact_xval.experiments.presentation.terminal import make_console, print_line, show, show_progress
    from impact_xval.experiments.sweep.sandbox import Sandbox
    from impact_xval.experiments.tables.folders import new_folder

    start = time.perf_counter()
    engines = _engines(engine)
    new_folder(out)
    console = make_console()
    requests = calibration.requests()
    rows: list[dict[str, Any]] = []
    with show_progress(console, "contacts") as progress:
        progress(0, 0, compile_notice())
        for solver in engines:
            sandbox = Sandbox(solver.name, calibration.prepare)
            try:
                for first in range(0, len(requests), _BATCH):
                    rows += calibration.rows_of(solver, sandbox, requests[first : first + _BATCH])
                    progress(len(rows), len(requests) * len(engines), "")
            finally:
                sandbox.close()
    found = calibration.Calibration.of(rows, engines)
    calibration.write(found, out)
    print_line(console, "")
    show(console, render("calibration_summary.md.j2", **found.summary()))
    print_line(console, f"{time.perf_counter() - start:.0f} s; everything is in {out}")


def _engines(names: list[str] | None) -> list[EngineSolver]:
    """Find engines by their names, each of which must be there; for none all, one of which must be."""
    from impact_xval.compliant_baselines import get_solver
    from impact_xval.compliant_baselines.contract.answers import why_unavailable
    from impact_xval.compliant_baselines.contract.registry import engine_names
    from impact_xval.compliant_baselines.engines.engine import EngineSolver

    known = engine_names(on_request=True)
    for name in names or ():
        if name not in known:
            raise UserError(f"--engine = {name!r}; legal: {', '.join(known)}")
        if list(names or ()).count(name) > 1:
            raise UserError(f"--engine {name!r} is given more than once; legal: each engine once")
    solvers = [get_solver(name) for name in names or known]
    reasons = [
        f"{solver.name}: unavailable: {reason}" for solver in solvers if (reason := why_unavailable(solver))
    ]
    if reasons and (names or len(reasons) == len(solvers)):
        raise UserError(f"--engine {reasons[0]}; legal: an engine that is installed (impact-xval solvers)")
    return [solver for solver in solvers if isinstance(solver, EngineSolver)]
