"""The primary solver, and the second impulse-level model, behind the contract that every solver keeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version

from impact_xval.compliant_baselines.contract.solver import Settings, SolverBase
from impact_xval.model import Collision, Outcome, solve


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


class LiuZhaoBrogliatoSolver(StateTransitionSolver):
    """The impact law of Liu, Zhao and Brogliato (Proc. R. Soc. A 464:3193, 2008) on the same diagram.

    Bistiffness with energetic restitution, positions frozen, as in the primary model; but every compression runs at the
    original stiffness (`model.diagram`). It equals the primary model exactly until a contact compresses a second
    time. `limit` also where the bodies come to rest together after infinitely many events.
    """

    name = impact_law = "liu-zhao-brogliato"

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order."""
        return [replace(outcome, solver=self.name) for outcome in super().solve_many(collisions, settings)]
