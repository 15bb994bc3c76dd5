"""DART: one boxed LCP for all contacts of a step (Dantzig's method), in double precision.

The restitution of a contact is the product of the coefficients of its two shapes. Each ball slides along a joint. Split
impulses keep the correction of overlaps out of velocities.

Before 6.20 dartpy has no split impulses: corrections of overlaps add up to 1e-3 m/s to the velocities of bodies that
touch, and many collisions have no end.

Measured of version 6.20: DART softens a contact by 1e-5, so that a rebound is slower by (1 + e) 1e-5 of the approach. A
contact that would rebound at `SLOWEST` or less does not rebound, and no contact rebounds faster than `FASTEST`.

Run as it ships, DART keeps its collision detector (FCL), its solvers and the correction of overlaps by velocities.
"""

from __future__ import annotations

from importlib import import_module
from typing import Protocol

import numpy as np

from impact_xval.compliant_baselines.engines.scene import Floats, Scene
from impact_xval.compliant_baselines.rigid.lines import RigidEngine, RigidWorld

#: Speed of rebound in m/s up to which DART drops restitution (DART_BOUNCING_VELOCITY_THRESHOLD in
#: dart/constraint/ContactConstraint.cpp).
SLOWEST = 0.1

#: Fastest rebound in m/s (DART_MAX_BOUNCING_VELOCITY in the same file).
FASTEST = 100.0


class DartJoint(Protocol):
    """What the adapter reads of `dartpy.dynamics.PrismaticJoint` after a step."""

    def getPosition(self, index: int) -> float:
        """Return the position along the joint in m."""
        ...

    def getVelocity(self, index: int) -> float:
        """Return the velocity along the joint in m/s."""
        ...


class DartMaterial(Protocol):
    """What the adapter calls of `dartpy.dynamics.DynamicsAspect`."""

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
    """What the adapter calls of `dartpy.dynamics.ShapeNode`."""

    def setRelativeTranslation(self, translation: list[float]) -> None:
        """Place the shape in its body; in m."""
        ...

    def createCollisionAspect(self) -> object:
        """Let the shape collide."""
        ...

    def createDynamicsAspect(self) -> DartMaterial:
        """Give the shape a material."""
        ...


class DartBody(Protocol):
    """What the adapter calls of `dartpy.dynamics.BodyNode`."""

    def createShapeNode(self, shape: object) -> DartShapeNode:
        """Add a shape to the body."""
        ...


class DartWorld(RigidWorld):
    """A world of its own."""

    resolution, accuracy = 1e-4, 1e-5

    def __init__(self, scene: Scene, radius: float) -> None:
        super().__init__(scene, radius)
        dart = import_module("dartpy")
        world, half = dart.simulation.World(), self.radius / 2
        self._world = world
        self._joints: list[DartJoint] = []
        lower: list[DartMaterial] = []
        upper: list[DartMaterial] = []
        world.setGravity([0, 0, 0])
        world.setTimeStep(scene.step)
        solver = world.getConstraintSolver()
        exact = scene.mapping != "shipped"
        if exact:
            solver.setCollisionDetector(dart.collision.DARTCollisionDetector())
        if exact and hasattr(solver, "setSplitImpulseEnabled"):  # dartpy before 6.20 reaches neither setting
            solver.setSplitImpulseEnabled(True)
            # With four balls Dantzig's method can give up. DART then sweeps over the contacts, by default 30 times,
            # which is far too few.
            solver.getSecondaryBoxedLcpSolver().setOption(
                dart.constraint.PgsBoxedLcpSolverOption(10_000, 0.0, 1e-14)
            )

        def add(body: DartBody, shape: object, z: float, e: float) -> DartMaterial:
            node = body.createShapeNode(shape)
            node.setRelativeTranslation([0, 0, z])
            node.createCollisionAspect()
            material = node.createDynamicsAspect()
            material.setFrictionCoeff(0)
            material.setRestitutionCoeff(e)
            return material

        e_below = (*scene.restitutions, 1.0)  # the lowest ball may have nothing below
        slide = dart.dynamics.PrismaticJointProperties()
        slide.mAxis = [0, 0, 1]
        for mass, z, v, e in zip(scene.masses, self.centres, scene.velocities, e_below, strict=False):
            skeleton = dart.dynamics.Skeleton()
            joint, body = skeleton.createPrismaticJointAndBodyNodePair(None, slide)
            body.setMass(mass)
            lower.append(add(body, dart.dynamics.SphereShape(half), -half, e))
            upper.append(add(body, dart.dynamics.SphereShape(half), half, scene.partner_restitution))
            joint.setPosition(0, z)
            joint.setVelocity(0, v)
            self._joints.append(joint)
            world.addSkeleton(skeleton)
        if scene.table:
            skeleton = dart.dynamics.Skeleton()
            _, body = skeleton.createWeldJointAndBodyNodePair()
            upper.append(
                add(body, dart.dynamics.BoxShape([100 * half] * 3), -50 * half, scene.partner_restitution)
            )
            world.addSkeleton(skeleton)
        pairs = zip(lower, upper[1:], strict=False)
        self._restitutions, self._velocities = np.array(scene.restitutions), np.array(scene.velocities)
        self.effective = {
            "restitution": tuple(a.getRestitutionCoeff() * b.getRestitutionCoeff() for a, b in pairs),
            "step": (world.getTimeStep(),),
            **({"threshold": (SLOWEST,)} if exact else {}),
        }

    def step(self) -> tuple[list[float], list[float]]:
        """Take a step."""
        self._world.step()
        return [j.getVelocity(0) for j in self._joints], [j.getPosition(0) for j in self._joints]

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps, and add up the restitution that DART has dropped in them."""
        velocities, heights = super().advance(n)
        states = np.vstack([self._velocities, velocities])
        table = np.zeros(len(states))
        rates = np.diff(np.column_stack([states, table]))[:, : len(self._restitutions)]
        rebound = self._restitutions * rates[:-1]
        struck = (rebound > 0) & (rebound <= SLOWEST) & (rates[1:] != rates[:-1])
        self.dropped += float(rebound[struck].sum())
        self._velocities = velocities[-1]
        return velocities, heights


class Dart(RigidEngine):
    """DART."""

    name, distribution, module, title = "dart", "dartpy", "dartpy", "DART"
    shipped_step, made = 1e-3, DartWorld

    def refusal(self, scene: Scene) -> str | None:
        """Say why DART cannot take a scene: it would drop the restitution of a first impact, or limit its rebound.

        As it ships it takes them, for what it then does is what was asked.
        """
        if scene.mapping == "shipped":
            return super().refusal(scene)
        for i, rebound in enumerate((scene.restitutions * scene.rates).tolist(), 1):
            would = f"contact {i} would rebound at {rebound:.3g} m/s: DART"
            if 0 < rebound <= SLOWEST:
                return f"{would} drops restitution up to {SLOWEST} m/s"
            if rebound > FASTEST:
                return f"{would} has none faster than {FASTEST} m/s"
        return super().refusal(scene)
