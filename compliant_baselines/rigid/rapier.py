"""Rapier, 3-D, in single precision: sub-steps solve contacts without restitution, and restitution follows once.

The adapter makes Rapier multiply the coefficients of two shapes. Bodies move along one axis, in a plane along two, and
do not turn. The solver iterates until it has converged. Overlaps are not pushed out. Rapier limits the speed of bodies,
by default to 400 lengths a second. Here the limit is a million times the speed of the fastest ball.

With its default settings (`shipped`) Rapier keeps all its parameters and takes the mean of two coefficients, so both
shapes of a contact have the contact's e.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Protocol, Self

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

if TYPE_CHECKING:
    from rapier3d import ColliderHandle, RigidBodyHandle


class RapierShape(Protocol):
    """The methods of `rapier3d.ColliderBuilder` that the adapter calls; every call returns the builder."""

    def translation(self, v: tuple[float, float, float], /) -> Self:
        """Set the position of the shape relative to its body, in m."""
        ...

    def density(self, d: float, /) -> Self:
        """Set the density in kg/m^3."""
        ...

    def rotation(self, v: tuple[float, float, float], /) -> Self:
        """Set the rotation of the shape relative to its body, as a vector along the axis; in rad."""
        ...

    def collision_groups(self, g: object, /) -> Self:
        """Set the `InteractionGroups`: the groups of the shape, and the groups that it can meet."""
        ...

    def friction(self, f: float, /) -> Self:
        """Set the coefficient of friction."""
        ...

    def restitution(self, r: float, /) -> Self:
        """Set the coefficient of restitution."""
        ...

    def restitution_combine_rule(self, rule: object, /) -> Self:
        """Set the rule that combines the coefficients of two shapes."""
        ...


class RapierWorld(RigidWorld):
    """A scene in its own world of Rapier."""

    resolution, accuracy = SINGLE, 1e-6

    def __init__(self, scene: Scene, radius: float) -> None:
        super().__init__(scene, radius)
        rapier = import_module("rapier3d")
        world, half = rapier.PhysicsWorld(), self.radius / 2
        parameters = world.integration_parameters
        exact = scene.mapping != "shipped"
        parameters.dt = scene.step
        if exact:
            parameters.length_unit = self.radius
            parameters.normalized_max_corrective_velocity = 0
            parameters.normalized_max_linear_velocity = 1e6 * scene.fastest / self.radius
            parameters.num_internal_pgs_iterations = self.sweeps
            parameters.num_internal_stabilization_iterations = self.sweeps
        rules = rapier.CoefficientCombineRule
        rule = rules.MULTIPLY if exact else rules.AVERAGE

        def add(
            shape: RapierShape,
            contact: int,
            place: tuple[float, float, float],
            e: float,
            body: RigidBodyHandle | None = None,
        ) -> ColliderHandle:
            group = rapier.Group(filter_bit(contact))
            shape = shape.translation(place).density(0).friction(0)
            shape = shape.collision_groups(rapier.InteractionGroups(group, group))
            return world.add_collider(shape.restitution(e).restitution_combine_rule(rule), body)

        def combine(e: float, partner: float) -> float:
            return e * partner if exact else (e + partner) / 2

        def e_of_second(contact: int) -> float:
            return scene.partner_restitution if exact else scene.restitutions[contact]

        first: dict[int, ColliderHandle] = {}
        second: dict[int, ColliderHandle] = {}
        bodies: list[RigidBodyHandle] = []
        free = tuple(axis in SPACE_AXES[self.axes] for axis in range(3))
        velocities = in_space(np.array(scene.velocities), self.axes).tolist()
        for i, (mass, centre, v) in enumerate(zip(scene.masses, self.centres, velocities, strict=True)):
            body = (
                rapier.RigidBodyBuilder(rapier.RigidBodyType.DYNAMIC).additional_mass(mass).can_sleep(False)
            )
            body = body.translation(centre).linvel(tuple(v)).enabled_rotations((False, False, False))
            bodies.append(world.add_body(body.enabled_translations(free)))
            for contact, offset, is_first in self.spheres(i):
                e = scene.restitutions[contact] if is_first else e_of_second(contact)
                collider = add(rapier.Collider.ball(half), contact, offset, e, bodies[-1])
                (first if is_first else second)[contact] = collider
        for wall in self.walls:
            box = rapier.Collider.cuboid(50 * half, 50 * half, half)
            box = box.rotation((0, wall.angle, 0))
            middle = tuple((wall.point - half * wall.normal).tolist())
            second[wall.contact] = add(box, wall.contact, middle, e_of_second(wall.contact))
        self._world, self._set, self._bodies = world, world.rigid_bodies, bodies
        pairs = [(first[i], second[i], e) for i, e in enumerate(scene.restitutions)]
        self.effective = {
            "restitution": tuple(
                nearest_float32(
                    combine(world.colliders[above].restitution, world.colliders[below].restitution), e
                )
                for above, below, e in pairs
            ),
            "step": (nearest_float32(parameters.dt, scene.step),),
        }

    def step(self) -> tuple[list[float], list[float]]:
        """Take a step, and return the velocities in m/s and the coordinates of the balls' centres in m after it.

        A RuntimeError says that velocities or positions are no longer finite, because Rapier stops such bodies without
        a message.
        """
        self._world.step()
        if not self._world.quarantine.is_empty():
            raise RuntimeError("Rapier has put bodies into quarantine: numbers beyond single precision")
        bodies = [self._set[body] for body in self._bodies]
        if self.axes == 1:
            return [body.linvel.z for body in bodies], [body.translation.z for body in bodies]
        velocities = [number for body in bodies for number in (body.linvel.x, body.linvel.z)]
        return velocities, [number for body in bodies for number in (body.translation.x, body.translation.z)]


class Rapier(RigidEngine):
    """Rapier, with rigid contacts."""

    name, distribution, module, title = "rapier", "rapier3d", "rapier3d", "Rapier"
    shipped_step, made, knows_planes = 1 / 60, RapierWorld, True
