"""DART: one linear complementarity problem with bounds for all contacts of a step, in double precision.

The problem is solved by Dantzig's method. The restitution of a contact is the product of the coefficients of its two
shapes. Each ball slides along a joint. Split impulses keep the correction of overlaps from changing velocities.

dartpy before 6.20 has no split impulses. Corrections of overlaps then change the velocities of touching bodies by up to
1e-3 m/s, and many collisions do not end.

Measured in version 6.20: DART softens a contact by 1e-5, so that a rebound is slower by (1 + e) 1e-5 of the approach. A
contact that would rebound at `SLOWEST` or less does not rebound, and no contact rebounds faster than `FASTEST`.

With its default settings (`shipped`) DART keeps its collision detector (FCL), its solvers, and the correction of
overlaps by velocities.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib import import_module
from itertools import combinations
from typing import Protocol

import numpy as np

from impact_xval.compliant_baselines.engines.arrangement import SPACE_AXES
from impact_xval.compliant_baselines.engines.scene import Floats, Scene
from impact_xval.compliant_baselines.rigid.lines import PLANE_WIDER, RigidEngine, RigidWorld

#: Largest speed of rebound in m/s at which DART gives no restitution (DART_BOUNCING_VELOCITY_THRESHOLD in
#: dart/constraint/ContactConstraint.cpp).
SLOWEST = 0.1

#: Largest speed of rebound in m/s (DART_MAX_BOUNCING_VELOCITY in the same file).
FASTEST = 100.0


class DartJoint(Protocol):
    """The methods of `dartpy.dynamics.PrismaticJoint` and `TranslationalJoint` that the adapter calls."""

    def setPosition(self, index: int, position: float) -> None:
        """Set a position along the joint in m; `index` is the number of the joint's axis, from 0."""
        ...

    def setVelocity(self, index: int, velocity: float) -> None:
        """Set a velocity along the joint in m/s; `index` is the number of the joint's axis, from 0."""
        ...

    def getPosition(self, index: int) -> float:
        """Return a position along the joint in m; `index` is the number of the joint's axis, from 0."""
        ...

    def getVelocity(self, index: int) -> float:
        """Return a velocity along the joint in m/s; `index` is the number of the joint's axis, from 0."""
        ...


class DartMaterial(Protocol):
    """The methods of `dartpy.dynamics.DynamicsAspect` that the adapter calls."""

    def setFrictionCoeff(self, value: float) -> None:
        """Set the coefficient of friction of a shape."""
        ...

    def setRestitutionCoeff(self, value: float) -> None:
        """Set the coefficient of restitution of a shape."""
        ...

    def getRestitutionCoeff(self) -> float:
        """Return the coefficient of restitution of a shape."""
        ...


class DartShapeNode(Protocol):
    """The methods of `dartpy.dynamics.ShapeNode` that the adapter calls."""

    def setRelativeTranslation(self, translation: list[float]) -> None:
        """Set the position of the shape relative to its body, in m."""
        ...

    def setRelativeRotation(self, rotation: list[list[float]]) -> None:
        """Set the rotation matrix of the shape relative to its body."""
        ...

    def createCollisionAspect(self) -> object:
        """Make the shape collide with other shapes."""
        ...

    def createDynamicsAspect(self) -> DartMaterial:
        """Give the shape friction and restitution, and return the object that sets them."""
        ...


class DartBody(Protocol):
    """The methods of `dartpy.dynamics.BodyNode` that the adapter calls."""

    def setMass(self, mass: float) -> None:
        """Set the mass in kg."""
        ...

    def createShapeNode(self, shape: object) -> DartShapeNode:
        """Add a shape to the body."""
        ...


class DartSkeleton(Protocol):
    """The methods of `dartpy.dynamics.Skeleton` that the adapter calls."""

    def createPrismaticJointAndBodyNodePair(
        self, parent: None, properties: object
    ) -> tuple[DartJoint, DartBody]:
        """Add a body that slides along an axis."""
        ...

    def createTranslationalJointAndBodyNodePair(self) -> tuple[DartJoint, DartBody]:
        """Add a body that slides along x, y and z."""
        ...


class DartWorld(RigidWorld):
    """A scene in its own `World` of DART."""

    resolution, accuracy = 1e-4, 1e-5

    def __init__(self, scene: Scene, radius: float) -> None:
        super().__init__(scene, radius)
        dart = import_module("dartpy")
        world, half = dart.simulation.World(), self.radius / 2
        self._world = world
        self._joints: list[DartJoint] = []
        first: dict[int, DartMaterial] = {}
        second: dict[int, DartMaterial] = {}
        world.setGravity([0, 0, 0])
        world.setTimeStep(scene.step)
        solver = world.getConstraintSolver()
        exact = scene.mapping != "shipped"
        if exact:
            solver.setCollisionDetector(dart.collision.DARTCollisionDetector())
        if exact and hasattr(
            solver, "setSplitImpulseEnabled"
        ):  # dartpy before 6.20 can set neither of the two
            solver.setSplitImpulseEnabled(True)
            # With four balls Dantzig's method can fail. DART then sweeps over the contacts, by default only 30 times,
            # which is far too few.
            solver.getSecondaryBoxedLcpSolver().setOption(
                dart.constraint.PgsBoxedLcpSolverOption(10_000, 0.0, 1e-14)
            )

        def add(
            body: DartBody, shape: object, place: Sequence[float], e: float, turn: float = 0.0
        ) -> DartMaterial:
            node = body.createShapeNode(shape)
            node.setRelativeTranslation([*place])
            cosine, sine = math.cos(turn), math.sin(turn)
            node.setRelativeRotation([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
            node.createCollisionAspect()
            material = node.createDynamicsAspect()
            material.setFrictionCoeff(0)
            material.setRestitutionCoeff(e)
            return material

        #: Indices of the joint's axes that are coordinates of the scene.
        self._indices = SPACE_AXES[self.axes] if self.axes > 1 else [0]
        bodies: list[DartBody] = []
        coordinates = np.reshape(self.places + self.heights, (-1, self.axes)).tolist()
        velocities = np.reshape(scene.velocities, (-1, self.axes)).tolist()
        for i, (mass, place, v) in enumerate(zip(scene.masses, coordinates, velocities, strict=True)):
            skeleton = dart.dynamics.Skeleton()
            joint, body = self._slide(skeleton)
            body.setMass(mass)
            for contact, offset, is_first in self.spheres(i):
                e = scene.restitutions[contact] if is_first else scene.partner_restitution
                material = add(body, dart.dynamics.SphereShape(half), offset, e)
                (first if is_first else second)[contact] = material
            for index, x, rate in zip(self._indices, place, v, strict=True):
                joint.setPosition(index, x)
                joint.setVelocity(index, rate)
            self._joints.append(joint)
            bodies.append(body)
            world.addSkeleton(skeleton)
        touching = {frozenset(touch[:2]) for touch in scene.arrangement.touches if touch.second is not None}
        for wall in self.walls:
            skeleton = dart.dynamics.Skeleton()
            _, body = skeleton.createWeldJointAndBodyNodePair()
            middle = (wall.point - 50 * half * wall.normal).tolist()
            box = dart.dynamics.BoxShape([100 * half] * 3)
            second[wall.contact] = add(body, box, middle, scene.partner_restitution, wall.angle)
            touching.add(frozenset((scene.arrangement.touches[wall.contact].first, len(bodies))))
            bodies.append(body)
            world.addSkeleton(skeleton)
        for i, j in combinations(range(len(bodies)), 2):
            if frozenset((i, j)) not in touching:
                solver.getCollisionOption().collisionFilter.addBodyNodePairToBlackList(bodies[i], bodies[j])
        pairs = [(first[i], second[i]) for i in range(len(scene.restitutions))]
        self._restitutions, self._velocities = np.array(scene.restitutions), np.array(scene.velocities)
        self._J = scene.arrangement.jacobian
        self.effective = {
            "restitution": tuple(a.getRestitutionCoeff() * b.getRestitutionCoeff() for a, b in pairs),
            "step": (world.getTimeStep(),),
            **({"threshold": (SLOWEST,)} if exact else {}),
        }

    def _slide(self, skeleton: DartSkeleton) -> tuple[DartJoint, DartBody]:
        """Add a body that slides along the vertical in a line, or along x, y and z in a plane, where y stays 0.

        A `TranslationalJoint2D` cannot be used: contacts do not move it along its second axis (dartpy 6.20).
        """
        if self.axes > 1:
            return skeleton.createTranslationalJointAndBodyNodePair()
        slide = import_module("dartpy").dynamics.PrismaticJointProperties()
        slide.mAxis = [0, 0, 1]
        return skeleton.createPrismaticJointAndBodyNodePair(None, slide)

    def step(self) -> tuple[list[float], list[float]]:
        """Take a step, and return the velocities in m/s and the coordinates of the balls in m after it."""
        self._world.step()
        velocities = [joint.getVelocity(index) for joint in self._joints for index in self._indices]
        return velocities, [joint.getPosition(index) for joint in self._joints for index in self._indices]

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps, and add to `dropped` the speed of rebounds that DART has suppressed in them."""
        velocities, heights = super().advance(n)
        states = np.vstack([self._velocities, velocities])
        rates = -(states @ self._J.T)
        rebound = self._restitutions * rates[:-1]
        struck = (rebound > 0) & (rebound <= SLOWEST) & (rates[1:] != rates[:-1])
        self.dropped += float(rebound[struck].sum())
        self._velocities = velocities[-1]
        return velocities, heights


class Dart(RigidEngine):
    """DART, with rigid contacts."""

    name, distribution, module, title = "dart", "dartpy", "dartpy", "DART"
    shipped_step, made = 1e-3, DartWorld
    knows_planes, plane_wider = True, PLANE_WIDER

    def refusal(self, scene: Scene) -> str | None:
        """Return a sentence that says why DART cannot take a scene, or None.

        A scene is refused if DART would suppress the rebound of a first impact, or limit its speed. If DART runs with
        its default settings, the scene is accepted, because DART's default behaviour is then what was asked for.
        """
        if scene.mapping == "shipped":
            return super().refusal(scene)
        for i, rebound in enumerate((scene.restitutions * scene.rates).tolist(), 1):
            would = f"contact {i} would rebound at {rebound:.3g} m/s: DART"
            if 0 < rebound <= SLOWEST:
                return f"{would} suppresses rebounds up to {SLOWEST} m/s"
            if rebound > FASTEST:
                return f"{would} allows no rebound faster than {FASTEST} m/s"
        return super().refusal(scene)
