"""A rigid engine behind `Engine`: coefficients of restitution, e = 0 among them, and a support that is rigid."""

import numpy as np

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import World
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision


class Clay(World):
    """All balls stop in the first step, and stay on the table."""

    def __init__(self, scene):
        self.heights, self.balls = np.array(scene.heights), len(scene.masses)
        self.effective = {
            "restitution": scene.restitutions,
            "step": (0.5 * scene.step,),
            "threshold": (0.05,),
        }

    def advance(self, n):
        """Take n steps."""
        return np.zeros((n, self.balls)), np.zeros((n, self.balls))

    def weightless(self, velocities, heights):
        """Nothing flies."""


class ClayEngine(Engine):
    """Balls of clay."""

    name, kind, law = "clay", "rigid", None

    def version(self):
        """Version of the engine."""
        return "1"

    def unavailable(self):
        """It is here."""
        return None

    def world(self, scene):
        """Set a scene up."""
        return Clay(scene)


def test_plastic_balls_on_a_rigid_table_are_at_rest_after_a_step():
    c = Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=1e6, e1=0.0, e2=0.0, v0=-2.0)
    for scenario in ("impact", "drop"):
        outcome = ClayEngine().solve(c, Settings(scenario=scenario))
        assert outcome.velocities == (0, 0), scenario
        assert outcome.diagnostics["n_steps"] <= 2
        assert outcome.marked == ""
        # Half the step, and a speed below which nothing bounces: neither was asked for.
        assert "step is" in outcome.differences
        assert "threshold is 0.05, 0 was asked for" in outcome.differences
        assert "restitution" not in outcome.differences
