"""The state-transition model behind the contract every solver keeps; with it, its oracle and a second impact law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.contract.solver import Settings, SolverBase
from impact_xval.model import Collision, Column, ColumnOutcome, Outcome, solve

Floats = NDArray[np.float64]

#: The oracle's cut-off where the settings ask for the outcome without one: at 1e10 the closed form changes less than
#: 1e-12.
CONVERGED = 1e10


class StateTransitionSolver(SolverBase):
    """The state-transition model; of the settings it knows the cut-off and the path only.

    It has no gravity and no step: `impact` and `drop` are the same collision to it.
    """

    name = "state-transition"
    impact_law = "jia-mason-erdmann"

    def version(self) -> str:
        """Version of this project: the model is its own."""
        return version("impact-xval")

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order."""
        return [
            solve(
                c,
                stiffness_ratio_cutoff=settings.stiffness_ratio_cutoff,
                path=settings.record_path,
                impact_law=self.impact_law,
                grazing_threshold=settings.grazing_threshold,
            )
            for c in collisions
        ]

    def solve_columns(
        self, columns: Sequence[Column], settings: Settings, exponent: float = 1.0
    ) -> list[ColumnOutcome]:
        """Answer every column of N balls, in order; gaps are ``unrepresentable``."""
        return [self._column(column, settings, exponent) for column in columns]

    def _column(self, column: Column, settings: Settings, exponent: float) -> ColumnOutcome:
        from impact_xval.model import solve_column  # with scipy's integrators, which nobody else here needs

        try:
            outcome = solve_column(
                column,
                law=self.impact_law,
                exponent=exponent,
                path=settings.record_path,
                grazing_threshold=settings.grazing_threshold,
            )
        except ValueError as refusal:
            return ColumnOutcome.failure(self.name, column, "unrepresentable", str(refusal))
        return replace(outcome, solver=self.name)


class LiuZhaoBrogliatoSolver(StateTransitionSolver):
    """The impact law of Liu, Zhao and Brogliato (Proc. R. Soc. A 464:3193, 2008) on the same diagram.

    Bistiffness with energetic restitution, positions frozen, as in the primary model; but every compression runs at the
    original stiffness (`model.pair.kernel`). It equals the primary model exactly until a contact compresses a second
    time. `limit` also where the bodies come to rest together after infinitely many events.
    """

    name = impact_law = "liu-zhao-brogliato"

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order."""
        return [replace(outcome, solver=self.name) for outcome in super().solve_many(collisions, settings)]


class OracleSolver(SolverBase):
    """The model by numerical integration in impulse space (`model.oracle`); of the settings it knows the cut-off.

    It has no gravity and no path, and refuses limits. It is some thousand times slower than the model it checks,
    so it runs only where it is asked for by name.
    """

    name = "oracle"

    def version(self) -> str:
        """Version of scipy, which does the integration."""
        return version("scipy")

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order; a limit is ``unrepresentable``."""
        cutoff = settings.stiffness_ratio_cutoff
        return [self._answer(c, CONVERGED if isinstance(cutoff, str) else cutoff) for c in collisions]

    def _answer(self, collision: Collision, cutoff: float) -> Outcome:
        from impact_xval.model.oracle import solve_oracle  # scipy's integrators: nobody else here needs them

        try:
            return solve_oracle(collision, stiffness_ratio_cutoff=cutoff)
        except ValueError as refusal:
            return Outcome.failure(self.name, "unrepresentable", str(refusal))
