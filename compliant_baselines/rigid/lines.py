"""What adapters of rigid engines share: spheres of one size in a line, and steps that are read one by one.

Contacts that touch overlap by `OVERLAP` of a radius at first: most engines meet bodies that only just touch in another
step than those that overlap, or not, and would make one impact after the other of what is meant to be one. The overlap
is not pushed out: each adapter switches the correction of positions off.

Most engines make the restitution of a contact from one number a body. A ball is therefore two spheres of half its
radius, one above the other: the lower one carries the contact with what is below, the upper one that with what is
above. Where they are, no other two can meet.

Relative velocities of up to `RigidWorld.resolution` of the fastest ball at the start are reported as none, or a
collision would not be over until a gap has closed at 1e-17 m/s.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, sweeps

#: Overlap of touching bodies over the radius: 60 units in the last place of a single-precision height of four radii, a
#: fiftieth of the way in a step of a thousandth of a period. A power of two: exact in double precision.
OVERLAP = 2.0**-16

#: Radius in m of the balls of an engine that is run as it ships: its thresholds are lengths.
SHIPPED_RADIUS = 2.0**-4

#: Sixty-four units in the last place, in double and in single precision; a large number that has an inverse in both.
DOUBLE, SINGLE, LARGEST = 2.0**-46, 2.0**-17, 1e30


class RigidWorld(World):
    """Spheres in a line, ball 1 on top; the table's surface is at height 0.

    `partner` is the coefficient of restitution above a ball and on the table, with which e combines.
    """

    resolution, partner, accuracy = DOUBLE, 1.0, DOUBLE

    def __init__(self, scene: Scene, radius: float) -> None:
        super().__init__(scene, radius)
        self._table, self._tiny = scene.table, self.resolution * scene.fastest
        below = np.append(scene.gaps == 0, [] if scene.table else [False])
        self.heights = self.heights - OVERLAP * self.radius * np.cumsum(below[::-1])[::-1]
        #: Sweeps over the contacts after which sequential impulses are converged to rounding.
        self.sweeps = 4 + min(996, sweeps(scene))

    @property
    def centres(self) -> list[float]:
        """Heights of the centres at t = 0, in m."""
        return (self.places + self.heights).tolist()

    @abstractmethod
    def step(self) -> tuple[list[float], list[float]]:
        """Take a step; velocities in m/s and heights of the centres in m after it."""

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps."""
        states = np.array([self.step() for _ in range(n)])
        v = np.column_stack([states[:, 0], np.zeros(len(states))])
        for i in range(v.shape[1] - 2 - (not self._table), -1, -1):
            together = np.abs(v[:, i] - v[:, i + 1]) <= self._tiny
            v[together, i] = v[together, i + 1]
        return v[:, :-1], states[:, 1] - self.places

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Go on without gravity: of drops, which are refused."""


class RigidEngine(Engine):
    """A rigid engine: restitutions are the contacts' own, stiffnesses only say how long a step is."""

    kind, law = "rigid", None

    def radius(self, scene: Scene) -> float:
        """As `Engine.radius`."""
        return SHIPPED_RADIUS if scene.mapping == "shipped" else super().radius(scene)

    def refusal(self, scene: Scene) -> str | None:
        """Why it cannot take a scene: drops, and what single precision has no numbers for."""
        if scene.gravity:
            return f"gravity = {scene.gravity:g} m/s^2: rigid engines are run without; legal: 0"
        if scene.mapping == "shipped" and scene.fastest * scene.step > SHIPPED_RADIUS:
            return (
                f"|v0| = {scene.fastest:.3g} m/s: more than a radius of {SHIPPED_RADIUS} m "
                f"in a step of {scene.step:.3g} s"
            )
        numbers = (*scene.masses, *filter(None, map(abs, scene.velocities)), scene.step)
        if 1 / LARGEST < min(numbers) <= max(numbers) < LARGEST:
            return None
        return f"masses, velocities or a step beyond {LARGEST:.0e} or below its inverse, in SI units"


def said(value: float, asked: float) -> float:
    """Give a number that an engine of single precision says it uses: the one asked for, if it is the nearest to it."""
    return asked if np.float32(asked) == np.float32(value) else value
