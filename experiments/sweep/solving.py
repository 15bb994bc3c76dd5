"""A batch of cells by every solver, as rows; what a worker process does."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import pyarrow as pa

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contact.column import shorter_period
from impact_xval.compliant_baselines.contract.solver import Convergence, Settings, Solver
from impact_xval.compliant_baselines.contract.state_runs import compared_states
from impact_xval.experiments.config.configuration import REFERENCE, Config
from impact_xval.experiments.config.grid import GridCell, collision_of
from impact_xval.experiments.measures.divergence import COMPARABLE, divergence
from impact_xval.experiments.sweep.sandbox import Beat
from impact_xval.experiments.tables.schema import (
    CERTIFICATE,
    COLUMNS,
    MEASURES,
    ROW_SCHEMA,
)
from impact_xval.model.collision import Collision, Outcome, Status

#: Finds a solver by its name; a function at the top level of a module, so that worker processes can find it.
Resolve = Callable[[str], Solver]


#: What is known of the solvers that cannot answer these cells: status and reason by name.
Failures = dict[str, tuple[Status, str]]
Seconds = dict[str, float]
Versions = dict[str, str]

#: Diagnostics in m/s; tables and JSON state them per abs(v0).
VELOCITIES = frozenset({"v1_limit", "v2_limit", "limit_error", "regularisation", "rest_speed"})


@dataclass(frozen=True, slots=True)
class Job:
    """What every process of a run is told once.

    Attributes
    ----------
    config : Config
        The experiment.
    resolve : callable
        Finds a solver by its name.
    """

    config: Config
    resolve: Resolve


def prepare(job: Job, *, beat: Beat) -> Versions:
    """Make a process ready: solve a cell by every solver, so that all is imported and compiled."""
    versions = solver_versions(job.config, job.resolve)
    cell = GridCell(0, 1.0, 1.0, collision_of(job.config, job.config.figure_cell))
    solve_cells(job.config, [cell], job.resolve, beat=beat)
    return versions


def compute(
    job: Job, cells: Sequence[GridCell], failures: Failures, *, beat: Beat
) -> tuple[pa.Table, Seconds]:
    """Solve cells as `solve_cells` does; the rows as a table."""
    rows, seconds = solve_cells(job.config, cells, job.resolve, failures, beat)
    return pa.Table.from_pylist(rows, schema=ROW_SCHEMA), seconds


def solver_versions(config: Config, resolve: Resolve = get_solver) -> Versions:
    """Versions of the project and of every solver; why not, for one that is unavailable."""
    versions = {"impact-xval": version("impact-xval")}
    for name in config.solvers:
        solver = resolve(name)
        reason = solver.unavailable()
        versions[name] = solver.version() if reason is None else f"unavailable: {reason}"
    return versions


def settings_of(config: Config) -> Settings:
    """Return the settings of every solver of an experiment; outcomes carry their paths."""
    return Settings(
        scenario=config.scenario,
        gravity=config.gravity,
        step_fraction=config.step_fraction,
        max_steps=config.max_steps,
        mapping=config.mapping,
        shortest_state=config.shortest_state,
        record_path=True,
        stiffness_ratio_cutoff=config.stiffness_ratio_cutoff,
        grazing_threshold=config.grazing_threshold,
        convergence=Convergence(config.convergence.tolerance, config.convergence.halvings)
        if config.convergence.enabled
        else None,
    )


def solve_cells(
    config: Config,
    cells: Sequence[GridCell],
    resolve: Resolve,
    failures: Failures | None = None,
    beat: Beat = lambda word: None,
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
    failures : dict, optional
        Solvers that are not to be asked, and the status and reason of their rows.
    beat : callable
        Told the name of each solver before it is asked.

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
        beat(name)
        if failures and name in failures:
            outcomes = [Outcome.failure(name, *failures[name])] * len(cells)
        else:
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


def scaled_diagnostics(collision: Collision, outcome: Outcome) -> dict[str, float]:
    """Return the diagnostics of an outcome with `VELOCITIES` per abs(v0); the others as they are, times in s."""
    speed = abs(collision.v0)
    return {
        name: value / speed if name in VELOCITIES and value is not None else value
        for name, value in outcome.diagnostics.items()
    }


def _marked(model: Outcome, outcome: Outcome) -> str:
    """Say what a comparison of an outcome with the model's lies beside: a jump of either, or a cut-off."""
    both = (model, outcome) if outcome is not model else (model,)
    return "; ".join(f"{each.solver}: {each.marked}" for each in both if each.marked)


def _row(config: Config, name: str, cell: GridCell, model: Outcome, outcome: Outcome) -> dict[str, Any]:
    c = cell.collision
    diagnostics = scaled_diagnostics(c, outcome)
    shortest = config.shortest_state * shorter_period(c)
    paths = compared_states(model, shortest), compared_states(outcome, shortest)
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
        "marked": _marked(model, outcome) or None,
        "gravity_number": config.gravity_number(c.m2),
        "step": diagnostics.get("step"),
        "n_steps": _whole(diagnostics.get("n_steps")),
        "duration": diagnostics.get("duration"),
        **{column: diagnostics.get(column) for column in CERTIFICATE},
        "model_states": " ".join(model.states) or None,
        "model_states_compared": " ".join(paths[0]) or None,
        "model_status": model.status,
        "model_grazing_margin": model.grazing_margin,
        # The model's divergence from itself is in no table.
        **(divergence(c, model, outcome, paths) if name != REFERENCE else dict.fromkeys(MEASURES)),
    }
    if done:
        row |= {
            "v1": outcome.v1,
            "v2": outcome.v2,
            "impulse1": outcome.impulse1,
            "impulse2": outcome.impulse2,
            "states": " ".join(outcome.states),
            "states_compared": " ".join(paths[1]),
            "n_states": len(outcome.states),
            "n_events": outcome.n_events,
            "retained_energy": outcome.retained_energy(c),
        }
    return {column: row.get(column) for column in COLUMNS}


def _whole(value: float | None) -> int | None:
    return None if value is None else int(value)
