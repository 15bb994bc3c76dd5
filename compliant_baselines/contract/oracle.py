"""The oracle (`model.oracle`) behind the contract that every solver keeps."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

from impact_xval.compliant_baselines.contract.solver import Settings, SolverBase
from impact_xval.model import Collision, Outcome
from impact_xval.model.oracle import NAME, solve_oracle

#: The cut-off where the settings ask for the outcome without one: at 1e10 the closed form changes less than 1e-12.
CONVERGED = 1e10


class OracleSolver(SolverBase):
    """The state-transition model by numerical integration in impulse space; of the settings it knows the cut-off.

    It has no gravity and no path, and refuses limits. It is some thousand times slower than the model it checks,
    so it runs only where it is asked for by name.
    """

    name = NAME

    def version(self) -> str:
        """Version of scipy, which does the integration."""
        return version("scipy")

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order; a limit is ``unrepresentable``."""
        cutoff = settings.stiffness_ratio_cutoff
        return [self._answer(c, CONVERGED if isinstance(cutoff, str) else cutoff) for c in collisions]

    def _answer(self, collision: Collision, cutoff: float) -> Outcome:
        try:
            return solve_oracle(collision, stiffness_ratio_cutoff=cutoff)
        except ValueError as refusal:
            return Outcome.failure(self.name, "unrepresentable", str(refusal))
