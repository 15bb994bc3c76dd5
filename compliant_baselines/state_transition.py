"""The primary solver behind the contract that every solver keeps."""

from __future__ import annotations

from collections.abc import Sequence
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
