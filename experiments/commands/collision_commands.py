"""One collision, given on the command line: solved by every solver, or written for an engine alone."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from impact_xval.compliant_baselines import get_solver, solver_names
from impact_xval.experiments.commands import export
from impact_xval.experiments.commands.commands import compile_notice
from impact_xval.experiments.commands.options import RATIOS, one_cell
from impact_xval.experiments.config.configuration import REFERENCE, solvers_problem
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.grid import collision_of
from impact_xval.experiments.presentation.terminal import error_line, make_console
from impact_xval.experiments.presentation.views import show_outcomes
from impact_xval.experiments.sweep.solving import answer, scaled_diagnostics, settings_of
from impact_xval.experiments.tables.folders import finished
from impact_xval.model.collision import Collision, Outcome


def solve(values: dict[str, str], solvers: list[str] | None, *, as_json: bool) -> None:
    """Solve one collision by several solvers and print the outcomes.

    Parameters
    ----------
    values : dict
        As for `options.one_cell`.
    solvers : list of str, optional
        Names; by default all.
    as_json : bool
        Whether to print a JSON list.

    Raises
    ------
    UserError
        If a value is illegal, or there is no such solver.
    """
    config = one_cell(values)
    names = solvers or list(solver_names())
    problem = solvers_problem(names)
    if problem:
        raise UserError(f"--solver {problem}")
    collision = collision_of(config, config.figure_cell)
    settings = settings_of(config)
    notice = compile_notice()
    if notice:
        error_line(notice)
    outcomes = [answer(get_solver(name), [collision], settings)[0] for name in names]
    if as_json:
        objects = [outcome_object(n, collision, outcome) for n, outcome in zip(names, outcomes, strict=True)]
        print(json.dumps(objects, indent=2, allow_nan=False))
        return
    reference = next((o for n, o in zip(names, outcomes, strict=True) if n == REFERENCE), None)
    show_outcomes(make_console(), names, collision, outcomes, reference)


def export_scene(
    root: Path | None,
    cell: str | None,
    values: dict[str, str | None],
    solvers: list[str] | None,
    out: Path | None,
) -> None:
    """Write one cell, of a run or by its ratios, as files that an engine runs alone.

    Parameters
    ----------
    root : Path, optional
        Folder of a finished run, with `cell`; without it the cell is that of `values`.
    cell : str, optional
        Number of a cell of that run.
    values : dict
        As for `options.one_cell`; None where nothing was typed.
    solvers : list of str, optional
        Names of engines; by default all that can be exported.
    out : Path, optional
        Folder to write; by default in ``scenes``.

    Raises
    ------
    UserError
        If a value is illegal, the run is not finished or has no such cell, or an engine gives no result.
    """
    given = {key: value for key, value in values.items() if value is not None}
    if root is not None:
        if cell is None or given:
            raise UserError(f"{root}: a cell of a run is named by --cell N, and by nothing else")
        export.export_cell(finished(root), cell, solvers, out)
        return
    missing = [f"--{key.replace('_', '-')}" for key in RATIOS if key not in given]
    if cell is not None or missing:
        wanted = ", ".join(missing) or "the folder of a run"
        raise UserError(f"{wanted} missing; legal: DIR --cell N, or the ratios of a collision")
    names = export.names_of(solvers)
    config = one_cell(given)
    collision = collision_of(config, config.figure_cell)
    export.export(collision, settings_of(config), names, out or Path("scenes") / "collision")


def outcome_object(name: str, collision: Collision, outcome: Outcome) -> dict[str, Any]:
    """Return the JSON object of an outcome: velocities per abs(v0), impulses per m1 abs(v0), times in s.

    So are the diagnostics that `scaled_diagnostics` knows; others are as the solver states them.
    """
    speed = abs(collision.v0)
    impulse = collision.m1 * speed
    margin = outcome.grazing_margin
    diagnostics = scaled_diagnostics(collision, outcome)
    return {
        "solver": name,
        "v1": _finite(outcome.v1 / speed),
        "v2": _finite(outcome.v2 / speed),
        "impulse1": _finite(outcome.impulse1 / impulse),
        "impulse2": _finite(outcome.impulse2 / impulse),
        "states": list(outcome.states),
        "status": outcome.status,
        "reason": outcome.reason,
        "grazing_margin": None if margin is None else _finite(margin),
        "marked": outcome.marked,
        "diagnostics": {key: _finite(value) for key, value in diagnostics.items()},
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
