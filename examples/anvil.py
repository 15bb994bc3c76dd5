"""A rigid law in closed form as a solver: B2 as part of the table."""

import numpy as np

from impact_xval.compliant_baselines.solver import OneByOne
from impact_xval.model.outcome import Outcome
from impact_xval.model.path import Path


class Anvil(OneByOne):
    """B1 leaves with e1 times the speed it came with, B2 stays where it is."""

    name, kind, law = "anvil", "rigid", None

    def version(self):
        """Version of the law."""
        return "1.0"

    def solve_one(self, collision, settings):
        """Give the outcome of one collision, or say why there is none."""
        if not collision.falls_on_resting or settings.scenario == "drop":
            reason = "the anvil knows two balls on a table, without gravity"
            return Outcome.failure(self.name, collision, "unrepresentable", reason)
        v1 = -collision.e1 * collision.v0
        impulse = collision.m1 * (v1 - collision.v0)
        path = None
        if settings.record_path:
            velocities = np.array([[collision.v0, 0.0], [v1, 0.0]])
            impulses = np.array([[0.0, 0.0], [impulse, impulse]])
            acting = np.array([[True, True], [False, False]])
            path = Path(np.zeros(2), velocities, impulses, np.zeros((2, 2)), acting)
        return Outcome(self.name, (v1, 0.0), (impulse, impulse), ("S1", "S4"), path=path)
