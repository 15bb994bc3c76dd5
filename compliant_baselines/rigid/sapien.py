"""SAPIEN (PhysX 5 on a CPU) in single precision, by its TGS solver; materials have restitutions.

PhysX takes the mean of the coefficients of two shapes, so both shapes of a contact have the contact's e, and
`Settings.partner_restitution` has no effect. Bodies cannot turn or leave the line or the plane. SAPIEN has a speed
below which contacts have no restitution, the same for all scenes, by default 2 m/s. The adapter sets it to 0 while a
scene runs, and restores it afterwards.

With its default settings (`shipped`) SAPIEN keeps this speed, its contact offsets, its iterations, its sleeping of slow
bodies, and the correction of overlaps.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Protocol

import numpy as np

from impact_xval.compliant_baselines.engines.arrangement import SPACE_AXES, in_space
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.rigid.lines import (
    SINGLE,
    RigidEngine,
    RigidWorld,
    filter_bit,
    nearest_float32,
)

#: Number of iterations for positions and for velocities, the largest that PhysX allows. With only four iterations a
#: single ball rebounds with 0.693, not 0.7.
MAX_ITERATIONS = 255

#: Distance over the radius at which PhysX begins a contact, half of it for each shape. A ball that takes several steps
#: through this distance stops at its outer end and keeps its velocity. At 1e-3 slow balls therefore never arrived.
CONTACT_OFFSET = 1e-5

#: Speed in m/s below which contacts have no restitution by default (`PhysxSceneConfig.bounce_threshold`).
SHIPPED_THRESHOLD = 2.0


class SapienShape(Protocol):
    """The members of `sapien.physx.PhysxCollisionShape` that the adapter writes; lengths in m."""

    #: Pose of the shape in its body, a `sapien.Pose`.
    local_pose: object
    contact_offset: float
    rest_offset: float

    def set_collision_groups(self, groups: list[int]) -> None:
        """Set the shape's groups, the groups that it meets, and two sets of groups for shapes that do not meet."""
        ...


class SapienBody(Protocol):
    """The methods of `sapien.physx.PhysxRigidBaseComponent` that the adapter calls."""

    def attach(self, shape: SapienShape) -> object:
        """Attach a shape to the body."""
        ...


class SapienPose(Protocol):
    """The member of `sapien.Pose` that the adapter reads."""

    #: Position in m.
    p: Sequence[float]


class SapienDynamicBody(SapienBody, Protocol):
    """The members of `sapien.physx.PhysxRigidDynamicComponent` that the adapter reads after a step."""

    pose: SapienPose
    #: Velocity in m/s.
    linear_velocity: Sequence[float]


class SapienWorld(RigidWorld):
    """A scene in its own `Scene` of SAPIEN, without graphics."""

    resolution, accuracy = SINGLE, 2e-5

    def __init__(self, scene: Scene, radius: float) -> None:
        super().__init__(scene, radius)
        sapien = import_module("sapien")
        physx, half = sapien.physx, self.radius / 2
        exact = scene.mapping != "shipped"
        threshold = 0.0 if exact else SHIPPED_THRESHOLD
        physx.set_scene_config(gravity=[0, 0, 0], bounce_threshold=threshold, enable_tgs=True)
        system = self._system = physx.PhysxCpuSystem()
        self._scene = sapien.Scene([system])
        system.timestep = scene.step

        def attach(
            body: SapienBody, shape: SapienShape, contact: int, place: Sequence[float], turn: float = 0.0
        ) -> None:
            shape.local_pose = sapien.Pose([*place], [math.cos(turn / 2), 0, math.sin(turn / 2), 0])
            bit = filter_bit(contact)
            shape.set_collision_groups([bit, bit, 0, 0])
            if exact:
                shape.contact_offset, shape.rest_offset = CONTACT_OFFSET * self.radius, 0.0
            body.attach(shape)

        def add(body: SapienBody, place: Sequence[float]) -> None:
            entity = sapien.Entity()
            entity.add_component(body)
            entity.pose = sapien.Pose([*place])
            self._scene.add_entity(entity)

        materials = [physx.PhysxMaterial(0, 0, e) for e in scene.restitutions]
        self._bodies: list[SapienDynamicBody] = []
        locked = [axis not in SPACE_AXES[self.axes] for axis in range(3)] + [True] * 3
        velocities = in_space(np.array(scene.velocities), self.axes).tolist()
        for i, (mass, centre, v) in enumerate(zip(scene.masses, self.centres, velocities, strict=True)):
            body = physx.PhysxRigidDynamicComponent()
            for contact, offset, _ in reversed(self.spheres(i)):
                attach(body, physx.PhysxCollisionShapeSphere(half, materials[contact]), contact, offset)
            body.mass, body.inertia = mass, [mass * half**2] * 3
            body.linear_damping = body.angular_damping = 0
            body.set_locked_motion_axes(locked)
            body.disable_gravity = True
            if exact:
                body.sleep_threshold = 0
                body.max_depenetration_velocity = 1e-20
                body.solver_position_iterations = body.solver_velocity_iterations = MAX_ITERATIONS
            add(body, centre)
            body.linear_velocity = v
            self._bodies.append(body)
        for wall in self.walls:
            body = physx.PhysxRigidStaticComponent()
            box = physx.PhysxCollisionShapeBox([50 * half, 50 * half, half], materials[wall.contact])
            attach(body, box, wall.contact, (-half * wall.normal).tolist(), wall.angle)
            add(body, wall.point.tolist())
        self.effective = {
            "restitution": tuple(
                nearest_float32(material.restitution, e)
                for material, e in zip(materials, scene.restitutions, strict=True)
            ),
            "step": (nearest_float32(system.timestep, scene.step),),
            **({"threshold": (physx.get_scene_config().bounce_threshold,)} if exact else {}),
        }

    def step(self) -> tuple[list[float], list[float]]:
        """Take a step, and return the velocities in m/s and the coordinates of the balls' centres in m after it."""
        self._system.step()
        axes = SPACE_AXES[self.axes]
        velocities = [float(body.linear_velocity[axis]) for body in self._bodies for axis in axes]
        return velocities, [float(body.pose.p[axis]) for body in self._bodies for axis in axes]


class Sapien(RigidEngine):
    """SAPIEN, with rigid contacts."""

    name = distribution = module = "sapien"
    title = "SAPIEN"
    shipped_step, made, knows_planes = 0.01, SapienWorld, True

    def unavailable(self) -> str | None:
        """Return None if SAPIEN can run on this machine; else the reason and the remedy.

        Its warning about missing graphics is suppressed.
        """
        with warnings.catch_warnings(action="ignore"):
            return super().unavailable()

    @contextmanager
    def running(self) -> Generator[None]:
        """Restore at the end the speed below which nothing rebounds, which each scene changes for the whole process."""
        physx = import_module("sapien").physx
        config = physx.get_scene_config()
        threshold = config.bounce_threshold
        try:
            with warnings.catch_warnings(action="ignore"):
                yield
        finally:
            config.bounce_threshold = threshold
            physx.set_scene_config(config)
