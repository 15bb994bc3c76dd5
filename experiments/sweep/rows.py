"""Cells by a solver, as the rows of a part: of two balls and of N, all of a chunk at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.answers import answer, said
from impact_xval.compliant_baselines.solver import Convergence, Settings, Solver
from impact_xval.experiments.config.cells import Block
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.measures.divergence import (
    Floats,
    Results,
    divergence,
    masses_and_starts,
    results_of,
    retained_energy,
    retained_momentum,
)
from impact_xval.experiments.measures.ladder import ladders, of_balls, scatter
from impact_xval.experiments.measures.laws import exact_for
from impact_xval.experiments.measures.layout import engines_with_ladders, layout_of
from impact_xval.experiments.tables.schema import Layout, to_table
from impact_xval.model.collision import Collisions, Outcome, Status

#: Finds a solver by its name; a function at the top level of a module, so that worker processes can find it.
Resolve = Callable[[str], Solver]

#: Status and reason of what is lost: of a solver (by name) at a cell (by its number).
Lost = dict[tuple[str, int], tuple[Status, str]]

#: Largest D and change of energy; the square of a larger number leaves double precision.
_LARGEST = 1e150


@dataclass
class Experiment:
    """What every process of a run is given once: the experiment, and what finds a solver by its name."""

    config: Config
    resolve: Resolve = get_solver
    _models: tuple[Any, Any] = field(default=(None, None), init=False, repr=False)

    @cached_property
    def layout(self) -> Layout:
        """Layout of the rows."""
        return layout_of(self.config)

    def results(self, name: str, block: Block, lost: Lost) -> Results:
        """Solve cells by a solver; those that are lost to it are failures, and it is not asked for them."""
        layout, why = self.layout, [lost.get((name, cell)) for cell in block.index.tolist()]
        settings = settings_of(self.config, paths=layout.pair)
        if not any(why):
            outcomes = answer(self.resolve(name), block.collisions, settings)
        else:
            cells = list(zip(block.collisions, why, strict=True))
            left = [c for c, failed in cells if not failed]
            solved = iter(answer(self.resolve(name), left, settings) if left else [])
            outcomes = [Outcome.failure(name, c, *failed) if failed else next(solved) for c, failed in cells]
        paths = layout.pair and self.config.measures == "all"
        shortest = self.config.shortest_state * shortest_periods(block) if paths else None
        speed = np.abs(block.parameters["v0"])
        return results_of(outcomes, speed, layout.balls, layout.contacts, shortest)

    def models(self, block: Block, lost: Lost) -> Results:
        """Solve cells by the reference; kept for the next solver of the same cells."""
        asked = block.index.tolist(), {key: why for key, why in lost.items() if key[0] == REFERENCE}
        if self._models[0] != asked:
            self._models = asked, self.results(REFERENCE, block, lost)
        return self._models[1]


def solve_all(experiment: Experiment, block: Block) -> pa.Table:
    """Solve cells by every solver; the rows by solver, then by cell."""
    return pa.concat_tables([solve_by(experiment, name, block, {}) for name in experiment.config.solvers])


def solve_by(experiment: Experiment, name: str, block: Block, lost: Lost) -> pa.Table:
    """Solve cells by one solver and compare it with the reference: a row for each cell, with the columns of a part.

    Solvers are not called for cells that are lost to them.
    """
    try:
        model = experiment.models(block, lost)
        found = model if name == REFERENCE else experiment.results(name, block, lost)
        return to_table(_columns(experiment, name, block, model, found), len(block), experiment.layout.rows)
    except Exception as error:  # an outcome of which no measure can be made costs its own row
        cell = name, int(block.index[0])
        if len(block) > 1:
            halves = block[: len(block) // 2], block[len(block) // 2 :]
            return pa.concat_tables([solve_by(experiment, name, half, lost) for half in halves])
        if cell in lost:
            raise
        why: Lost = {cell: ("crashed", f"measuring its outcome: {said(error)}")}
        return solve_by(experiment, name, block, lost | why)


def _columns(
    experiment: Experiment, name: str, block: Block, model: Results, found: Results
) -> dict[str, Any]:
    """Columns of the rows of a solver."""
    config, layout = experiment.config, experiment.layout
    masses, starts = masses_and_starts(block.collisions, layout.balls)
    speed = np.abs(block.parameters["v0"])
    # A result that is not converged keeps the numbers it came to, but is no measure of anything.
    withheld = (found.status == "unconverged") | (found.status == "timeout")
    numbers = (found.there | withheld) & ~np.isnan(found.velocities[:, 0])

    def kept(values: Any) -> Floats:
        return np.where(numbers, values, np.nan)

    columns: dict[str, Any] = {
        **found.diagnostics,  # those of which there is a column
        "cell": block.index,
        **block.parameters,
        "solver": np.full(len(block), name, dtype=object),
        "status": found.status,
        "marked": _marked(name, model, found),
        "reason": found.reason,
        "differences": found.differences,
        **{f"v{i}": kept(v) for i, v in enumerate(found.velocities.T, 1)},
        **{f"impulse{i}": kept(v) for i, v in enumerate(found.impulses.T, 1)},
        "states": np.where(numbers, np.array(found.states, dtype=object), ""),
        "states_compared": np.where(numbers, np.array(found.compared, dtype=object), ""),
        "n_states": kept(found.n_states),
        "n_events": kept(found.n_events),
        "grazing_margin": found.margin,
        "retained_energy": kept(retained_energy(masses, starts, found)),
        "retained_momentum": kept(retained_momentum(masses, starts, found)),
        "model_states": model.states,
        "model_states_compared": model.compared,
        "model_status": model.status,
        "model_grazing_margin": model.margin,
    }
    if layout.pair:
        columns["gravity_number"] = config.gravity_number(
            *(block.parameters[name] for name in ("m2", "m1", "k1"))
        )
    if name != REFERENCE:  # the model's divergence from itself is in no table
        measured = divergence(masses, starts, speed, model, found)
        for key in ("velocity_divergence", "dretained_energy"):
            worst = measured[key][model.there & found.there]
            if not np.all(np.abs(worst) <= _LARGEST):
                raise ArithmeticError(f"{key} = {float(np.abs(worst).max())!r}; legal: at most {_LARGEST:g}")
        columns |= measured
    return columns


def completed(experiment: Experiment, block: Block, rows: pa.Table) -> pa.Table:
    """Fill in what needs the rows of several solvers, by cell, then by solver: distances of limits, and ladders."""
    names = experiment.config.solvers
    per_cell = {name: np.arange(i, len(rows), len(names)) for i, name in enumerate(names)}
    columns: dict[str, Any] = {"limit_distance": _limit_distances(experiment, block, rows, per_cell)}
    model = rows.take(per_cell[REFERENCE])
    engines = {name: rows.take(per_cell[name]) for name in engines_with_ladders(experiment.config)}
    for name, found in ladders(experiment.config, block, model, engines).items():
        for key, values in found.items():
            scatter(columns, f"ladder_{key}", values, per_cell[name], len(rows))
    return _with(rows, columns)


def without_ladder(experiment: Experiment, rows: pa.Table, status: str, reason: str) -> pa.Table:
    """Say of the rows of engines why they have no ladder."""
    engines = np.isin(rows["solver"].to_pylist(), engines_with_ladders(experiment.config))
    said = {"status": status, "reason": reason}
    said |= {key: np.array(rows[key].to_pylist(), dtype=object) for key in ("marked", "limit_error")}
    return _with(rows, {f"ladder_{key}": np.where(engines, x, np.array(None)) for key, x in said.items()})


def _with(rows: pa.Table, columns: dict[str, Any]) -> pa.Table:
    """Replace columns."""
    made = to_table(columns, len(rows), pa.schema([rows.schema.field(name) for name in columns]))
    for name in columns:
        rows = rows.set_column(rows.schema.get_field_index(name), rows.schema.field(name), made[name])
    return rows


def _limit_distances(
    experiment: Experiment, block: Block, rows: pa.Table, per_cell: dict[str, NDArray[np.intp]]
) -> Floats:
    """Distance per abs(v0) of each limit dt -> 0 from the exact solver of its law; NaN without either."""
    balls, found = range(1, 1 + experiment.layout.balls), np.full(len(rows), np.nan)
    for name, places in per_cell.items():
        law = exact_for(name, experiment.config.mapping)
        if law in per_cell and law != name:
            exact = of_balls(rows.take(per_cell[law]), "v{}", balls) / np.abs(block.parameters["v0"])[:, None]
            away = np.abs(of_balls(rows.take(places), "v{}_limit", balls) - exact)
            both = ~np.isnan(away[:, 0])
            found[places[both]] = np.nanmax(away[both], axis=1, initial=0.0)
    return found


def _marked(name: str, model: Results, found: Results) -> NDArray[np.object_]:
    """Say what a comparison of results with the model's lies beside: a jump of either, or a cut-off."""
    own = _named(name, found.mark)
    if found is model:
        return own
    models = _named(REFERENCE, model.mark)
    return models + np.where((models != "") & (own != ""), "; ", "").astype(object) + own


def _named(name: str, marks: NDArray[np.object_]) -> NDArray[np.object_]:
    return np.array([f"{name}: {mark}" if mark else "" for mark in marks], dtype=object)


def shortest_periods(block: Block) -> Floats:
    """Shorter contact period of two balls on a table, in s: 0 of a rigid contact, infinite without stiffness."""
    some = Collisions.of(block.collisions)
    m, k = some.masses, some.stiffnesses
    with np.errstate(divide="ignore", over="ignore"):
        rates = k / np.column_stack([1 / (1 / m[:, 0] + 1 / m[:, 1]), m[:, 1]])
        return 2 * np.pi / np.sqrt(rates.max(axis=1))


def settings_of(config: Config, *, paths: bool = True) -> Settings:
    """Return the settings of every solver of an experiment; outcomes carry their paths, if asked for."""
    how, full = config.convergence, config.measures == "all"
    alike = config.model_dump(include={each.name for each in fields(Settings)} - {"convergence"})
    limit = Convergence(how.tolerance, how.halvings) if how.enabled else None
    return Settings(**alike, record_path=paths and full, mark=full, convergence=limit)
