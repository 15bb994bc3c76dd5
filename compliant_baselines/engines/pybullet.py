"""PyBullet: spheres on a plane; docs/mapping.md, section 2, gives the reason for each setting.

**Bodies.** The engine combines the stiffness and damping of two bodies. In the case of two balls on a table, the upper
ball has the parameters of contact 1, the table has the parameters of contact 2, and the lower ball is rigid and
undamped. In any other line a ball consists of two parts at the same place: its base, and a massless link that is fixed
to the base. The base meets the ball below and has the parameters of this contact. The link meets the ball above and is
rigid and undamped. In a plane a ball has one part, the base or a link, for each of its contacts. The part of a
contact's first body has the parameters of the contact. Filters let only the two parts of a contact meet.

Balls without a link are bodies in maximal coordinates. Their steps take 60 % of the time of a multibody's steps. A
broadphase that tries every pair of bodies saves another seventh of the time.

**Steps.** A call from Python that takes a step and two calls that read velocities take longer than the step itself.
While nothing can happen (`engines.event_free_steps`), one call takes at most `STRIDE` steps, and the results are the
same to the bit. Heights after single steps are not read, but computed as the engine does: x += h v with the new v,
exact to the last bit or two.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.engines.arrangement import Arrangement, along_axes, in_space
from impact_xval.compliant_baselines.engines.engine import Engine, import_quietly
from impact_xval.compliant_baselines.engines.scene import (
    WIDER,
    Floats,
    Scene,
    World,
    count_sweeps,
    radius_of,
)
from impact_xval.compliant_baselines.mapping import (
    ContactSides,
    Side,
    combine_sides,
    pybullet_side,
    sides_of_contacts,
)

#: Largest number of steps that are taken in one call.
STRIDE = 256

#: Longest step in s that the engine ignores (SIMD_EPSILON).
SHORTEST_STEP = sys.float_info.epsilon

#: Largest impulse in N s that the engine gives to a contact in a step.
LARGEST_IMPULSE = 1e10

#: Length in m of the diagonal of the box around a body above which the engine removes the body.
LARGEST_BODY = 1e6

#: Engine parameters that are the same in all scenes.
EXACT = {
    "solverResidualThreshold": 0,
    "contactSlop": 0,
    "restitutionVelocityThreshold": 0,
    "useSplitImpulse": 0,
}

#: Largest radius in m of balls in a plane. Larger radii are reduced to it if it is at least `NARROWEST` times the depth
#: of contacts.
LARGEST_PLANE_RADIUS, NARROWEST = 2.0**18, 2.0**12

#: The engine's `contactBreakingThreshold` as a fraction of the radius.
BREAKING_OVER_RADIUS = 2e-7

#: Arguments of `changeDynamics` that switch off friction, restitution, damping of free motion, and the limit on the
#: speed of a multibody.
ZERO = (
    "restitution",
    "lateralFriction",
    "spinningFriction",
    "rollingFriction",
    "linearDamping",
    "angularDamping",
    "contactProcessingThreshold",
)
FREE = {**dict.fromkeys(ZERO, 0.0), "maxJointVelocity": 1e30}

#: The arguments among `ZERO` that belong to a surface. The engine sets them on a link only if they are given without
#: any other argument.
SURFACE = dict.fromkeys(ZERO[:4], 0.0)

#: The indices by which the engine calls the parts of a ball: the base, and its first link.
BASE, LINK = -1, 0


class BodyPart(NamedTuple):
    """A part of a body, given by the indices that the engine's functions take."""

    body: int
    #: `BASE`, or the number of a link: `LINK` or more.
    link: int


class ContactParts(NamedTuple):
    """The parts of two bodies that meet in a contact."""

    first: BodyPart
    second: BodyPart


class SceneBodies(NamedTuple):
    """The bodies of a scene, given by the engine's indices."""

    #: The engine's number of each ball.
    balls: list[int]
    #: The parts of each contact.
    contacts: list[ContactParts]


#: Arguments of `createMultiBody` that add a massless link which is fixed to the base.
FIXED: dict[str, list[object]] = {
    "linkMasses": [0],
    "linkVisualShapeIndices": [-1],
    "linkParentIndices": [0],
    "linkJointAxis": [(0, 0, 1)],
    "linkPositions": [(0, 0, 0)],
    "linkInertialFramePositions": [(0, 0, 0)],
    "linkOrientations": [(0, 0, 0, 1)],
    "linkInertialFrameOrientations": [(0, 0, 0, 1)],
}


class Client:
    """A connection to PyBullet: the functions of its module, called with the number of this connection."""

    def __init__(self, number: int) -> None:
        self.module, self.number = import_quietly("pybullet"), number

    def __getattr__(self, name: str) -> Any:
        value = getattr(self.module, name)
        return partial(value, physicsClientId=self.number) if callable(value) else value


@contextmanager
def connected() -> Generator[Client]:
    """Open a connection to PyBullet, and close it at the end of the context.

    A connection that stayed open would have the number 0, which other users of PyBullet take when they name no
    connection.
    """
    p = import_quietly("pybullet")
    client = Client(p.connect(p.DIRECT))
    if client.number < 0:
        raise RuntimeError("PyBullet gave no client: more than 1024 are connected in this process")
    try:
        yield client
    finally:
        client.disconnect()


class Pybullet(Engine):
    """PyBullet from a wheel (CPython up to 3.11) or built from source; each call opens its own connection."""

    name = distribution = module = "pybullet"
    title, knows_planes = "PyBullet", True
    way_out = (
        "run pip install 'pybullet>=3.2.7' (it has no wheels beyond CPython 3.11: run with Python 3.11, or build it "
        "from source)"
    )

    def refusal(self, scene: Scene) -> str | None:
        """Return a sentence that says why PyBullet cannot take a scene, or None.

        PyBullet refuses parameters that one of its absolute limits would change, and the naive mapping for anything but
        two balls on a table.
        """
        if scene.mapping == "naive" and _has_links(scene):
            return "mapping = 'naive': PyBullet's is that of two balls on a table; legal: 'calibrated'"
        if scene.step <= SHORTEST_STEP:
            return f"step = {scene.step:.3g} s: PyBullet ignores steps of {SHORTEST_STEP:.1e} s or less"
        largest = scene.fastest * sum(scene.masses)
        if largest > LARGEST_IMPULSE:
            return f"m |v0| = {largest:.3g} N s: PyBullet caps a contact at {LARGEST_IMPULSE:.0e} N s a step"
        radius = self.radius(scene)
        if 2 * math.sqrt(3) * radius <= LARGEST_BODY:
            return None
        return (
            f"penetrations ask for balls of radius {radius:.3g} m: "
            f"PyBullet drops bodies larger than {LARGEST_BODY:.0e} m; scale stiffnesses, masses or v0 (Theorem 5)"
        )

    def radius(self, scene: Scene) -> float:
        """Return the radius in m of the balls."""
        return _radius(scene, combine_sides(_sides(scene)))

    def world(self, scene: Scene) -> PybulletWorld:
        """Set up a scene in the open connection."""
        return PybulletWorld(self._client, scene, self._bodies)

    @contextmanager
    def running(self) -> Generator[None]:
        """Open a connection in which scenes are set up and run."""
        with connected() as self._client:
            self._bodies: Bodies = {}
            yield


#: The bodies that exist in a connection, by their arrangement and radius in m; at most one entry.
Bodies = dict[tuple[Arrangement, float], SceneBodies]


class PybulletWorld(World):
    """A scene in PyBullet: planes and spheres in a connection.

    If the connection already has bodies of the same arrangement and radius, these are used again. Otherwise everything
    in it is removed first.
    """

    longest_leap = STRIDE

    def __init__(self, p: Client, scene: Scene, bodies: Bodies) -> None:
        self._p, self._step, self._stride, self._falls = p, scene.step, 0, scene.gravity > 0
        sides = _sides(scene)
        contacts = combine_sides(sides)
        radius = _radius(scene, contacts)
        super().__init__(scene, radius, scene.masses[-1] * scene.gravity / contacts[-1].stiffness)
        self._x, self._axes = self.heights, scene.axes
        if scene.graph is not None:
            self.longest_leap = 0
        key = scene.arrangement, radius
        if key not in bodies:
            bodies.clear()
            bodies[key] = self._make_bodies(scene, radius)
        self.balls, parts = bodies[key]
        h = scene.step
        softening = [1 / (h * (h * contact.stiffness + contact.dissipation)) for contact in contacts]
        # In two additional sweeps the impulses of active contacts settle at their limit of zero.
        iterations = 2 + min(1000, max(2, count_sweeps(scene, softening)))
        p.setPhysicsEngineParameter(fixedTimeStep=h, numSubSteps=0, numSolverIterations=iterations)
        for ball, mass in zip(self.balls, scene.masses, strict=True):
            p.changeDynamics(ball, BASE, mass=mass)
        # Contacts are set in their order. Two of the parts may be the same part, which the later contact then
        # overwrites.
        for contact_parts, contact_sides in zip(parts, sides, strict=True):
            for part, side in zip(contact_parts, contact_sides, strict=True):
                p.changeDynamics(*part, contactStiffness=side.stiffness, contactDamping=side.dissipation)
        # In this step the bodies are apart. The engine then forgets its contact points and the impulses of earlier
        # steps.
        p.setGravity(0, 0, 0)
        self._place(10 * self.places, np.zeros(self.places.size))
        p.stepSimulation()
        p.setGravity(0, 0, -scene.gravity)
        self._place(self.places + self._x, np.array(scene.velocities))
        if _has_links(scene):  # parameters of bodies in maximal coordinates cannot be read back
            contacts = combine_sides([ContactSides(*map(self._read_side, both)) for both in parts])
        self.effective = {
            "stiffness": tuple(contact.stiffness for contact in contacts),
            "damping": tuple(contact.dissipation for contact in contacts),
            "step": (p.getPhysicsEngineParameters()["fixedTimeStep"],),
        }

    def _read_side(self, part: BodyPart) -> Side:
        """Return the stiffness and the damping of a part, read back from the engine."""
        damping, stiffness = self._p.getDynamicsInfo(*part)[8:10]
        return Side(stiffness, damping)

    def _make_bodies(self, scene: Scene, radius: float) -> SceneBodies:
        """Remove all bodies, then make the planes, and then the balls from the last one to the first."""
        p, linked, arrangement = self._p, _has_links(scene), scene.arrangement
        p.resetSimulation(0 if linked else p.RESET_USE_SIMPLE_BROADPHASE)
        threshold = BREAKING_OVER_RADIUS * (radius if scene.graph is None else radius / WIDER)
        p.setPhysicsEngineParameter(contactBreakingThreshold=threshold, **EXACT)
        coordinates = {"useMaximalCoordinates": int(not linked)}
        planes = self._make_planes(scene, radius, coordinates)
        sphere = p.createCollisionShape(p.GEOM_SPHERE, radius)
        first: dict[int, BodyPart] = {}
        second = {contact: BodyPart(plane, BASE) for contact, plane in planes.items()}
        all_parts = {BodyPart(plane, BASE) for plane in planes.values()}
        balls: list[int] = []
        places = in_space(10 * self.places, scene.axes).tolist()
        for number in reversed(range(len(places))):
            as_first, as_second = arrangement.sides(number)
            # The base has the parameters of the first contact in which the ball is the first body; links have the other
            # contacts.
            base, links = as_first[:1], [*as_first[1:], *as_second]
            made: dict[str, object] = {**coordinates}
            if linked:
                made = {name: values * max(1, len(links)) for name, values in FIXED.items()}
                made["linkCollisionShapeIndices"] = [sphere] * max(1, len(links))
                made["linkJointTypes"] = [p.JOINT_FIXED] * max(1, len(links))
            ball = p.createMultiBody(1, sphere, basePosition=tuple(places[number]), **made)
            balls.insert(0, ball)
            first |= {contact: BodyPart(ball, BASE) for contact in base}
            for link, contact in enumerate(links):
                side = second if contact in as_second else first
                side[contact] = BodyPart(ball, link if linked else BASE)
            all_parts |= {BodyPart(ball, link) for link in range(BASE, max(1, len(links)) if linked else 0)}
        for part in all_parts:
            p.changeDynamics(*part, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING, **FREE)
            p.changeDynamics(*part, **SURFACE)
            if linked:
                p.setCollisionFilterGroupMask(*part, 0, 0)
        parts = [ContactParts(first[i], second[i]) for i in range(len(arrangement.touches))]
        if linked:
            for lower, upper in parts:
                p.setCollisionFilterPair(lower.body, upper.body, lower.link, upper.link, 1)
        return SceneBodies(balls, parts)

    def _make_planes(self, scene: Scene, radius: float, coordinates: Mapping[str, object]) -> dict[int, int]:
        """Make a plane for each contact with a fixed body, and return the engine's index of the plane by contact.

        If no contact has a fixed body, a plane is made that nothing touches.
        """
        p, arrangement = self._p, scene.arrangement
        planes: dict[int, int] = {}
        for contact, touch in enumerate(arrangement.touches):
            if touch.second is None:
                (normal,) = in_space(np.array(touch.normal), scene.axes).tolist()
                (point,) = in_space(radius * arrangement.surface(contact), scene.axes).tolist()
                shape = p.createCollisionShape(p.GEOM_PLANE, planeNormal=tuple(normal))
                planes[contact] = p.createMultiBody(0, shape, basePosition=tuple(point), **coordinates)
        if not planes:
            p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE), **coordinates)
        return planes

    def _place(self, places: Floats, velocities: Floats) -> None:
        points = in_space(places, self._axes).tolist(), in_space(velocities, self._axes).tolist()
        for ball, point, velocity in zip(self.balls, *points, strict=True):
            self._p.resetBasePositionAndOrientation(ball, tuple(point), (0, 0, 0, 1))
            self._p.resetBaseVelocity(ball, tuple(velocity), (0, 0, 0))

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps, and read the velocities after each of them.

        While gravity acts, the last step is the first one after which all gaps are open.
        """
        self._set_stride(0)
        # without keyword arguments a call takes a tenth less time
        p, client, h = self._p.module, self._p.number, self._step
        step, read = p.stepSimulation, p.getBaseVelocity
        balls = self.balls
        upper, lower = self._x[:2].tolist()  # heights in m of the two balls of a drop
        velocities: list[list[tuple[float, float, float]]] = []
        for _ in range(n):
            step(client)
            v = [read(ball, client)[0] for ball in balls]
            velocities.append(v)
            if self._falls:
                upper, lower = upper + h * v[0][2], lower + h * v[1][2]
                if upper >= lower >= 0:
                    break
        taken = along_axes(np.array(velocities), self._axes)
        heights = np.cumsum(np.vstack([self._x, h * taken]), axis=0)[1:]
        self._x = heights[-1]
        return taken, heights

    def leap(self, n: int) -> tuple[int, Floats, Floats]:
        """Take at most n steps in one call. Return their number, and the velocities in m/s and heights in m after them.

        The engine divides the time n h of a call by n, and counts how often the quotient fits into this time
        (btDiscreteDynamicsWorld.cpp, stepSimulation). For some n rounding changes the step h or the count. Then a
        smaller n is taken; powers of two are always possible.
        """
        p, client, h = self._p.module, self._p.number, self._step
        while n * h / n != h or int(n * h / h) != n:
            n -= 1
        self._set_stride(n)
        p.stepSimulation(client)
        v = np.array([p.getBaseVelocity(ball, client)[0][2] for ball in self.balls])
        z = np.array([p.getBasePositionAndOrientation(ball, client)[0][2] for ball in self.balls])
        self._x = z - self.places
        return n, v, self._x

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Switch off gravity.

        Velocities and heights need not be set: `advance` stops at the step after which the flight begins.
        """
        self._p.setGravity(0, 0, 0)
        self._falls = False

    def _set_stride(self, n: int) -> None:
        if n != self._stride:
            time = max(1, n) * self._step
            self._p.setPhysicsEngineParameter(fixedTimeStep=time, numSubSteps=n)
            self._stride = n


def _has_links(scene: Scene) -> bool:
    """Return True if balls need more than one part (see the module's docstring)."""
    return scene.graph is not None or not (scene.table and len(scene.masses) == 2)


def _radius(scene: Scene, contacts: Sequence[Side]) -> float:
    """Return the radius in m of the balls.

    In a plane it is limited to `LARGEST_PLANE_RADIUS`, unless this is too small for the depth of contacts.
    """
    depth = scene.depth([contact.stiffness for contact in contacts])
    radius = radius_of(depth, scene.axes)
    if scene.graph is not None and NARROWEST * depth <= LARGEST_PLANE_RADIUS:
        return min(radius, LARGEST_PLANE_RADIUS)
    return radius


def _sides(scene: Scene) -> list[ContactSides]:
    """Return the parameters of both bodies of every contact."""
    contacts = [pybullet_side(contact) for contact in scene.contacts]
    return sides_of_contacts(contacts, scene.mapping, one_side_per_body=not _has_links(scene))
