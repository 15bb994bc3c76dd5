"""Base classes for adapters of rigid engines: spheres in a line or a plane, with steps that are read one by one.

**Overlap.** At the start the bodies of touching contacts overlap by `OVERLAP` of a radius. Without this overlap most
engines find the contact in a later step, or not at all. A single impact would then become several. Each adapter
switches off the correction of positions. So the overlap stays.

**Restitution.** Most engines compute the restitution of a contact from one number for each body. A ball therefore has a
sphere of half its radius for each of its contacts, inside the ball and next to the body that it touches. In a line one
of the two spheres is above the other. The sphere of the first body of a contact, which in a line is the upper ball, has
the e of the contact. Where an engine multiplies the numbers of both bodies, the sphere of the second body, or the
plane, has `Settings.partner_restitution`, by default 1. Each contact with a fixed body has its own plane. Two shapes of
different contacts cannot meet.

**In a plane** normals turn by the displacement over the radius. In double precision radii in a plane are larger by the
factor `PLANE_WIDER` than in a line. So normals hardly turn. Single precision cannot resolve how far balls of this size
move in a step. So in engines of single precision radii are not larger. There normals turn by about a thousandth in a
step of a thousandth of a period, if an engine takes several steps for a single impact. In the limit dt -> 0 this
vanishes, and a bound on it is part of the limit's error.

**Rest.** Relative velocities of at most `RigidWorld.resolution` times the largest speed at the start are reported as 0.
Otherwise a collision would not be over until a gap has closed at 1e-17 m/s.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import NamedTuple

import numpy as np

from impact_xval.compliant_baselines.engines.arrangement import in_space
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, count_sweeps, radius_of

#: Overlap over the radius of touching bodies at the start: 60 units in the last place of a single-precision height of
#: four radii, and a fiftieth of the distance moved in a step of a thousandth of a period. It is a power of two, so that
#: it is exact in double precision.
OVERLAP = 2.0**-16

#: Radius in m of the balls in an engine with its default settings, whose thresholds are lengths.
SHIPPED_RADIUS = 2.0**-4

#: Largest relative velocity, over the largest speed at the start, that is taken for rounding: 64 units in the last
#: place, in double and in single precision.
DOUBLE, SINGLE = 2.0**-46, 2.0**-17

#: Factor by which the radii of balls are larger in a scene in a plane than in a line, in double precision. Overlaps are
#: as long as in a line.
PLANE_WIDER = 2.0**20

#: Limit on masses, velocities and steps: they must be below this number and above its inverse. Single precision can
#: represent both.
LARGEST = 1e30


class Sphere(NamedTuple):
    """One of the small spheres of which a ball consists."""

    #: Number of the sphere's contact, from 0.
    contact: int
    #: Position (x, y, z) in m of the sphere's centre relative to the centre of the ball.
    offset: tuple[float, float, float]
    #: True if the ball is the first body of the contact; the sphere then has the contact's e.
    is_first: bool


class Wall(NamedTuple):
    """A fixed plane that one ball touches."""

    #: Number of the plane's contact, from 0.
    contact: int
    #: The point (x, y, z) in m at which the ball touches the plane, and the normal (x, y, z) of the plane.
    point: Floats
    normal: Floats

    @property
    def angle(self) -> float:
        """Angle in rad about y that turns the z axis into the normal."""
        return math.atan2(float(self.normal[0]), float(self.normal[2]))


class RigidWorld(World):
    """A scene in a rigid engine: spheres in a line, or spheres and fixed planes in a plane.

    In a line the table's surface is at height 0.
    """

    #: Relative velocity that is reported as 0, over the largest speed at the start.
    resolution = DOUBLE
    accuracy = DOUBLE

    def __init__(self, scene: Scene, radius: float) -> None:
        # Scripts for version 0.4 set this attribute. Without this error they would silently get other results.
        if hasattr(RigidWorld, "partner"):
            raise TypeError("RigidWorld.partner is Settings(partner_restitution=...) now")
        super().__init__(scene, radius)
        self._table, self._tiny = scene.table, self.resolution * scene.fastest
        self._is_line, self.axes = scene.graph is None, scene.axes
        self.resting_rate = self._tiny
        overlap = OVERLAP * self.radius
        if scene.graph is not None:  # the overlap is at most as long as in a line
            overlap = OVERLAP * min(self.radius, radius_of(scene.depth(scene.stiffnesses)))
        self.heights = self.heights + overlap * scene.closing
        self._arrangement = scene.arrangement
        #: Number of sweeps over the contacts after which sequential impulses change only by rounding.
        self.sweeps = 4 + min(996, count_sweeps(scene))

    @property
    def centres(self) -> list[tuple[float, float, float]]:
        """Centres of the balls at t = 0 as points (x, y, z) in m."""
        return [tuple(centre) for centre in in_space(self.places + self.heights, self.axes).tolist()]

    def spheres(self, ball: int) -> list[Sphere]:
        """Return the spheres of a ball. Spheres for contacts in which the ball is the first body come first."""
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
        """The fixed planes that balls touch."""
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
        """Take a step, and return the velocities in m/s and the coordinates of the centres in m after it."""

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps, and return the velocities in m/s and heights in m after each of them."""
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
        """Do nothing, because rigid engines refuse drops and so never run with gravity."""


class RigidEngine(Engine):
    """Base class of rigid engines: contacts have restitutions. Stiffnesses only determine the length of a step."""

    kind, law = "rigid", None
    #: Factor by which the radii of balls are larger in a scene in a plane than in a line. It is `PLANE_WIDER` for
    #: engines in double precision, and 1 for engines in single precision.
    plane_wider: float = 1.0

    def radius(self, scene: Scene) -> float:
        """Return the radius in m of the balls."""
        if scene.mapping == "shipped":
            return SHIPPED_RADIUS
        radius = radius_of(scene.depth(scene.stiffnesses))
        return radius if scene.graph is None else radius * self.plane_wider

    def refusal(self, scene: Scene) -> str | None:
        """Return a sentence that says why the engine cannot take a scene, or None.

        Rigid engines refuse drops, and parameters beyond single precision.
        """
        if scene.gravity:
            return f"gravity = {scene.gravity:g} m/s^2: rigid engines are run without gravity; legal: 0"
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
    """Return the bit with which filters let the two shapes of a contact meet only each other.

    Contacts are numbered from 0. Filters have 32 bits. Contacts that share a bit are far enough apart not to meet.
    """
    return 1 << contact % 32


def nearest_float32(value: float, requested: float) -> float:
    """Return the number asked for if `value` is its nearest number in single precision; else return `value`.

    This removes the rounding from a number that was read back from an engine of single precision.
    """
    return requested if np.float32(requested) == np.float32(value) else value
