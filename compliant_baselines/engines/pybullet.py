"""PyBullet: spheres on a plane; docs/mapping.md, section 2, gives the reasons of its settings.

The engine combines the stiffness and damping of two bodies. Two balls on a table get by with a lower ball that is rigid
and undamped: the upper ball carries contact 1, the table contact 2. In a longer line a ball has two sides: its base,
which meets the ball below and carries the contact, and a massless link fixed to it, at the same place, which meets the
ball above and is rigid and undamped; filters let only these pairs meet. Balls without a link are bodies in maximal
coordinates, whose step costs 60 % of a multibody's; a broadphase that tries every pair saves them a seventh more.

A call from Python and two reads cost more than a step. Where nothing can happen (`engines.quiet`) the engine takes up
to `STRIDE` sub-steps in one call, with a bit for bit identical result. Heights of single steps are not read: the
engine's update is x += h v with the new v, to the last bit or two.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.engines.engine import Engine, import_quietly
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, radius_of, sweeps
from impact_xval.compliant_baselines.mapping import Side, Sides, combined, pybullet_side, sides

#: Most sub-steps of one call.
STRIDE = 256

#: Absolute numbers of the engine: a step that it takes for none (SIMD_EPSILON, s), the impulse at which it caps a
#: contact in a step (N s), the diagonal of the box around a body at which it drops the body (m).
SHORTEST_STEP, LARGEST_IMPULSE, LARGEST_BODY = sys.float_info.epsilon, 1e10, 1e6

#: Parameters of all scenes; `contactBreakingThreshold` goes with the radius.
EXACT = {
    "solverResidualThreshold": 0,
    "contactSlop": 0,
    "restitutionVelocityThreshold": 0,
    "useSplitImpulse": 0,
}
BREAKING_OVER_RADIUS = 2e-7

#: What a body must not do on the engine's own account, as `changeDynamics` has it, and the cap of a multibody's speed.
ZERO = ("restitution", "lateralFriction", "spinningFriction", "rollingFriction")
ZERO += ("linearDamping", "angularDamping", "contactProcessingThreshold")
FREE = {**dict.fromkeys(ZERO, 0.0), "maxJointVelocity": 1e30}

#: Of a body, what meets the body above and what meets the body below, as body and part.
Parts = tuple[tuple[int, int], tuple[int, int]]

#: Part of a ball: the base meets the ball below, the link the ball above. A link is fixed and massless.
BASE, LINK = -1, 0
FIXED = {
    "linkMasses": [0],
    "linkVisualShapeIndices": [-1],
    "linkParentIndices": [0],
    "linkJointAxis": [(0, 0, 1)],
}
FIXED |= {key: [(0, 0, 0)] for key in ("linkPositions", "linkInertialFramePositions")}
FIXED |= {key: [(0, 0, 0, 1)] for key in ("linkOrientations", "linkInertialFrameOrientations")}


class Client:
    """The module pybullet, whose functions are those of one client by its number."""

    def __init__(self, number: int) -> None:
        self.module, self.number = import_quietly("pybullet"), number

    def __getattr__(self, name: str) -> Any:
        value = getattr(self.module, name)
        return partial(value, physicsClientId=self.number) if callable(value) else value


@contextmanager
def connected() -> Iterator[Client]:
    """Connect a client; one that was kept would be client 0 to whoever else uses PyBullet and names none."""
    p: Any = import_quietly("pybullet")
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
        """Why PyBullet cannot take a scene: one of its absolute numbers would replace what was asked."""
        if scene.mapping == "naive" and _linked(scene):
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
        """As `Engine.radius`."""
        return radius_of(scene.depth([pair.stiffness for pair in combined(_sides(scene))]))

    def world(self, scene: Scene) -> PybulletWorld:
        """Set a scene up."""
        return PybulletWorld(self._client, scene, self._made)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Connect a client."""
        with connected() as self._client:
            self._made = {}
            yield


class PybulletWorld(World):
    """Plane and spheres in a client, which is emptied first."""

    longest_leap = STRIDE

    def __init__(self, p: Client, scene: Scene, made: dict[Any, list[Parts]]) -> None:
        self._p, self._step, self._stride, self._falls = p, scene.step, 0, scene.gravity > 0
        bodies = _sides(scene)
        pairs = combined(bodies)
        radius = radius_of(scene.depth([pair.stiffness for pair in pairs]))
        super().__init__(scene, radius, scene.masses[-1] * scene.gravity / pairs[-1].stiffness)
        self._x = self.heights
        kind = len(scene.masses), scene.table, radius
        if kind not in made:
            made.clear()
            made[kind] = self._make(scene, radius)
        parts = made[kind]
        self.balls = [ball for (ball, _), _ in parts[: len(scene.masses)]]
        h = scene.step
        soft = [1 / (h * (h * pair.stiffness + pair.dissipation)) for pair in pairs]
        # Two more, for the cap at zero force to settle which contacts act.
        most = 2 + min(1000, max(2, sweeps(scene, soft)))
        p.setPhysicsEngineParameter(fixedTimeStep=h, numSubSteps=0, numSolverIterations=most)
        for ball, mass in zip(self.balls, scene.masses, strict=True):
            p.changeDynamics(ball, BASE, mass=mass)
        for both, own in zip(parts, bodies, strict=True):
            for part, side in zip(both, own, strict=True):
                p.changeDynamics(*part, contactStiffness=side.stiffness, contactDamping=side.dissipation)
        # Apart for a step, in which the engine forgets contact points and what it warm-starts from.
        p.setGravity(0, 0, 0)
        self._place(10 * self.places, [0.0] * len(self.balls))
        p.stepSimulation()
        p.setGravity(0, 0, -scene.gravity)
        self._place(self.places + self._x, scene.velocities)
        if _linked(scene):  # of bodies in maximal coordinates it says nothing
            pairs = combined([[Side(*p.getDynamicsInfo(*part)[9:7:-1]) for part in both] for both in parts])
        self.effective = {
            "stiffness": tuple(pair.stiffness for pair in pairs),
            "damping": tuple(pair.dissipation for pair in pairs),
            "step": (p.getPhysicsEngineParameters()["fixedTimeStep"],),
        }

    def _make(self, scene: Scene, radius: float) -> list[Parts]:
        """Empty the client and make table and balls; their parts, those of the upper ball first."""
        p, linked = self._p, _linked(scene)
        p.resetSimulation(0 if linked else p.RESET_USE_SIMPLE_BROADPHASE)
        p.setPhysicsEngineParameter(contactBreakingThreshold=BREAKING_OVER_RADIUS * radius, **EXACT)
        plane = p.createCollisionShape(p.GEOM_PLANE)
        sphere = p.createCollisionShape(p.GEOM_SPHERE, radius)
        how: dict[str, Any] = {"useMaximalCoordinates": int(not linked)}
        table = p.createMultiBody(0, plane, **how)
        if linked:
            how = {**FIXED, "linkCollisionShapeIndices": [sphere], "linkJointTypes": [p.JOINT_FIXED]}
        parts = [((table, BASE), (table, BASE))] if scene.table else []
        for z in 10 * self.places[::-1]:
            ball = p.createMultiBody(1, sphere, basePosition=(0, 0, z), **how)
            parts.insert(0, ((ball, LINK if linked else BASE), (ball, BASE)))
        for body, part in {part for both in parts for part in both}:
            p.changeDynamics(body, part, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING, **FREE)
            if linked:
                p.setCollisionFilterGroupMask(body, part, 0, 0)
        if linked:
            for (_, (upper, below)), ((lower, above), _) in pairwise(parts):
                p.setCollisionFilterPair(upper, lower, below, above, 1)
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
        balls, velocities, upper, lower = self.balls, [], *self._x[:2].tolist()
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
        """Take up to n steps in one call: as many as the engine makes of their time as they are meant.

        It divides the time n h of a call by n, and counts how often what comes out goes into it
        (btDiscreteDynamicsWorld.cpp, stepSimulation); rounding spoils that for some n. Powers of two are safe.
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
        """Switch gravity off: a flight begins with a step after which all gaps are open, the last one taken."""
        self._p.setGravity(0, 0, 0)
        self._falls = False

    def _set_stride(self, n: int) -> None:
        if n != self._stride:
            time = max(1, n) * self._step
            self._p.setPhysicsEngineParameter(fixedTimeStep=time, numSubSteps=n)
            self._stride = n


def _linked(scene: Scene) -> bool:
    """Whether balls need two sides; see the module."""
    return not (scene.table and len(scene.masses) == 2)


def _sides(scene: Scene) -> list[Sides]:
    """Stiffness and damping of both sides of every body."""
    return sides(list(map(pybullet_side, scene.contacts)), scene.mapping, whole=not _linked(scene))
