"""Rapier (rapier3d): rigid bodies in single precision, solver "TGS-soft".

Coefficients of restitution are combined by a rule that each collider names: the mean by default, the product here,
which can have any two coefficients. The solver takes four substeps a step, in which contacts are soft
(`contact_softness` of the integration parameters), and restitution is added after them. The default step is 1/60 s.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from impact_xval.compliant_baselines.practical.dart import no_factors
from impact_xval.compliant_baselines.practical.mixing import factors
from impact_xval.compliant_baselines.practical.practice import RADIUS, Arrangement, Practice
from impact_xval.model.columns.column import Column


class Rapier(Practice):
    """Rapier as it is shipped, but for the rule by which coefficients combine."""

    name = "rapier"
    settings = "as shipped, but that restitutions multiply"
    engine = "Rapier"
    distribution = "rapier3d"
    module = "rapier3d"
    precision = "float32"
    default_step = 1 / 60

    def load(self) -> object:
        """Import it."""
        return import_module("rapier3d")

    def refuses(self, column: Column) -> str | None:
        """Products of what two bodies have cannot be any coefficients."""
        return no_factors(column)

    @contextmanager
    def world(self, column: Column, arrangement: Arrangement) -> Iterator[_World]:
        """Make the column."""
        yield _World(column, arrangement)


class _World:
    def __init__(self, column: Column, arrangement: Arrangement) -> None:
        rapier: Any = import_module("rapier3d")
        self._world = rapier.PhysicsWorld()
        self._world.integration_parameters.dt = arrangement.step
        bounces = factors(column.restitutions) or ()
        heights = arrangement.heights(column)
        self._handles: dict[int, Any] = {}
        for i in arrangement.order(column):
            surface = {
                "restitution": bounces[i],
                "restitution_combine_rule": rapier.CoefficientCombineRule.MULTIPLY,
                "friction": 0.0,
            }
            if i == len(column.masses):
                floor = (0.0, 0.0, arrangement.floor())
                table = rapier.Collider.halfspace((0.0, 0.0, 1.0), translation=floor, **surface)
                self._world.add_collider(table)
            else:
                ball = rapier.Collider.ball(RADIUS, mass=column.masses[i], **surface)
                body = rapier.RigidBody.dynamic(
                    translation=(0.0, 0.0, heights[i]), linvel=(0.0, 0.0, column.velocities[i])
                )
                self._handles[i] = self._world.add_body(body, colliders=[ball])

    def step(self) -> None:
        self._world.step()

    def velocities(self) -> Sequence[float]:
        bodies = self._world.rigid_bodies
        return [bodies[self._handles[i]].linvel.z for i in range(len(self._handles))]
