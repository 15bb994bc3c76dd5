"""PyBullet: spheres on a plane; docs/mapping.md, section 2, gives the reasons of its settings.

**Bodies.** The engine combines the stiffness and damping of two bodies. Two balls on a table get by with a lower ball
that is rigid and undamped: the upper ball carries contact 1, the table contact 2. In any other line a ball has two
sides. Its base meets the ball below and carries the contact. A massless link, fixed to the base at the same place,
meets the ball above and is rigid and undamped. Filters let only these pairs meet. Balls without a link are bodies in
maximal coordinates: their step costs 60 % of a multibody's, and a broadphase that tries every pair saves a seventh
more.

**Steps.** A call from Python and two reads cost more than a step. Where nothing can happen
(`engines.event_free_steps`), the engine takes up to `STRIDE` sub-steps in one call, and the result is the same to the
bit. Heights of single steps are not read: the engine's update is x += h v with the new v, to the last bit or two.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.engines.engine import Engine, import_quietly
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, count_sweeps, radius_of
from impact_xval.compliant_baselines.mapping import (
    BodySides,
    Side,
    combine_sides,
    pybullet_side,
    sides_of_bodies,
)

#: Most sub-steps of one call.
STRIDE = 256

#: Step in s up to which the engine does nothing (SIMD_EPSILON).
SHORTEST_STEP = sys.float_info.epsilon

#: Impulse in N s at which the engine caps a contact in a step.
LARGEST_IMPULSE = 1e10

#: Diagonal in m of the box around a body from which the engine drops the body.
LARGEST_BODY = 1e6

#: Parameters of all scenes.
EXACT = {
    "solverResidualThreshold": 0,
    "contactSlop": 0,
    "restitutionVelocityThreshold": 0,
    "useSplitImpulse": 0,
}

#: `contactBreakingThreshold` over the radius.
BREAKING_OVER_RADIUS = 2e-7

#: Arguments of `changeDynamics` that keep the engine from acting on a body by itself; and the cap of a multibody's
#: speed.
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

#: Parts of a ball, as the engine numbers them: the base meets the ball below, the link the ball above.
BASE, LINK = -1, 0


class BodyPart(NamedTuple):
    """A part of a body, as the engine's calls take it."""

    body: int
    #: `BASE` or `LINK`.
    link: int


class BodyParts(NamedTuple):
    """The two parts of a body; one and the same if it has no link."""

    #: Meets the body above.
    upper: BodyPart
    #: Meets the body below.
    lower: BodyPart


#: Arguments of `createMultiBody` that make a fixed, massless link.
FIXED: dict[str, object] = {
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
    """The module pybullet, its functions bound to one client."""

    def __init__(self, number: int) -> None:
        self.module, self.number = import_quietly("pybullet"), number

    def __getattr__(self, name: str) -> Any:
        value = getattr(self.module, name)
        return partial(value, physicsClientId=self.number) if callable(value) else value


@contextmanager
def connected() -> Generator[Client]:
    """Connect a client for a while.

    A client that was kept would be client 0, which all other users of PyBullet share who name no client.
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
    """PyBullet, where it has wheels (CPython up to 3.11) or was built; a client is connected for a call."""

    name = distribution = module = "pybullet"
    title = "PyBullet"
    way_out = (
        "run pip install 'pybullet>=3.2.7' (it has no wheels beyond CPython 3.11: run with Python 3.11, or build it "
        "from source)"
    )

    def refusal(self, scene: Scene) -> str | None:
        """Say why PyBullet cannot take a scene: one of its absolute numbers would replace what was asked for."""
        if scene.mapping == "naive" and _has_links(scene):
            return "mapping = 'naive': PyBullet's is that of two balls on a table; legal: 'calibrated'"
        if scene.step <= SHORTEST_STEP:
            return (
                f"step = {scene.step:.3g} s: PyBullet takes a step of {SHORTEST_STEP:.1e} s or less for none"
            )
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
        return radius_of(scene.depth([contact.stiffness for contact in combine_sides(_sides(scene))]))

    def world(self, scene: Scene) -> PybulletWorld:
        """Set a scene up."""
        return PybulletWorld(self._client, scene, self._bodies)

    @contextmanager
    def running(self) -> Generator[None]:
        """Connect a client."""
        with connected() as self._client:
            self._bodies: Bodies = {}
            yield


#: The bodies that a client holds, the table last, by number of balls, table and radius; at most one entry.
Bodies = dict[tuple[int, bool, float], list[BodyParts]]


class PybulletWorld(World):
    """A plane and spheres in a client, which is emptied first unless it holds as many of the same radius."""

    longest_leap = STRIDE

    def __init__(self, p: Client, scene: Scene, bodies: Bodies) -> None:
        self._p, self._step, self._stride, self._falls = p, scene.step, 0, scene.gravity > 0
        sides = _sides(scene)
        contacts = combine_sides(sides)
        radius = radius_of(scene.depth([contact.stiffness for contact in contacts]))
        super().__init__(scene, radius, scene.masses[-1] * scene.gravity / contacts[-1].stiffness)
        self._x = self.heights
        key = len(scene.masses), scene.table, radius
        if key not in bodies:
            bodies.clear()
            bodies[key] = self._make_bodies(scene, radius)
        parts = bodies[key]
        self.balls = [ball.lower.body for ball in parts[: len(scene.masses)]]
        h = scene.step
        softening = [1 / (h * (h * contact.stiffness + contact.dissipation)) for contact in contacts]
        # Two more sweeps, for the cap at zero force to settle which contacts are active.
        iterations = 2 + min(1000, max(2, count_sweeps(scene, softening)))
        p.setPhysicsEngineParameter(fixedTimeStep=h, numSubSteps=0, numSolverIterations=iterations)
        for ball, mass in zip(self.balls, scene.masses, strict=True):
            p.changeDynamics(ball, BASE, mass=mass)
        for body_parts, body_sides in zip(parts, sides, strict=True):
            for part, side in zip(body_parts, body_sides, strict=True):
                p.changeDynamics(*part, contactStiffness=side.stiffness, contactDamping=side.dissipation)
        # Apart for a step, in which the engine forgets its contact points and the impulses it would start from.
        p.setGravity(0, 0, 0)
        self._place(10 * self.places, [0.0] * len(self.balls))
        p.stepSimulation()
        p.setGravity(0, 0, -scene.gravity)
        self._place(self.places + self._x, scene.velocities)
        if _has_links(scene):  # bodies in maximal coordinates cannot be read back
            contacts = combine_sides([BodySides(*map(self._read_side, both)) for both in parts])
        self.effective = {
            "stiffness": tuple(contact.stiffness for contact in contacts),
            "damping": tuple(contact.dissipation for contact in contacts),
            "step": (p.getPhysicsEngineParameters()["fixedTimeStep"],),
        }

    def _read_side(self, part: BodyPart) -> Side:
        """Read back stiffness and damping of a part."""
        damping, stiffness = self._p.getDynamicsInfo(*part)[8:10]
        return Side(stiffness, damping)

    def _make_bodies(self, scene: Scene, radius: float) -> list[BodyParts]:
        """Empty the client and make the balls, from the upper one down, and the table."""
        p, linked = self._p, _has_links(scene)
        p.resetSimulation(0 if linked else p.RESET_USE_SIMPLE_BROADPHASE)
        p.setPhysicsEngineParameter(contactBreakingThreshold=BREAKING_OVER_RADIUS * radius, **EXACT)
        plane = p.createCollisionShape(p.GEOM_PLANE)
        sphere = p.createCollisionShape(p.GEOM_SPHERE, radius)
        coordinates = {"useMaximalCoordinates": int(not linked)}
        table = p.createMultiBody(0, plane, **coordinates)
        link: Mapping[str, object] = coordinates
        if linked:
            link = {**FIXED, "linkCollisionShapeIndices": [sphere], "linkJointTypes": [p.JOINT_FIXED]}
        parts = [BodyParts(BodyPart(table, BASE), BodyPart(table, BASE))] if scene.table else []
        for z in 10 * self.places[::-1]:
            ball = p.createMultiBody(1, sphere, basePosition=(0, 0, z), **link)
            parts.insert(0, BodyParts(BodyPart(ball, LINK if linked else BASE), BodyPart(ball, BASE)))
        for part in {part for both in parts for part in both}:
            p.changeDynamics(*part, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING, **FREE)
            if linked:
                p.setCollisionFilterGroupMask(*part, 0, 0)
        if linked:
            for above, below in pairwise(parts):
                lower, upper = above.lower, below.upper
                p.setCollisionFilterPair(lower.body, upper.body, lower.link, upper.link, 1)
        return parts

    def _place(self, heights: Floats, velocities: Sequence[float]) -> None:
        for ball, z, v in zip(self.balls, heights.tolist(), velocities, strict=True):
            self._p.resetBasePositionAndOrientation(ball, (0, 0, z), (0, 0, 0, 1))
            self._p.resetBaseVelocity(ball, (0, 0, v), (0, 0, 0))

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps, or, while bodies fall, fewer: up to the first after which all gaps are open."""
        self._set_stride(0)
        p, client, h = self._p.module, self._p.number, self._step  # a keyword would cost a tenth
        step, read = p.stepSimulation, p.getBaseVelocity
        balls, (upper, lower) = self.balls, self._x[:2].tolist()
        velocities: list[list[float]] = []
        for _ in range(n):
            step(client)
            v = [read(ball, client)[0][2] for ball in balls]
            velocities.append(v)
            if self._falls:
                upper, lower = upper + h * v[0], lower + h * v[1]
                if upper >= lower >= 0:
                    break
        taken = np.array(velocities)
        heights = np.cumsum(np.vstack([self._x, h * taken]), axis=0)[1:]
        self._x = heights[-1]
        return taken, heights

    def leap(self, n: int) -> tuple[int, Floats, Floats]:
        """Take up to n steps in one call: the largest number that the engine divides into as many steps of length h.

        The engine divides the time n h of a call by n, and counts how often the quotient goes into it
        (btDiscreteDynamicsWorld.cpp, stepSimulation). For some n rounding spoils that; powers of two are safe.
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
        """Switch gravity off.

        The state needs no change: a flight begins after the last step taken (`advance`).
        """
        self._p.setGravity(0, 0, 0)
        self._falls = False

    def _set_stride(self, n: int) -> None:
        if n != self._stride:
            time = max(1, n) * self._step
            self._p.setPhysicsEngineParameter(fixedTimeStep=time, numSubSteps=n)
            self._stride = n


def _has_links(scene: Scene) -> bool:
    """Tell whether balls need two sides; see the module."""
    return not (scene.table and len(scene.masses) == 2)


def _sides(scene: Scene) -> list[BodySides]:
    """Return stiffness and damping of both sides of every body."""
    contacts = [pybullet_side(contact) for contact in scene.contacts]
    return sides_of_bodies(contacts, scene.mapping, one_side_per_body=not _has_links(scene))
