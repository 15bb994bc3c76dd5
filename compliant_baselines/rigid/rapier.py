"""Rapier, 3-D, in single precision: contacts are solved without restitution in sub-steps, then restitution once.

Coefficients of two colliders combine by a rule that is set: here their product, e below a ball and `partner` on what it
meets. Bodies move along one axis and do not turn. Iterations are as many as converge; the speed at which overlaps are
pushed out is 0, and the one that no body exceeds (400 lengths a second by default) a million times the fastest.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.rigid.lines import SINGLE, RigidEngine, RigidWorld, said


class RapierWorld(RigidWorld):
    """A world of its own."""

    resolution, accuracy = SINGLE, 1e-6

    def __init__(self, scene: Scene, radius: float) -> None:
        super().__init__(scene, radius)
        rapier: Any = import_module("rapier3d")
        world, half = rapier.PhysicsWorld(), self.radius / 2
        how = world.integration_parameters
        how.dt, how.length_unit, how.normalized_max_corrective_velocity = scene.step, self.radius, 0
        how.normalized_max_linear_velocity = 1e6 * scene.fastest / self.radius
        how.num_internal_pgs_iterations = how.num_internal_stabilization_iterations = self.sweeps

        def add(shape: Any, z: float, e: float, body: Any = None) -> Any:
            product = rapier.CoefficientCombineRule.MULTIPLY
            shape = shape.translation((0, 0, z)).density(0).friction(0)
            return world.add_collider(shape.restitution(e).restitution_combine_rule(product), body)

        below, lower, upper, bodies = (*scene.restitutions, 1.0), [], [], []
        for mass, z, v, e in zip(scene.masses, self.centres, scene.velocities, below, strict=False):
            body = (
                rapier.RigidBodyBuilder(rapier.RigidBodyType.DYNAMIC).additional_mass(mass).can_sleep(False)
            )
            body = body.translation((0, 0, z)).linvel((0, 0, v)).enabled_rotations((False, False, False))
            bodies.append(world.add_body(body.enabled_translations((False, False, True))))
            lower.append(add(rapier.Collider.ball(half), -half, e, bodies[-1]))
            upper.append(add(rapier.Collider.ball(half), half, self.partner, bodies[-1]))
        if scene.table:
            upper.append(add(rapier.Collider.cuboid(50 * half, 50 * half, half), -half, self.partner))
        self._world, self._set, self._bodies = world, world.rigid_bodies, bodies
        both = zip(lower, upper[1:], scene.restitutions, strict=False)
        of = [(world.colliders[a].restitution * world.colliders[b].restitution, e) for a, b, e in both]
        self.effective = {
            "restitution": tuple(said(*each) for each in of),
            "step": (said(how.dt, scene.step),),
        }

    def step(self) -> tuple[list[float], list[float]]:
        """Take a step; bodies whose numbers are no longer finite, Rapier stops without a word."""
        self._world.step()
        if not self._world.quarantine.is_empty():
            raise RuntimeError("Rapier has put bodies into quarantine: numbers beyond single precision")
        bodies = [self._set[body] for body in self._bodies]
        return [body.linvel.z for body in bodies], [body.translation.z for body in bodies]


class Rapier(RigidEngine):
    """Rapier."""

    name, distribution, module, title = "rapier", "rapier3d", "rapier3d", "Rapier"
    made = RapierWorld
