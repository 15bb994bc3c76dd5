"""A chunk of cells by every solver, as rows; what a worker process does."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compliant_baselines.contract import Settings, Solver
from compliant_baselines.convergence import Convergence
from experiments.config import Config
from experiments.divergence import COMPARABLE, divergence
from experiments.grid import CellGrid, GridCell
from experiments.schema import CERTIFICATE, COLUMNS
from experiments.store import RunFolder
from model.collision import Collision, Outcome

#: Finds a solver by its name; a function at the top level of a module, so that worker processes can find it.
Resolve = Callable[[str], Solver]


@dataclass(frozen=True, slots=True)
class Task:
    """One chunk to be computed and written as a part."""

    number: int
    identity: str
    config: Config
    root: Path
    resolve: Resolve


@dataclass(frozen=True, slots=True)
class Report:
    """What came of a task.

    Attributes
    ----------
    number : int
        Number of the chunk.
    part : Path
        Where its rows are.
    seconds : dict
        Time spent by solver.
    statuses : dict
        Count by (solver, status).
    """

    number: int
    part: Path
    seconds: dict[str, float]
    statuses: dict[tuple[str, str], int]


def run_task(task: Task) -> Report:
    """Compute a chunk and write it as a part."""
    grid = CellGrid(task.config)
    cells = [grid[index] for index in grid.chunk(task.number)]
    rows, seconds = solve_cells(task.config, cells, task.resolve)
    part = RunFolder(task.root).write_part(task.number, task.identity, rows)
    return Report(task.number, part, seconds, dict(Counter((row["solver"], row["status"]) for row in rows)))


def settings_of(config: Config) -> Settings:
    """Return the settings of every solver of an experiment; outcomes carry their paths."""
    return Settings(
        scenario=config.scenario,
        gravity=config.gravity,
        step_fraction=config.step_fraction,
        max_steps=config.max_steps,
        mapping=config.mapping,
        min_run=config.min_run,
        record_path=True,
        stiffness_ratio_cutoff=config.stiffness_ratio_cutoff,
        convergence=Convergence(config.convergence.tolerance, config.convergence.halvings)
        if config.convergence.enabled
        else None,
    )


def solve_cells(
    config: Config, cells: Sequence[GridCell], resolve: Resolve
) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """Solve cells by every solver of an experiment.

    Parameters
    ----------
    config : Config
        The experiment; its first solver is the reference.
    cells : sequence of GridCell
        The cells.
    resolve : callable
        Finds a solver by its name.

    Returns
    -------
    rows : list of dict
        A value for every column of `schema.ROW_SCHEMA`, by cell, then by solver in the order of the
        configuration.
    seconds : dict
        Wall time by solver.
    """
    settings = settings_of(config)
    collisions = [cell.collision for cell in cells]
    references: list[Outcome] = []
    by_solver: list[list[dict[str, Any]]] = []
    seconds: dict[str, float] = {}
    for name in config.solvers:
        start = time.perf_counter()
        outcomes = answer(resolve(name), collisions, settings)
        references = references or outcomes
        # Paths are needed for the measures only; of all solvers but the reference they are dropped here.
        by_solver.append(
            [_row(config, name, *each) for each in zip(cells, references, outcomes, strict=True)]
        )
        seconds[name] = time.perf_counter() - start
    return [row for rows in zip(*by_solver, strict=True) for row in rows], seconds


def answer(solver: Solver, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
    """Ask a solver, and turn whatever goes wrong into outcomes with a status and a reason."""
    unavailable = solver.unavailable()
    if unavailable is not None:
        return [Outcome.failure(solver.name, "unavailable", unavailable)] * len(collisions)
    try:
        outcomes = solver.solve_many(collisions, settings)
        if len(outcomes) != len(collisions):
            raise RuntimeError(f"{len(outcomes)} outcomes for {len(collisions)} collisions")
    except Exception as error:  # a solver's bug must not end the sweep
        if len(collisions) == 1:
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            return [Outcome.failure(solver.name, "crashed", reason)]
        return [outcome for one in collisions for outcome in answer(solver, [one], settings)]
    return [_honest(outcome) for outcome in outcomes]


def _honest(outcome: Outcome) -> Outcome:
    """Give a result that is not a number a status that says so."""
    numbers = (outcome.v1, outcome.v2, outcome.impulse1, outcome.impulse2)
    if outcome.status in COMPARABLE and not all(map(math.isfinite, numbers)):
        return Outcome.failure(
            outcome.solver, "crashed", f"status {outcome.status}, but v1, v2, impulse1, impulse2 = {numbers}"
        )
    return outcome


def gravity_number(config: Config, collision: Collision) -> float:
    """Return g/(abs(v0) omega1), omega1 = sqrt(k1 (1/m1 + 1/m2)); 0 without gravity."""
    if config.scenario == "impact":
        return 0.0
    return config.gravity / (abs(collision.v0) * math.sqrt(collision.k1 / collision.reduced_mass))


def _row(config: Config, name: str, cell: GridCell, model: Outcome, outcome: Outcome) -> dict[str, Any]:
    c = cell.collision
    # A result that is not converged keeps the numbers it came to, but is no measure of anything.
    done = outcome.status in (*COMPARABLE, "unconverged") and math.isfinite(outcome.v1)
    row: dict[str, Any] = {
        "cell": cell.index,
        "stiffness_ratio": cell.stiffness_ratio,
        "mass_ratio": cell.mass_ratio,
        **{name: getattr(c, name) for name in ("e1", "e2", "m1", "m2", "k1", "k2", "v0")},
        "solver": name,
        "status": outcome.status,
        "reason": outcome.reason or None,
        "grazing_margin": outcome.grazing_margin,
        "gravity_number": gravity_number(config, c),
        "step": outcome.diagnostics.get("step"),
        "n_steps": _whole(outcome.diagnostics.get("n_steps")),
        "duration": outcome.diagnostics.get("duration"),
        **_certificate(c, outcome),
        "model_states": " ".join(model.states) or None,
        "model_status": model.status,
        "model_grazing_margin": model.grazing_margin,
        **divergence(c, model, outcome),
    }
    if done:
        row |= {
            "v1": outcome.v1,
            "v2": outcome.v2,
            "impulse1": outcome.impulse1,
            "impulse2": outcome.impulse2,
            "states": " ".join(outcome.states),
            "n_states": len(outcome.states),
            "n_events": outcome.n_events,
            "retained_energy": outcome.retained_energy(c),
        }
    return {column: row.get(column) for column in COLUMNS}


def _certificate(collision: Collision, outcome: Outcome) -> dict[str, float | None]:
    """Columns of the convergence certificate; the outcome states them in SI units among its diagnostics."""
    speed = abs(collision.v0)
    scale = {"order": 1.0, "finest_step": 1.0}
    return {
        name: None if (value := outcome.diagnostics.get(name)) is None else value / scale.get(name, speed)
        for name in CERTIFICATE
    }


def _whole(value: float | None) -> int | None:
    return None if value is None else int(value)
