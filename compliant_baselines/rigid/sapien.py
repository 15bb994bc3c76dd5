"""SAPIEN (PhysX 5 on a CPU) in single precision: the TGS solver, restitution by material.

PhysX takes the mean of the coefficients of two shapes, so both shapes of a contact have the contact's e, and
`Settings.partner_restitution` has no effect. Rotations are locked, and so are translations across the line or the
plane. SAPIEN has one speed for all scenes below which contacts have no restitution, by default 2 m/s. The adapter sets
it to 0 while a scene runs, and restores it afterwards.

Run with its defaults (`shipped`), SAPIEN keeps this speed, its offsets of contacts, its iterations, its sleep and the
correction of overlaps.
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

#: Position and velocity iterations: as many as PhysX allows. After only four iterations a single ball rebounds with
#: 0.693, not 0.7.
MAX_ITERATIONS = 255

#: Distance over the radius at which PhysX begins a contact, half for each shape. A ball that takes several steps
#: through this distance stops at its outer end and keeps its velocity: at 1e-3 slow balls never arrived.
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
        """Set the groups of the shape, the groups that it meets, and two groups of shapes that do not meet."""
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
        """Take a step."""
        self._system.step()
        axes = SPACE_AXES[self.axes]
        velocities = [float(body.linear_velocity[axis]) for body in self._bodies for axis in axes]
        return velocities, [float(body.pose.p[axis]) for body in self._bodies for axis in axes]


class Sapien(RigidEngine):
    """SAPIEN."""

    name = distribution = module = "sapien"
    title = "SAPIEN"
    shipped_step, made, knows_planes = 0.01, SapienWorld, True

    def unavailable(self) -> str | None:
        """Return why SAPIEN cannot run; its warning about missing graphics is held back."""
        with warnings.catch_warnings(action="ignore"):
            return super().unavailable()

    @contextmanager
    def running(self) -> Generator[None]:
        """Restore the speed below which nothing rebounds: each scene sets it for the whole process."""
        physx = import_module("sapien").physx
        config = physx.get_scene_config()
        threshold = config.bounce_threshold
        try:
            with warnings.catch_warnings(action="ignore"):
                yield
        finally:
            config.bounce_threshold = threshold
            physx.set_scene_config(config)
