"""Collisions of two balls on a table, as the rows of a part."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from impact_xval.compliant_baselines.answers import answer
from impact_xval.compliant_baselines.engines.scene import periods
from impact_xval.compliant_baselines.solver import Solver
from impact_xval.compliant_baselines.states import compared_states
from impact_xval.experiments.config.cells import GridCell, collision_of
from impact_xval.experiments.config.experiment import REFERENCE, Config, parse_config
from impact_xval.experiments.measures.divergence import divergence
from impact_xval.experiments.measures.ladder_table import COLLISION_LADDERS
from impact_xval.experiments.sweep.kernels import Kernels, kernels_of
from impact_xval.experiments.sweep.kinds.kind import Kind, marked, scaled_diagnostics, settings_of, whole
from impact_xval.experiments.tables.schema import CERTIFICATE, COLLISIONS, MEASURES
from impact_xval.model.collision import RESULT_STATUSES, Outcome, Status


class Collisions(Kind):
    """Cells are `GridCell`, outcomes `Outcome`."""

    layout, ladders = COLLISIONS, COLLISION_LADDERS
    bounded = (*MEASURES, *CERTIFICATE)

    def kernels(self, solvers: Iterable[str]) -> list[Kernels]:
        """List the kernels that some solvers need."""
        return kernels_of(solvers)

    def ordinary(self) -> tuple[Config, GridCell]:
        """Return the built-in experiment, and the cell of its figures."""
        config = parse_config({})
        return config, GridCell(0, 1.0, 1.0, collision_of(config, config.figure_cell))

    def answer(self, solver: Solver, cells: Sequence[GridCell], config: Config) -> list[Outcome]:
        """Answer every cell by a solver, in order, whatever it does."""
        return answer(solver, [cell.collision for cell in cells], settings_of(config))

    def failure(self, name: str, cell: GridCell, status: Status, reason: str) -> Outcome:
        """Record that a solver gave no result, and why."""
        return Outcome.failure(name, cell.collision, status, reason)

    def facts(
        self, config: Config, name: str, cell: GridCell, model: Outcome, outcome: Outcome
    ) -> dict[str, Any]:
        """Give what a row holds without being measured."""
        c, diagnostics = cell.collision, scaled_diagnostics(outcome, abs(cell.collision.v0))
        return {
            "cell": cell.index,
            "stiffness_ratio": cell.stiffness_ratio,
            "mass_ratio": cell.mass_ratio,
            **{name: getattr(c, name) for name in ("e1", "e2", "m1", "m2", "k1", "k2", "v0")},
            "solver": name,
            "status": outcome.status,
            "reason": outcome.reason or None,
            "differences": outcome.differences or None,
            "grazing_margin": outcome.grazing_margin,
            "marked": marked(model, outcome),
            "gravity_number": config.gravity_number(c.m2),
            "step": diagnostics.get("step"),
            "n_steps": whole(diagnostics.get("n_steps")),
            "duration": diagnostics.get("duration"),
            **{column: diagnostics.get(column) for column in CERTIFICATE},
            "model_states": " ".join(model.states) or None,
            "model_status": model.status,
            "model_grazing_margin": model.grazing_margin,
        }

    def measured(
        self, config: Config, name: str, cell: GridCell, model: Outcome, outcome: Outcome
    ) -> dict[str, Any]:
        """Give what else it holds: the divergence from the model, and the outcome."""
        c = cell.collision
        shortest = config.shortest_state * min(periods(c))
        paths = compared_states(model, shortest), compared_states(outcome, shortest)
        row: dict[str, Any] = {"model_states_compared": " ".join(paths[0]) or None}
        if name != REFERENCE:  # the model's divergence from itself is in no table
            row |= divergence(c, model, outcome, paths)
        # A result that is not converged keeps the numbers it came to, but is no measure of anything.
        if outcome.status in (*RESULT_STATUSES, "unconverged") and math.isfinite(outcome.v1):
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
        return row
