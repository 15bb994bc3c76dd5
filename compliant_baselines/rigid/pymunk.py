"""Pymunk (Chipmunk, 2-D): circles that do not turn, on thick segments, by sequential impulses in double precision.

The restitution of a contact is the product of the elasticities of its two shapes. `collision_bias` = 1 and
`collision_slop` = 0 leave overlaps unchanged. Filters let only the two shapes of a contact meet.
"""

from __future__ import annotations

from importlib import import_module
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from impact_xval.compliant_baselines.engines.arrangement import in_space
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.rigid.lines import PLANE_WIDER, RigidEngine, RigidWorld, filter_bit

if TYPE_CHECKING:
    from pymunk import Shape


class PymunkWorld(RigidWorld):
    """A scene in its own `Space` of Pymunk."""

    def __init__(self, scene: Scene, radius: float) -> None:
        super().__init__(scene, radius)
        pymunk = import_module("pymunk")
        space = self._space = pymunk.Space()
        space.iterations, space.collision_slop, space.collision_bias = self.sweeps, 0, 1
        half, self._h = self.radius / 2, scene.step
        self._balls = [pymunk.Body(mass, inf) for mass in scene.masses]
        first: dict[int, Shape] = {}
        second: dict[int, Shape] = {}
        for number, ball in enumerate(self._balls):
            for contact, (x, _, z), is_first in self.spheres(number):
                (first if is_first else second)[contact] = pymunk.Circle(ball, half, (x, z))
        for contact, (px, _, pz), (nx, _, nz) in self.walls:
            width, x, z = 100 * half, px - half * nx, pz - half * nz
            ends = (x - width * nz, z + width * nx), (x + width * nz, z - width * nx)
            second[contact] = pymunk.Segment(space.static_body, *ends, half)
        for contact, e in enumerate(scene.restitutions):
            first[contact].elasticity = e
            second[contact].elasticity = scene.partner_restitution
            for shape in (first[contact], second[contact]):
                shape.filter = pymunk.ShapeFilter(categories=filter_bit(contact), mask=filter_bit(contact))
        velocities = in_space(np.array(scene.velocities), self.axes).tolist()
        for ball, (x, _, z), (vx, _, vz) in zip(self._balls, self.centres, velocities, strict=True):
            ball.position, ball.velocity = (x, z), (vx, vz)
        contacts = range(len(scene.restitutions))
        space.add(*self._balls, *(first[i] for i in contacts), *(second[i] for i in contacts))
        self.effective = {"restitution": tuple(first[i].elasticity * second[i].elasticity for i in contacts)}

    def step(self) -> tuple[list[float], list[float]]:
        """Take a step, and return the velocities in m/s and the coordinates of the balls' centres in m after it."""
        self._space.step(self._h)
        if self.axes == 1:
            return [ball.velocity.y for ball in self._balls], [ball.position.y for ball in self._balls]
        velocities = [number for ball in self._balls for number in ball.velocity]
        return velocities, [number for ball in self._balls for number in ball.position]


class Pymunk(RigidEngine):
    """Pymunk, with rigid contacts."""

    name = distribution = module = "pymunk"
    title = "Pymunk"
    made, knows_planes, plane_wider = PymunkWorld, True, PLANE_WIDER
