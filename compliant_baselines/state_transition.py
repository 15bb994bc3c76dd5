"""The primary solver, and the second impulse-level model, behind the contract that every solver keeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version

from compliant_baselines.contract import Settings, SolverBase
from model import Collision, Outcome, solve


class StateTransitionSolver(SolverBase):
    """The state-transition model; of the settings it knows the cut-off and the path only.

    It has no gravity and no step: `impact` and `drop` are the same collision to it.
    """

    name = "state-transition"

    def version(self) -> str:
        """Version of this project: the model is its own."""
        return version("impact-xval")

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order."""
        return [
            solve(c, stiffness_ratio_cutoff=settings.stiffness_ratio_cutoff, path=settings.record_path)
            for c in collisions
        ]


class LiuZhaoBrogliatoSolver(StateTransitionSolver):
    """The impact law of Liu, Zhao and Brogliato (Proc. R. Soc. A 464:3193, 2008) on the same diagram.

    Bistiffness with energetic restitution, positions frozen, as in the primary model; but every compression runs at the
    original stiffness (`model.automaton`). It equals the primary model exactly until a contact compresses a second
    time. `limit` also where the bodies come to rest together after infinitely many events.
    """

    name = "liu-zhao-brogliato"

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order."""
        cutoff, path = settings.stiffness_ratio_cutoff, settings.record_path
        return [
            replace(
                solve(c, stiffness_ratio_cutoff=cutoff, path=path, impact_law=self.name), solver=self.name
            )
            for c in collisions
        ]
