"""Rapier, 3-D, in single precision: contacts are solved without restitution in sub-steps, then restitution once.

The adapter makes Rapier multiply the coefficients of two colliders. Bodies move along one axis and do not turn. The
solver iterates until it has converged. Overlaps are not pushed out. Rapier caps the speed of bodies, by default at 400
lengths a second; here the cap is a million times the fastest ball.

Run as it ships, Rapier keeps all its parameters and takes the mean of two coefficients, so both colliders of a contact
have its e.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Protocol, Self

from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.rigid.lines import SINGLE, RigidEngine, RigidWorld, nearest_float32

if TYPE_CHECKING:
    from rapier3d import ColliderHandle, RigidBodyHandle


class RapierShape(Protocol):
    """What the adapter calls of `rapier3d.ColliderBuilder`; every call returns the builder."""

    def translation(self, v: tuple[float, float, float], /) -> Self:
        """Place the shape in its body; in m."""
        ...

    def density(self, d: float, /) -> Self:
        """Set the density in kg/m^3."""
        ...

    def friction(self, f: float, /) -> Self:
        """Set the coefficient of friction."""
        ...

    def restitution(self, r: float, /) -> Self:
        """Set the coefficient of restitution."""
        ...

    def restitution_combine_rule(self, rule: object, /) -> Self:
        """Set how the coefficients of two shapes are combined."""
        ...


class RapierWorld(RigidWorld):
    """A world of its own."""

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
            shape: RapierShape, z: float, e: float, body: RigidBodyHandle | None = None
        ) -> ColliderHandle:
            shape = shape.translation((0, 0, z)).density(0).friction(0)
            return world.add_collider(shape.restitution(e).restitution_combine_rule(rule), body)

        def combine(e: float, partner: float) -> float:
            return e * partner if exact else (e + partner) / 2

        e_below = (*scene.restitutions, 1.0)  # the lowest ball may have nothing below
        # Of the upper side of each body; the first ball has nothing above.
        partner = scene.partner_restitution
        e_above = [partner] * (len(scene.masses) + 1) if exact else [1.0, *scene.restitutions]
        lower: list[ColliderHandle] = []
        upper: list[ColliderHandle] = []
        bodies: list[RigidBodyHandle] = []
        for i, (mass, z, v) in enumerate(zip(scene.masses, self.centres, scene.velocities, strict=True)):
            body = (
                rapier.RigidBodyBuilder(rapier.RigidBodyType.DYNAMIC).additional_mass(mass).can_sleep(False)
            )
            body = body.translation((0, 0, z)).linvel((0, 0, v)).enabled_rotations((False, False, False))
            bodies.append(world.add_body(body.enabled_translations((False, False, True))))
            lower.append(add(rapier.Collider.ball(half), -half, e_below[i], bodies[-1]))
            upper.append(add(rapier.Collider.ball(half), half, e_above[i], bodies[-1]))
        if scene.table:
            upper.append(add(rapier.Collider.cuboid(50 * half, 50 * half, half), -half, e_above[-1]))
        self._world, self._set, self._bodies = world, world.rigid_bodies, bodies
        pairs = zip(lower, upper[1:], scene.restitutions, strict=False)
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
        """Take a step.

        A RuntimeError says that numbers are no longer finite: Rapier itself only stops such bodies, silently.
        """
        self._world.step()
        if not self._world.quarantine.is_empty():
            raise RuntimeError("Rapier has put bodies into quarantine: numbers beyond single precision")
        bodies = [self._set[body] for body in self._bodies]
        return [body.linvel.z for body in bodies], [body.translation.z for body in bodies]


class Rapier(RigidEngine):
    """Rapier."""

    name, distribution, module, title = "rapier", "rapier3d", "rapier3d", "Rapier"
    shipped_step, made = 1 / 60, RapierWorld
