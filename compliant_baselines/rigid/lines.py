"""The common part of the adapters of rigid engines: spheres in a line, and steps that are read one by one.

**Overlap.** Contacts that touch overlap at first by `OVERLAP` of a radius. Bodies that only just touch are met by most
engines in another step than bodies that overlap, or not at all, and what is meant to be one impact would become
several. The overlap is not pushed out: each adapter switches the correction of positions off.

**Restitution.** Most engines make the restitution of a contact from one number a body. A ball is therefore two spheres
of half its radius, one above the other. The lower sphere carries the contact with the body below and has the e of that
contact. The upper sphere carries the contact with the ball above. Where an engine multiplies two numbers, the upper
sphere and the table have `Settings.partner_restitution`, by default 1. No other two spheres can meet.

**Rest.** Relative velocities of up to `RigidWorld.resolution` of the fastest ball at the start are reported as 0.
Otherwise a collision would not be over until a gap has closed at 1e-17 m/s.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, count_sweeps

#: Overlap of touching bodies over the radius: 60 units in the last place of a single-precision height of four radii, a
#: fiftieth of the way in a step of a thousandth of a period. A power of two, so that it is exact in double precision.
OVERLAP = 2.0**-16

#: Radius in m of the balls of an engine that is run as it ships: its thresholds are lengths.
SHIPPED_RADIUS = 2.0**-4

#: Sixty-four units in the last place, in double and in single precision.
DOUBLE, SINGLE = 2.0**-46, 2.0**-17

#: A large number; it and its inverse are numbers of single precision.
LARGEST = 1e30


class RigidWorld(World):
    """Spheres in a line, ball 1 on top; the table's surface is at height 0."""

    #: Relative velocity, over the largest speed at the start, that is reported as 0.
    resolution = DOUBLE
    accuracy = DOUBLE

    def __init__(self, scene: Scene, radius: float) -> None:
        # A script of 0.4 sets this attribute, and would get other numbers without a word.
        if hasattr(RigidWorld, "partner"):
            raise TypeError("RigidWorld.partner is Settings(partner_restitution=...) now")
        super().__init__(scene, radius)
        self._table, self._tiny = scene.table, self.resolution * scene.fastest
        touches_below = np.append(scene.gaps == 0, [] if scene.table else [False])
        overlaps_below = np.cumsum(touches_below[::-1])[::-1]
        self.heights = self.heights - OVERLAP * self.radius * overlaps_below
        #: Sweeps over the contacts after which sequential impulses are converged to rounding.
        self.sweeps = 4 + min(996, count_sweeps(scene))

    @property
    def centres(self) -> list[float]:
        """Heights of the centres at t = 0, in m."""
        return (self.places + self.heights).tolist()

    @abstractmethod
    def step(self) -> tuple[list[float], list[float]]:
        """Take a step; return the velocities in m/s and the heights of the centres in m after it."""

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps."""
        states = np.array([self.step() for _ in range(n)])
        v = np.column_stack([states[:, 0], np.zeros(len(states))])
        balls = v.shape[1] - 1
        lowest_contact = balls - 1 if self._table else balls - 2
        for contact in range(lowest_contact, -1, -1):
            together = np.abs(v[:, contact] - v[:, contact + 1]) <= self._tiny
            v[together, contact] = v[together, contact + 1]
        return v[:, :-1], states[:, 1] - self.places

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Do nothing: drops are refused."""


class RigidEngine(Engine):
    """A rigid engine: restitutions are those of the contacts, stiffnesses decide only how long a step is."""

    kind, law = "rigid", None

    def radius(self, scene: Scene) -> float:
        """Return the radius in m of the balls."""
        return SHIPPED_RADIUS if scene.mapping == "shipped" else super().radius(scene)

    def refusal(self, scene: Scene) -> str | None:
        """Say why the engine cannot take a scene: a drop, or numbers beyond single precision."""
        if scene.gravity:
            return f"gravity = {scene.gravity:g} m/s^2: rigid engines are run without; legal: 0"
        if scene.mapping == "shipped" and scene.fastest * scene.step > SHIPPED_RADIUS:
            return (
                f"|v0| = {scene.fastest:.3g} m/s: more than a radius of {SHIPPED_RADIUS} m "
                f"in a step of {scene.step:.3g} s"
            )
        speeds = [abs(v) for v in scene.velocities if v]
        numbers = (*scene.masses, *speeds, scene.step)
        if 1 / LARGEST < min(numbers) <= max(numbers) < LARGEST:
            return None
        return f"masses, velocities or a step beyond {LARGEST:.0e} or below its inverse, in SI units"


def nearest_float32(value: float, requested: float) -> float:
    """Undo the rounding of a number read back from an engine of single precision.

    Returns the requested number if `value` is the nearest to it in single precision, else `value`.
    """
    return requested if np.float32(requested) == np.float32(value) else value
