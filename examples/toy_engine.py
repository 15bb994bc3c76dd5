"""A rigid engine and its adapter: all there is to write to compare an engine of one's own.

The engine takes steps of a fixed length. In each it sweeps over the contacts that are closed and gives one whose bodies
approach the impulse of Newton's restitution, until none approaches: sequential impulses. It knows no gravity.
"""

import numpy as np

from impact_xval.plugins import Engine, World

SWEEPS = 1000


class ToyWorld(World):
    """A scene, set up: balls in a line, ball 1 on top, up is positive, and a table as a body that does not move."""

    def __init__(self, scene):
        table = [0.0] if scene.table else []
        self.v, self.x = np.array([*scene.velocities, *table]), np.array([*scene.heights, *table])
        self.inverse = np.array([*(1 / m for m in scene.masses), *table])
        self.balls, self.e, self.h = len(scene.masses), scene.restitutions, scene.step
        self.tiny = 1e-15 * scene.fastest
        self.heights = self.x[: self.balls].copy()
        self.effective = {"restitution": self.e, "step": (self.h,)}

    def advance(self, n):
        """Take n steps; velocities and heights of the balls after each."""
        states = np.array([self.step() for _ in range(n)])[..., : self.balls]
        return states[:, 0], states[:, 1]

    def weightless(self, velocities, heights):
        """Go on without gravity: of drops, which the adapter refuses."""

    def step(self):
        """Treat the closed contacts one after the other, and move."""
        v, w = self.v, self.inverse
        closed = np.flatnonzero(np.diff(self.x) >= 0)
        for _ in range(SWEEPS):
            approaching = [i for i in closed if v[i + 1] > v[i]]
            for i in approaching:
                rate = max(v[i + 1] - v[i], 0.0)  # the contact before may have stopped it
                if rate < self.tiny:  # balls that come to rest together after infinitely many impulses
                    v[i] = v[i + 1]
                    continue
                impulse = (1 + self.e[i]) * rate / (w[i] + w[i + 1])
                v[i] += w[i] * impulse
                v[i + 1] -= w[i + 1] * impulse
            if not approaching:
                break
        self.x += self.h * v
        return v.copy(), self.x.copy()


class ToyEngine(Engine):
    """The adapter: what the engine is, what it refuses, and how it sets a scene up."""

    name, kind, law = "toy", "rigid", None

    def version(self):
        """Version of the engine."""
        return "1.0"

    def unavailable(self):
        """Nothing keeps it from running."""
        return None

    def refusal(self, scene):
        """Why the engine cannot take a scene, in one sentence; None if it can."""
        return f"gravity = {scene.gravity:g} m/s^2: the toy has none; legal: 0" if scene.gravity else None

    def world(self, scene):
        """Set a scene up."""
        return ToyWorld(scene)
