"""An example of a solver: a rigid law in closed form, in which ball B2 is a part of the table."""

import numpy as np

from impact_xval.plugins import OneByOne, Outcome, Path


class Anvil(OneByOne):
    """Solver in which ball B1 leaves with e1 times its speed of approach, and ball B2 stays at rest."""

    name, kind, law = "anvil", "rigid", None

    def version(self):
        """Return the version of the law."""
        return "1.0"

    def solve_one(self, collision, settings):
        """Return the outcome of one collision, or a failure with the reason."""
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
