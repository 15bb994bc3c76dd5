"""Cells by a solver, as the rows of a part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import pyarrow as pa

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Solver
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.sweep.kinds.collisions import Collisions
from impact_xval.experiments.sweep.kinds.columns import Lines
from impact_xval.experiments.sweep.kinds.kind import Kind, Numbered
from impact_xval.model.collision import Status

#: Finds a solver by its name; a function at the top level of a module, so that worker processes can find it.
Resolve = Callable[[str], Solver]

#: Status and reason of what is lost: of a solver (by name) at a cell (by index).
Lost = dict[tuple[str, int], tuple[Status, str]]


@dataclass
class Experiment:
    """What every process of a run is given once.

    Attributes
    ----------
    config : Config
        The experiment; its first solver is the reference.
    resolve : callable
        Finds a solver by its name.
    ready : set of str
        The engines, and solvers of other distributions, that this process is ready for (`make_ready`).
    """

    config: Config
    resolve: Resolve = get_solver
    ready: set[str] = field(default_factory=set, init=False, repr=False)
    _models: tuple[Any, list[Any]] = field(default=(None, []), init=False, repr=False)

    @property
    def kind(self) -> Kind:
        """The kind of its cells."""
        return kind_of_cells(self.config)

    def outcomes(self, name: str, cells: Sequence[Numbered], lost: Lost) -> list[Any]:
        """Solve cells by a solver; those that are lost to it are failures."""
        asked = [cell for cell in cells if (name, cell.index) not in lost]
        found = iter(self.kind.answer(self.resolve(name), asked, self.config) if asked else [])
        return [
            self.kind.failure(name, cell, *lost[name, cell.index])
            if (name, cell.index) in lost
            else next(found)
            for cell in cells
        ]

    def models(self, cells: Sequence[Numbered], lost: Lost) -> list[Any]:
        """Solve cells by the reference; kept for the next solver of the same cells."""
        if self._models[0] != list(cells):
            self._models = list(cells), self.outcomes(REFERENCE, cells, lost)
        return self._models[1]


def kind_of_cells(config: Config) -> Kind:
    """Return the kind of the cells of an experiment."""
    return Collisions() if config.column is None else Lines()


def solve_all(experiment: Experiment, cells: Sequence[Numbered]) -> pa.Table:
    """Solve cells by every solver; the rows by solver, then by cell."""
    return pa.concat_tables([solve_by(experiment, name, cells, {}) for name in experiment.config.solvers])


def solve_by(experiment: Experiment, name: str, cells: Sequence[Numbered], lost: Lost) -> pa.Table:
    """Solve cells by one solver and compare it with the reference.

    Parameters
    ----------
    experiment : Experiment
    name : str
        Of the solver.
    cells : sequence of cells
    lost : dict
        Solvers that are not called for a cell, with the status and reason of that row.

    Returns
    -------
    Table
        A row for each cell, with the columns of the layout of its kind.
    """
    models = experiment.models(cells, lost)
    outcomes = models if name == REFERENCE else experiment.outcomes(name, cells, lost)
    kind, answers = experiment.kind, zip(cells, models, outcomes, strict=True)
    rows = [kind.row(experiment.config, name, *each) for each in answers]
    return pa.Table.from_pylist(rows, schema=kind.layout.rows)
