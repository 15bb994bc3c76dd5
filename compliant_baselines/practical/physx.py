"""SAPIEN (PhysX 5): rigid bodies in single precision, by either of its solvers.

What it does with restitution (PhysX documentation, "Rigid body collision"): the material's coefficients are averaged,
which SAPIEN leaves no way to change; a contact slower than the bounce threshold, 2 m/s by default, does not bounce. So
balls of 1 m/s do not bounce as it is shipped. Contacts are speculative: made up to 0.01 m ahead (`contact_offset`).

SAPIEN ships the solver TGS ("temporal Gauss-Seidel"), PGS being PhysX's own default, and ten iterations of position.
Its configuration is global: it is set when a system is made, and put back.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from impact_xval.compliant_baselines.practical.mixing import means
from impact_xval.compliant_baselines.practical.practice import RADIUS, Arrangement, Practice
from impact_xval.model.columns.column import Column

#: Bounce threshold in m/s as it is shipped, and one that keeps no bounce away; it may not be 0.
SHIPPED_THRESHOLD, NO_THRESHOLD = 2.0, 1e-6

#: Rotation of the plane, whose normal is x, to one whose normal is z; as a quaternion, w first.
UPWARDS = (0.5**0.5, 0.0, -(0.5**0.5), 0.0)


class Physx(Practice):
    """PhysX by one of its solvers, with a bounce threshold in m/s."""

    engine = "PhysX"
    distribution = "sapien"
    module = "sapien"
    precision = "float32"
    default_step = 0.01

    def __init__(self, name: str, tgs: bool, threshold: float) -> None:
        self.name = name
        solver = "TGS" if tgs else "PGS"
        bounce = "as shipped" if threshold == SHIPPED_THRESHOLD else "not"
        self.settings = f"{solver}; bounce threshold {threshold:g} m/s, {bounce}; restitutions are averaged"
        self._tgs, self._threshold = tgs, threshold

    def load(self) -> object:
        """Import it."""
        return import_module("sapien.physx")

    def refuses(self, column: Column) -> str | None:
        """Means of what two bodies have cannot be any coefficients."""
        if means(column.restitutions, 1.0) is not None:
            return None
        return (
            f"restitutions = {column.restitutions!r}: PhysX averages the coefficients of two bodies, and no "
            "coefficients from 0 to 1 have these means; legal: equal ones, or nearly so"
        )

    @contextmanager
    def world(self, column: Column, arrangement: Arrangement) -> Iterator[_World]:
        """Make the column."""
        physx: Any = import_module("sapien.physx")
        before = physx.get_scene_config()
        physx.set_scene_config(gravity=(0, 0, 0), bounce_threshold=self._threshold, enable_tgs=self._tgs)
        try:
            yield _World(column, arrangement)
        finally:
            physx.set_scene_config(before)


class _World:
    def __init__(self, column: Column, arrangement: Arrangement) -> None:
        sapien: Any = import_module("sapien")
        physx = sapien.physx
        self._system = physx.PhysxCpuSystem()
        self._scene = sapien.Scene([self._system])
        self._system.timestep = arrangement.step
        bounces = means(column.restitutions, 1.0) or ()
        heights = arrangement.heights(column)
        self._balls: dict[int, Any] = {}
        for i in arrangement.order(column):
            material = physx.PhysxMaterial(0.0, 0.0, bounces[i])
            entity = sapien.Entity()
            if i == len(column.masses):
                body = physx.PhysxRigidStaticComponent()
                body.attach(physx.PhysxCollisionShapePlane(material))
                entity.set_pose(sapien.Pose([0.0, 0.0, arrangement.floor()], UPWARDS))
            else:
                body = physx.PhysxRigidDynamicComponent()
                body.attach(physx.PhysxCollisionShapeSphere(RADIUS, material))
                body.mass = column.masses[i]
                body.inertia = [0.4 * column.masses[i] * RADIUS**2] * 3
                entity.set_pose(sapien.Pose([0.0, 0.0, heights[i]]))
                self._balls[i] = body
            entity.add_component(body)
            self._scene.add_entity(entity)
        for i, body in self._balls.items():
            body.set_linear_velocity([0.0, 0.0, column.velocities[i]])

    def step(self) -> None:
        self._system.step()

    def velocities(self) -> Sequence[float]:
        return [self._balls[i].linear_velocity[2] for i in range(len(self._balls))]
