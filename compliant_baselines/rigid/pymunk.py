"""Pymunk (Chipmunk, 2-D): circles that do not turn, on a thick segment; iterated impulses in double precision.

The restitution of a contact is the product of the elasticities of its two shapes. `collision_bias` = 1 and
`collision_slop` = 0 leave overlaps as they are.
"""

from __future__ import annotations

from importlib import import_module
from math import inf
from typing import TYPE_CHECKING

from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.rigid.lines import RigidEngine, RigidWorld

if TYPE_CHECKING:
    from pymunk import Shape


class PymunkWorld(RigidWorld):
    """A space of its own."""

    def __init__(self, scene: Scene, radius: float) -> None:
        super().__init__(scene, radius)
        pymunk = import_module("pymunk")
        space = self._space = pymunk.Space()
        space.iterations, space.collision_slop, space.collision_bias = self.sweeps, 0, 1
        half, self._h = self.radius / 2, scene.step
        self._balls = [pymunk.Body(mass, inf) for mass in scene.masses]
        lower = [pymunk.Circle(ball, half, (0, -half)) for ball in self._balls]
        upper: list[Shape] = [pymunk.Circle(ball, half, (0, half)) for ball in self._balls]
        if scene.table:
            width = 100 * half
            upper.append(pymunk.Segment(space.static_body, (-width, -half), (width, -half), half))
        # The lowest ball may have nothing below.
        for shape, e in zip(lower, scene.restitutions, strict=False):
            shape.elasticity = e
        for shape in upper:
            shape.elasticity = scene.partner_restitution
        for ball, z, v in zip(self._balls, self.centres, scene.velocities, strict=True):
            ball.position, ball.velocity = (0, z), (0, v)
        space.add(*self._balls, *lower, *upper)
        pairs = zip(lower, upper[1:], strict=False)
        self.effective = {"restitution": tuple(above.elasticity * below.elasticity for above, below in pairs)}

    def step(self) -> tuple[list[float], list[float]]:
        """Take a step."""
        self._space.step(self._h)
        return [ball.velocity.y for ball in self._balls], [ball.position.y for ball in self._balls]


class Pymunk(RigidEngine):
    """Pymunk."""

    name = distribution = module = "pymunk"
    title = "Pymunk"
    made = PymunkWorld
