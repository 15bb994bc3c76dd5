"""The common part of adapters of rigid engines: spheres in a line or a plane, with steps that are read one by one.

**Overlap.** The bodies of touching contacts overlap at first by `OVERLAP` of a radius. Without this overlap most
engines find the contact in a later step, or not at all, so that a single impact would become several. Each adapter
switches off the correction of positions, so that the overlap stays.

**Restitution.** Most engines compute the restitution of a contact from one number for each body. A ball therefore has a
sphere of half its radius for each of its contacts, inside the ball and next to the body that it touches. In a line one
of the two spheres is above the other. The sphere of the first body of a contact (in a line the upper ball) has the e of
the contact. Where an engine multiplies two numbers, the sphere of the second body, or the plane, has
`Settings.partner_restitution`, by default 1. Each contact with a fixed body has a plane of its own. Two shapes of
different contacts cannot meet.

**In a plane** normals turn by displacement over radius. Radii are larger by `PLANE_WIDER` where positions are double
precision. Single precision does not resolve the steps of larger balls. In single precision normals turn by about a
thousandth in a step of a thousandth of a period if an engine takes several steps for a single impact. The limit dt -> 0
removes this, and its bound is part of the limit's error.

**Rest.** Relative velocities of up to `RigidWorld.resolution` times the speed of the fastest ball at the start are
reported as 0. Otherwise a collision would only be over when a gap has closed at 1e-17 m/s.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import NamedTuple

import numpy as np

from impact_xval.compliant_baselines.engines.arrangement import in_space
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, count_sweeps, radius_of

#: Overlap of touching bodies over the radius: 60 units in the last place of a single-precision height of four radii, a
#: fiftieth of the way in a step of a thousandth of a period. A power of two, so that it is exact in double precision.
OVERLAP = 2.0**-16

#: Radius in m of the balls of an engine with its defaults: the engine's thresholds are lengths.
SHIPPED_RADIUS = 2.0**-4

#: Resolution of velocities: sixty-four units in the last place, in double and in single precision.
DOUBLE, SINGLE = 2.0**-46, 2.0**-17

#: Factor on the radii of balls in a plane, in double precision. Overlaps have the same length as in a line.
PLANE_WIDER = 2.0**20

#: A large number; it and its inverse are numbers of single precision.
LARGEST = 1e30


class Sphere(NamedTuple):
    """One of the small spheres of a ball."""

    #: Number of its contact, from 0.
    contact: int
    #: Position of its centre relative to the centre of the ball, in m: (x, y, z).
    offset: tuple[float, float, float]
    #: True if the ball is the first body of the contact; the sphere then has the contact's e.
    is_first: bool


class Wall(NamedTuple):
    """A fixed plane, against which one ball lies."""

    #: Number of its contact, from 0.
    contact: int
    #: The point in m at which the ball touches the plane, and the plane's normal, in space (x, y, z).
    point: Floats
    normal: Floats

    @property
    def angle(self) -> float:
        """The turn in rad about y that takes the z axis to the normal."""
        return math.atan2(float(self.normal[0]), float(self.normal[2]))


class RigidWorld(World):
    """Spheres in a line, ball 1 on top, the table's surface at height 0; or spheres and walls in a plane."""

    #: Relative velocity, over the largest speed at the start, that is reported as 0.
    resolution = DOUBLE
    accuracy = DOUBLE

    def __init__(self, scene: Scene, radius: float) -> None:
        # Scripts for version 0.4 set this attribute. Without this error they would silently get other numbers.
        if hasattr(RigidWorld, "partner"):
            raise TypeError("RigidWorld.partner is Settings(partner_restitution=...) now")
        super().__init__(scene, radius)
        self._table, self._tiny = scene.table, self.resolution * scene.fastest
        self._is_line, self.axes = scene.graph is None, scene.axes
        self.resting_rate = self._tiny
        overlap = OVERLAP * self.radius
        if scene.graph is not None:  # overlaps are no longer than in a line
            overlap = OVERLAP * min(self.radius, radius_of(scene.depth(scene.stiffnesses)))
        self.heights = self.heights + overlap * scene.closing
        self._arrangement = scene.arrangement
        #: Number of sweeps over the contacts after which sequential impulses have converged to rounding.
        self.sweeps = 4 + min(996, count_sweeps(scene))

    @property
    def centres(self) -> list[tuple[float, float, float]]:
        """Centres of the balls at t = 0 in space, in m."""
        return [tuple(centre) for centre in in_space(self.places + self.heights, self.axes).tolist()]

    def spheres(self, ball: int) -> list[Sphere]:
        """Return the spheres of a ball: first for contacts in which it is the first body, then for the others."""
        as_first, as_second = self._arrangement.sides(ball)
        spheres: list[Sphere] = []
        for contact in [*as_first, *as_second]:
            is_first = contact in as_first
            normal = np.array(self._arrangement.touches[contact].normal)
            ((x, y, z),) = in_space((-0.5 if is_first else 0.5) * self.radius * normal, self.axes).tolist()
            spheres.append(Sphere(contact, (x, y, z), is_first))
        return spheres

    @property
    def walls(self) -> list[Wall]:
        """The fixed planes."""
        return [
            Wall(
                contact,
                in_space(self.radius * self._arrangement.surface(contact), self.axes)[0],
                in_space(np.array(touch.normal), self.axes)[0],
            )
            for contact, touch in enumerate(self._arrangement.touches)
            if touch.second is None
        ]

    @abstractmethod
    def step(self) -> tuple[list[float], list[float]]:
        """Take a step; return the velocities in m/s and the coordinates of the centres in m after it."""

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps."""
        states = np.array([self.step() for _ in range(n)])
        if not self._is_line:
            return states[:, 0], states[:, 1] - self.places
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
    """Base class of rigid engines: contacts have restitutions; stiffnesses only decide the length of a step."""

    kind, law = "rigid", None
    #: Factor on radii in a plane: `PLANE_WIDER` in double precision.
    plane_wider: float = 1.0

    def radius(self, scene: Scene) -> float:
        """Return the radius in m of the balls."""
        if scene.mapping == "shipped":
            return SHIPPED_RADIUS
        radius = radius_of(scene.depth(scene.stiffnesses))
        return radius if scene.graph is None else radius * self.plane_wider

    def refusal(self, scene: Scene) -> str | None:
        """Return why the engine cannot take a scene: a drop, or numbers beyond single precision."""
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


def filter_bit(contact: int) -> int:
    """Return the bit for engines' filters that lets the two shapes of a contact, counted from 0, meet only each other.

    Filters have 32 bits. Contacts that share a bit are far enough apart not to meet.
    """
    return 1 << contact % 32


def nearest_float32(value: float, requested: float) -> float:
    """Undo the rounding of a number read back from an engine of single precision.

    Returns the requested number if `value` is the nearest to it in single precision, else `value`.
    """
    return requested if np.float32(requested) == np.float32(value) else value
