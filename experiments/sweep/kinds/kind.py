"""What every kind of cells has: `Kind`; and what all rows share."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import pyarrow as pa

from impact_xval.compliant_baselines.answers import said
from impact_xval.compliant_baselines.solver import Convergence, Settings, Solver
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.ladder_table import Ladders
from impact_xval.experiments.sweep.kernels import Kernels
from impact_xval.experiments.tables.schema import Layout
from impact_xval.model.collision import Outcome, Status

#: Diagnostics in m/s; tables and JSON state them per abs(v0).
_VELOCITY = re.compile(r"v\d+_limit|limit_error|velocity_error|regularisation|rest_speed")

#: Largest measure, and number of a certificate; the square of a larger one leaves double precision.
_LARGEST = 1e150


class Numbered(Protocol):
    """A cell of any kind."""

    @property
    def index(self) -> int:
        """Position in the experiment, from 0."""
        ...


class Kind(ABC):
    """Cells of one kind; it has no state.

    Attributes
    ----------
    layout : Layout
        Of the tables of a run.
    ladders : Ladders
        How their ladders are made.
    bounded : sequence of str
        Columns whose numbers are at most `_LARGEST`.
    """

    layout: Layout
    ladders: Ladders
    bounded: Sequence[str]

    @abstractmethod
    def kernels(self, solvers: Iterable[str]) -> list[Kernels]:
        """List the kernels that some solvers need."""

    @abstractmethod
    def ordinary(self) -> tuple[Config, Any]:
        """Return an experiment, and a cell of it that every solver answers at once."""

    @abstractmethod
    def answer(self, solver: Solver, cells: Sequence[Any], config: Config) -> list[Any]:
        """Answer every cell by a solver, in order, whatever it does."""

    @abstractmethod
    def failure(self, name: str, cell: Any, status: Status, reason: str) -> Any:
        """Record that a solver gave no result, and why."""

    @abstractmethod
    def facts(self, config: Config, name: str, cell: Any, model: Any, outcome: Any) -> dict[str, Any]:
        """Give what a row holds without being measured."""

    @abstractmethod
    def measured(self, config: Config, name: str, cell: Any, model: Any, outcome: Any) -> dict[str, Any]:
        """Give what else it holds."""

    def row(self, config: Config, name: str, cell: Any, model: Any, outcome: Any) -> dict[str, Any]:
        """Make the row of a cell and solver, whatever the measures make of its outcome."""
        try:
            row = self.facts(config, name, cell, model, outcome)
            row |= self.measured(config, name, cell, model, outcome)
            for column in self.bounded:
                value = row.get(column)
                for number in value if isinstance(value, list) else [value]:
                    if isinstance(number, float) and not abs(number) <= _LARGEST:
                        raise ArithmeticError(f"{column} = {number!r}; legal: at most {_LARGEST:g}")
        except Exception as error:
            failure = self.failure(name, cell, "crashed", f"measuring its outcome: {said(error)}")
            return self.facts(config, name, cell, model, failure)
        return row

    def completed(self, config: Config, rows: pa.Table) -> pa.Table:
        """Fill in what needs the rows of several solvers; rows by cell, then by solver."""
        return rows


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


def scaled_diagnostics(outcome: Outcome, speed: float) -> dict[str, float]:
    """Return the diagnostics of an outcome with velocities per a speed in m/s; the others as they are, times in s."""
    return {
        name: value / speed if _VELOCITY.fullmatch(name) and value is not None else value
        for name, value in outcome.diagnostics.items()
    }


def marked(model: Outcome, outcome: Outcome) -> str | None:
    """Say what a comparison of an outcome with the model's lies beside: a jump of either, or a cut-off."""
    both = (model, outcome) if outcome is not model else (model,)
    return "; ".join(f"{each.solver}: {each.marked}" for each in both if each.marked) or None


def whole(value: float | None) -> int | None:
    """Return a count that is stated as a number."""
    return None if value is None else int(value)
