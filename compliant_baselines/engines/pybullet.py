"""PyBullet: spheres on a plane, one scene at a time.

PyBullet sets stiffness and damping per body, and the engine combines two bodies: stiffness in series, damping added.
Two balls on a table get by with a lower ball that is rigid and undamped: the upper ball carries contact 1, the table
contact 2. In a longer line a ball has two sides. So each ball is a multibody without joints: its base, which meets the
ball below and carries the contact, and a massless link fixed to it, at the same place, which meets the ball above and
is rigid and undamped; filters let only these pairs meet. A fixed link has no degree of freedom: nothing is added to the
motion. Balls without a link are bodies in maximal coordinates (btRigidBody), whose step costs 60 % of a multibody's.

Set-up, and why (file names are those of Bullet's source, as PyBullet 3.2.7 ships it):

* `useSplitImpulse=0`: with it, the default, a contact deeper than 0.04 m gets no force at all from its
  stiffness (btSequentialImpulseConstraintSolver.cpp), which breaks every soft contact and every scaling.
* `contactSlop=0`, `restitutionVelocityThreshold=0`, `solverResidualThreshold=0`: the defaults are absolute
  numbers. So is the cap of a multibody's velocity, 100 m/s.
* `contactBreakingThreshold` is `BREAKING_OVER_RADIUS` of the radius, a millionth of the depth to be expected.
  The engine keeps a contact point until its gap exceeds this (default 0.02 m), and stops an approaching pair over
  such a gap ahead of touch; tied to the collision's own scale the contact of this adapter starts at touch, at any
  scale. Not 0: a point is also dropped when it wanders sideways by as much, and rounding makes it do so.
* The table is a plane: its contact with a sphere is exact at any depth, a box's is not.
* `numSolverIterations` is what sequential impulses need to converge to rounding, see `_iterations`.
* No sleeping, no damping, no friction, no rolling: everything stays on the vertical axis by symmetry.
* Everything is in SI units as asked; only the balls' radius is ours (`radius_of`).

How it is stepped: a call from Python and two reads cost more than the step itself. Where nothing can happen
(`engines.quiet`) the engine therefore takes up to `STRIDE` sub-steps in one call, with a bit for bit identical result:
their number is one by which the time of the call divides to the step exactly (`_exact`). Heights of single steps are
not read: the engine's update is x += h v with the new v, to the last bit or two.

A client is connected for a call and serves all of its scenes; it is disconnected afterwards. A client that was kept
would be client 0 to whoever else uses PyBullet in this process and names none.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.packages import import_pybullet, why_not
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, radius_of, reduced_masses
from impact_xval.compliant_baselines.engines.world import World
from impact_xval.compliant_baselines.mapping import PYBULLET_RIGID, PybulletBody, pybullet_bodies

#: Most sub-steps of one call.
STRIDE = 256

#: Gap at which the engine forgets a contact point, over the balls' radius; see the module.
BREAKING_OVER_RADIUS = 2e-7

#: The engine takes a step for none below the rounding of 1.0 (SIMD_EPSILON of btScalar.h).
SHORTEST_STEP = sys.float_info.epsilon

#: Impulse of a contact in one step, in N s, at which the engine caps it (btSequentialImpulseConstraintSolver.cpp).
LARGEST_IMPULSE = 1e10

#: Diagonal in m of the box around a body at which the engine takes it out of the simulation, without a status
#: (btCollisionWorld.cpp, updateSingleAabb).
LARGEST_BODY = 1e6

#: What a body must not do on the engine's own account, as `changeDynamics` has it.
ZERO = (
    *("restitution", "lateralFriction", "spinningFriction", "rollingFriction"),
    *("linearDamping", "angularDamping", "contactProcessingThreshold"),
)

#: Part of a ball: the base meets the ball below, the link the ball above.
BASE, LINK = -1, 0

#: A fixed, massless link at the place of its base.
FIXED: dict[str, Any] = {
    "linkMasses": [0],
    "linkVisualShapeIndices": [-1],
    "linkPositions": [(0, 0, 0)],
    "linkOrientations": [(0, 0, 0, 1)],
    "linkInertialFramePositions": [(0, 0, 0)],
    "linkInertialFrameOrientations": [(0, 0, 0, 1)],
    "linkParentIndices": [0],
    "linkJointAxis": [(0, 0, 1)],
}


class Pybullet(Engine):
    """PyBullet, where it has wheels (CPython up to 3.11) or was built."""

    name = "pybullet"
    distribution = "pybullet"
    _client = -1

    def unavailable(self) -> str | None:
        """Why PyBullet cannot run here and the way out; None if it can."""
        way_out = "run pip install 'pybullet>=3.2.7'"
        if sys.version_info >= (3, 12):
            way_out = (
                "it has no wheels beyond CPython 3.11: run with Python 3.11, or build it from source "
                "(pip install --no-binary :all: pybullet)"
            )
        return why_not("PyBullet", self.distribution, import_pybullet, way_out)

    def refusal(self, scene: Scene) -> str | None:
        """Why PyBullet cannot take a scene: one of its absolute numbers would replace what was asked."""
        if scene.mapping == "naive" and not _unlinked(scene):
            return "mapping = 'naive': PyBullet's is that of two balls on a table; legal: 'calibrated'"
        if scene.step <= SHORTEST_STEP:
            return (
                f"step = {scene.step:.3g} s: PyBullet takes a step of {SHORTEST_STEP:.1e} s or less for none"
            )
        largest = scene.fastest * sum(scene.masses)
        if largest > LARGEST_IMPULSE:
            return f"m |v0| = {largest:.3g} N s: PyBullet caps a contact at {LARGEST_IMPULSE:.0e} N s a step"
        depth = scene.depth([pair.stiffness for pair in _pairs(scene)])
        radius = radius_of(depth)
        if 2 * math.sqrt(3) * radius <= LARGEST_BODY:
            return None
        return (
            f"penetrations of up to {depth:.3g} m ask for balls of radius {radius:.3g} m: "
            f"PyBullet drops bodies larger than {LARGEST_BODY:.0e} m; scale stiffnesses, masses or v0 (Theorem 5)"
        )

    def world(self, scene: Scene) -> PybulletWorld:
        """Set a scene up."""
        return PybulletWorld(self._client, scene)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Connect a client without a window, and disconnect it afterwards."""
        p = import_pybullet()
        self._client = p.connect(p.DIRECT)
        if self._client < 0:
            raise RuntimeError("PyBullet gave no client: more than 1024 are connected in this process")
        try:
            yield
        finally:
            p.disconnect(physicsClientId=self._client)


class NaivePybullet(Pybullet):
    """PyBullet with the stiffness and damping of the ball-ball contact on both balls, zeta from the textbook."""

    name = "pybullet-naive"


class PybulletWorld(World):
    """Plane and spheres in a client."""

    longest_leap = STRIDE

    def __init__(self, client: int, scene: Scene) -> None:
        p = self._p = import_pybullet()
        self._client, self._step, self._stride, self._falls = client, scene.step, 0, scene.gravity > 0
        pairs = _pairs(scene)
        radius = radius_of(scene.depth([pair.stiffness for pair in pairs]))
        self._places = scene.places(radius)
        if scene.settled:
            self.rest = scene.masses[-1] * scene.gravity / pairs[-1].stiffness
        self.heights = self._x = scene.start(radius, self.rest)
        p.resetSimulation(physicsClientId=client)
        p.setPhysicsEngineParameter(
            fixedTimeStep=scene.step,
            numSubSteps=0,
            numSolverIterations=_iterations(scene, pairs),
            solverResidualThreshold=0,
            contactSlop=0,
            contactBreakingThreshold=BREAKING_OVER_RADIUS * radius,
            restitutionVelocityThreshold=0,
            useSplitImpulse=0,
            physicsClientId=client,
        )
        p.setGravity(0, 0, -scene.gravity, physicsClientId=client)
        self._linked = not _unlinked(scene)
        self._make(scene, radius)
        self.effective = self._effective(pairs)

    def _make(self, scene: Scene, radius: float) -> None:
        """Make table and balls, the upper one first, and let each meet its neighbours."""
        p, client = self._p, {"physicsClientId": self._client}
        sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=radius, **client)
        how, plane = (
            {"useMaximalCoordinates": int(not self._linked)},
            p.createCollisionShape(p.GEOM_PLANE, **client),
        )
        table = p.createMultiBody(0, plane, **how, **client)
        if self._linked:
            how = {**FIXED, "linkCollisionShapeIndices": [sphere], "linkJointTypes": [p.JOINT_FIXED]}
        self.balls = []
        # The lower ball first: so the bodies come in the order of their heights.
        states = zip(scene.masses, self._places + self._x, scene.velocities, strict=True)
        for mass, z, v in reversed(list(states)):
            ball = p.createMultiBody(mass, sphere, basePosition=(0, 0, z), **how, **client)
            p.resetBaseVelocity(ball, (0, 0, v), (0, 0, 0), **client)
            self.balls.insert(0, ball)
        self._sides = [((ball, BASE), (ball, LINK if self._linked else BASE)) for ball in self.balls]
        if scene.table:
            self._sides.append(((table, BASE), (table, BASE)))
        self._set(scene)

    def _set(self, scene: Scene) -> None:
        """Give the sides of all bodies their contacts, and keep all else from meeting."""
        p, client = self._p, {"physicsClientId": self._client}
        if self._linked:
            own = {side: PybulletBody(PYBULLET_RIGID, 0.0) for both in self._sides for side in both}
            contacts = zip(self._sides, scene.contacts, strict=False)
            own |= {below: PybulletBody(contact.k, contact.c) for (below, _), contact in contacts}
        else:
            bodies = pybullet_bodies(scene.contacts[0], scene.contacts[1], scene.mapping)
            own = {side: body for (side, _), body in zip(self._sides, bodies, strict=True)}
        for (body, part), contact in own.items():
            p.changeDynamics(
                body,
                part,
                **dict.fromkeys(ZERO, 0),
                maxJointVelocity=1e30,
                activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING,
                **client,
            )
            values = {"contactStiffness": contact.stiffness, "contactDamping": contact.damping}
            p.changeDynamics(body, part, **values, **client)
            if self._linked:
                p.setCollisionFilterGroupMask(body, part, 0, 0, **client)
        if self._linked:
            for ((a, below), _), (_, (b, above)) in pairwise(self._sides):
                p.setCollisionFilterPair(a, b, below, above, 1, **client)

    def _effective(self, pairs: list[PybulletBody]) -> dict[str, tuple[float, ...]]:
        """Combine what the engine says of both sides of a contact; of a body without a link it says nothing."""
        info, client = self._p.getDynamicsInfo, self._client
        if self._linked:
            sides = [[PybulletBody(*info(*side, client)[9:7:-1]) for side in both] for both in self._sides]
            pairs = [below.against(above) for (below, _), (_, above) in pairwise(sides)]
        return {
            "stiffness": tuple(pair.stiffness for pair in pairs),
            "damping": tuple(pair.damping for pair in pairs),
            "step": (self._p.getPhysicsEngineParameters(client)["fixedTimeStep"],),
        }

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps, or, while bodies fall, fewer: up to the first after which all gaps are open."""
        self._set_stride(0)
        step, read, client, balls = self._p.stepSimulation, self._p.getBaseVelocity, self._client, self.balls
        h, x, velocities, heights = self._step, self._x.tolist(), [], []
        for _ in range(n):
            step(client)
            v = [read(ball, client)[0][2] for ball in balls]
            x = [height + h * speed for height, speed in zip(x, v, strict=True)]
            velocities.append(v)
            heights.append(x)
            if self._falls and x[0] >= x[1] >= 0:
                break
        self._x = np.array(x)
        return np.array(velocities), np.array(heights)

    def leap(self, n: int) -> tuple[int, Floats, Floats]:
        """Take up to n steps in one call."""
        n = _exact(n, self._step)
        self._set_stride(n)
        self._p.stepSimulation(self._client)
        read, where, client = self._p.getBaseVelocity, self._p.getBasePositionAndOrientation, self._client
        v = np.array([read(ball, client)[0][2] for ball in self.balls])
        self._x = np.array([where(ball, client)[0][2] for ball in self.balls]) - self._places
        return n, v, self._x

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Switch gravity off: a flight begins with a step after which all gaps are open, the last one taken."""
        self._p.setGravity(0, 0, 0, physicsClientId=self._client)
        self._falls = False

    def _set_stride(self, n: int) -> None:
        if n != self._stride:
            self._p.setPhysicsEngineParameter(
                fixedTimeStep=max(1, n) * self._step, numSubSteps=n, physicsClientId=self._client
            )
            self._stride = n


def _unlinked(scene: Scene) -> bool:
    """Whether no ball needs two sides; see the module."""
    return scene.table and len(scene.masses) == 2


def _pairs(scene: Scene) -> list[PybulletBody]:
    """Give stiffness and damping of the contacts as the engine combines them."""
    if not _unlinked(scene):
        return [PybulletBody(contact.k, contact.c) for contact in scene.contacts]
    upper, lower, table = pybullet_bodies(scene.contacts[0], scene.contacts[1], scene.mapping)
    return [upper.against(lower), lower.against(table)]


def _iterations(scene: Scene, pairs: list[PybulletBody]) -> int:
    """Count the iterations after which sequential impulses are converged to rounding.

    One sweep is Gauss and Seidel's on the inverse-mass matrix of the contacts with the engine's compliance
    1/(h (h k + c)) on its diagonal; on a symmetric tridiagonal matrix its spectral radius is the square of that of
    Jacobi's iteration: 1e-5 for two balls at a step of 1/1000 of a period, 0.02 at 1/10.
    """
    h, masses = scene.step, scene.masses
    pair_masses = reduced_masses(scene)
    diagonal = [
        1 / m + 1 / (h * (h * c.stiffness + c.damping)) for m, c in zip(pair_masses, pairs, strict=True)
    ]
    below = zip(masses[1:], pairwise(diagonal), strict=False)
    beside = [1 / (m * math.sqrt(d) * math.sqrt(e)) for m, (d, e) in below]
    radius = np.abs(np.linalg.eigvalsh(np.diag(beside, 1) + np.diag(beside, -1))).max()
    shrink = min(max(radius**2, sys.float_info.min), 1 - sys.float_info.epsilon)
    # 36.7 = -ln(1.1e-16); two more, for the cap at zero force to settle which contacts act.
    return 2 + min(1000, max(2, math.ceil(36.7 / -math.log(shrink))))


def _exact(n: int, h: float) -> int:
    """Give the largest number up to n of sub-steps that the engine makes of their time as they are meant.

    It divides the time n h of a call by n, and counts how often what comes out goes into it
    (btDiscreteDynamicsWorld.cpp, stepSimulation); rounding spoils that for some n. Powers of two are safe.
    """
    while n * h / n != h or int(n * h / h) != n:
        n -= 1
    return n
