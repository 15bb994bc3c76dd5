"""Columns of N balls, as the rows of a part."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import Any

import pyarrow as pa

from impact_xval.compliant_baselines.answers import answer
from impact_xval.compliant_baselines.solver import Solver
from impact_xval.experiments.config.arrangements import COLUMN_LEGAL, Arranged
from impact_xval.experiments.config.cells import ColumnCell
from impact_xval.experiments.config.experiment import REFERENCE, Config, parse_config
from impact_xval.experiments.measures.columns.ladder import LINE_LADDERS
from impact_xval.experiments.measures.columns.measuring import exact_for, largest_difference, measures_of
from impact_xval.experiments.sweep.kernels import Kernels, column_kernels_of
from impact_xval.experiments.sweep.kinds.kind import Kind, marked, scaled_diagnostics, settings_of, whole
from impact_xval.experiments.tables.schema import LINE_MEASURES, LINES
from impact_xval.model.collision import RESULT_STATUSES, Outcome, Status

_STATED = ("limit_error", "order", "finest_step", "velocity_error")


class Lines(Kind):
    """Cells are `ColumnCell`, outcomes `Outcome`."""

    layout, ladders = LINES, LINE_LADDERS
    bounded = (*LINE_MEASURES, *_STATED, "velocities_limit")

    def kernels(self, solvers: Iterable[str]) -> list[Kernels]:
        """List the kernels that some solvers need."""
        return column_kernels_of(solvers)

    def ordinary(self) -> tuple[Config, ColumnCell]:
        """Return the built-in columns, and one of them."""
        return parse_config({"column": {}}), ColumnCell(0, Arranged.model_validate({"balls": 2}))

    def answer(
        self, solver: Solver, cells: Sequence[ColumnCell], config: Config, *, path: bool = False
    ) -> list[Outcome]:
        """Answer every column by a solver, in order, whatever it does."""
        settings = dataclasses.replace(settings_of(config), record_path=path)
        return answer(solver, [cell.column for cell in cells], settings)

    def failure(self, name: str, cell: ColumnCell, status: Status, reason: str) -> Outcome:
        """Record that a solver gave no result, and why."""
        return Outcome.failure(name, cell.column, status, reason)

    def facts(
        self, config: Config, name: str, cell: ColumnCell, model: Outcome, outcome: Outcome
    ) -> dict[str, Any]:
        """Give what a row holds without being measured."""
        arranged = cell.arranged
        diagnostics = scaled_diagnostics(outcome, abs(arranged.v0))
        limits = [diagnostics.get(f"v{i}_limit") for i in range(1, arranged.balls + 1)]
        strike = arranged.striking if arranged.arrangement == "cradle" else None
        return {
            "cell": cell.index,
            "arrangement": arranged.arrangement,
            **{key: getattr(arranged, key) for key in COLUMN_LEGAL},
            "strike": strike,
            "m1": arranged.m,
            "k1": arranged.k,
            "v0": arranged.v0,
            "solver": name,
            "status": outcome.status,
            "reason": outcome.reason or None,
            "differences": outcome.differences or None,
            "marked": marked(model, outcome),
            "grazing_margin": outcome.grazing_margin,
            "step": diagnostics.get("step"),
            "n_steps": whole(diagnostics.get("n_steps")),
            "duration": diagnostics.get("duration"),
            **{key: diagnostics.get(key) for key in _STATED},
            "velocities_limit": None if None in limits else limits,
            "model_status": model.status,
            "model_grazing_margin": model.grazing_margin,
        }

    def measured(
        self, config: Config, name: str, cell: ColumnCell, model: Outcome, outcome: Outcome
    ) -> dict[str, Any]:
        """Give what else it holds: the divergence from the model, and the outcome."""
        row: dict[str, Any] = {}
        if name != REFERENCE and {model.status, outcome.status} <= set(RESULT_STATUSES):
            ours, theirs = measures_of(
                cell.column, {REFERENCE: model, name: outcome}, config.mapping
            ).values()
            assert ours.retained_energy is not None
            assert theirs.retained_energy is not None
            row = {
                "velocity_divergence": theirs.velocity_divergence,
                "largest_dv": largest_difference(outcome.velocities, model.velocities)
                / abs(cell.arranged.v0),
                "dretained_energy": theirs.retained_energy - ours.retained_energy,
            }
        # A result that is not converged keeps the numbers it came to, but is no measure of anything.
        if outcome.status in (*RESULT_STATUSES, "unconverged") and all(
            map(math.isfinite, outcome.velocities)
        ):
            row |= {
                "velocities": list(outcome.velocities),
                "n_states": len(outcome.states),
                "n_events": outcome.n_events,
                "retained_energy": outcome.retained_energy(cell.column),
                "retained_momentum": outcome.retained_momentum(cell.column),
            }
        return row

    def completed(self, config: Config, rows: pa.Table) -> pa.Table:
        """Fill in the distance of engines' limits from the exact solvers of their laws."""
        keys = ["v0", "solver", "status", "velocities", "velocities_limit"]
        plain, many = rows.select(keys).to_pylist(), len(config.solvers)
        distances = [
            _limit_distance(config, row, dict(zip(config.solvers, plain[first : first + many], strict=True)))
            for first in range(0, len(plain), many)
            for row in plain[first : first + many]
        ]
        place = rows.schema.get_field_index("limit_distance")
        return rows.set_column(place, rows.schema.field(place), pa.array(distances, pa.float64()))


def _limit_distance(
    config: Config, row: dict[str, Any], by_solver: dict[str, dict[str, Any]]
) -> float | None:
    """Distance per abs(v0) of the limit in a row from the exact solver of its law; None without either."""
    name, limit = row["solver"], row["velocities_limit"]
    exact = by_solver.get(exact_for(name, config.mapping))
    if limit is None or exact is None:
        return None
    if not {row["status"], exact["status"]} <= set(RESULT_STATUSES):
        return None
    return largest_difference(limit, [v / abs(row["v0"]) for v in exact["velocities"]])
