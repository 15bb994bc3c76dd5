"""A rigid engine and its adapter, as an example of how to compare your engine.

The engine takes steps of a fixed length and has no gravity. In each step it sweeps over the closed contacts. A contact
whose bodies approach gets the impulse of Newton's restitution. The sweeps end when no contact approaches. This method
is called sequential impulses.
"""

import numpy as np

from impact_xval.plugins import Engine, World

SWEEPS = 1000


class ToyWorld(World):
    """A scene in the engine: balls in a line, ball 1 on top, with up positive. A table is a body that does not move."""

    def __init__(self, scene):
        table = [0.0] if scene.table else []
        self.v, self.x = np.array([*scene.velocities, *table]), np.array([*scene.heights, *table])
        self.inverse = np.array([*(1 / m for m in scene.masses), *table])
        self.balls, self.e, self.h = len(scene.masses), scene.restitutions, scene.step
        self.tiny = 1e-15 * scene.fastest
        self.heights = self.x[: self.balls].copy()
        self.effective = {"restitution": self.e, "step": (self.h,)}

    def advance(self, n):
        """Take n steps; return the velocities and the heights of the balls after each step."""
        states = np.array([self.step() for _ in range(n)])[..., : self.balls]
        return states[:, 0], states[:, 1]

    def weightless(self, velocities, heights):
        """Do nothing, because the engine has no gravity and the adapter refuses drops."""

    def step(self):
        """Give impulses at the closed contacts, move all bodies, and return velocities and heights."""
        v, w = self.v, self.inverse
        closed = np.flatnonzero(np.diff(self.x) >= 0)
        for _ in range(SWEEPS):
            approaching = [i for i in closed if v[i + 1] > v[i]]
            for i in approaching:
                rate = max(v[i + 1] - v[i], 0.0)  # the contact before this one may have stopped the approach
                if rate < self.tiny:  # the balls come to rest together after infinitely many impulses
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
    """Adapter of the toy engine: a rigid engine without gravity."""

    name, kind, law = "toy", "rigid", None

    def version(self):
        """Return the version of the engine."""
        return "1.0"

    def unavailable(self):
        """Return the reason why the engine cannot run, which is None here."""
        return None

    def refusal(self, scene):
        """Return in one sentence why the engine cannot take a scene, or None if it can."""
        return f"gravity = {scene.gravity:g} m/s^2: the toy has none; legal: 0" if scene.gravity else None

    def world(self, scene):
        """Return a scene that is set up in the engine."""
        return ToyWorld(scene)
