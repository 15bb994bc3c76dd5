"""DART (dartpy): balls and table as skeletons, a boxed LCP over all contacts at once.

What it does with restitution (dart/constraint/ContactConstraint.cpp and ContactSurface.cpp): coefficients of the two
bodies are multiplied; an approach of which e times the speed is 0.1 m/s or less (DART_BOUNCING_VELOCITY_THRESHOLD)
does not bounce. The diagonal of the LCP is softened by 1e-5 (DART_CFM), which is what a single contact of e = 1 lacks
of 1; overlapping bodies are pushed apart by up to 0.001 m/s (DART_MAX_ERV), which stays in their velocities. A contact
is there once bodies touch or overlap, so that which contacts bounce *together* is decided by gaps of a rounding.

Collisions are detected by the engine's own detector (`DARTCollisionDetector`), which knows spheres and boxes exactly;
the table is a box, as in its examples. The step of 1 ms is the engine's default.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.practical.mixing import factors
from impact_xval.compliant_baselines.practical.practice import RADIUS, Arrangement, Practice
from impact_xval.model.columns.column import Column

#: Edge of the table, in m.
TABLE = 4.0


class Dart(Practice):
    """DART as it is shipped, without gravity."""

    name = "dart"
    settings = "as shipped; coefficients multiply; no bounce where e times the speed is below 0.1 m/s"
    engine = "DART"
    distribution = "dartpy"
    module = "dartpy"
    default_step = 1e-3

    def load(self) -> object:
        """Import it."""
        return import_module("dartpy")

    def refuses(self, column: Column) -> str | None:
        """Products of what two bodies have cannot be any coefficients."""
        return no_factors(column)

    @contextmanager
    def world(self, column: Column, arrangement: Arrangement) -> Iterator[_World]:
        """Make the column."""
        yield _World(column, arrangement)


def no_factors(column: Column) -> str | None:
    """Why no coefficients of bodies have these products, in one sentence; None if some do."""
    if factors(column.restitutions) is not None:
        return None
    return (
        f"restitutions = {column.restitutions!r}: the engine multiplies the coefficients of two bodies, and no "
        "coefficients from 0 to 1 have these products; legal: equal ones, or at most two contacts"
    )


class _World:
    def __init__(self, column: Column, arrangement: Arrangement) -> None:
        dart: Any = import_module("dartpy")
        self._world = dart.simulation.World()
        self._world.setGravity([0.0, 0.0, 0.0])
        self._world.setTimeStep(arrangement.step)
        self._world.getConstraintSolver().setCollisionDetector(dart.collision.DARTCollisionDetector())
        bounces = factors(column.restitutions) or ()
        heights = arrangement.heights(column)
        self._balls: dict[int, Any] = {}
        for i in arrangement.order(column):
            if i == len(column.masses):
                middle = arrangement.floor() - 0.5 * TABLE
                self._add(dart, "table", dart.dynamics.BoxShape([TABLE] * 3), middle, bounces[i])
            else:
                joint = self._add(
                    dart, f"B{i + 1}", dart.dynamics.SphereShape(RADIUS), heights[i], bounces[i]
                )
                body = joint.getChildBodyNode()
                inertia = 0.4 * column.masses[i] * RADIUS**2 * np.eye(3)
                body.setInertia(dart.dynamics.Inertia(column.masses[i], np.zeros(3), inertia))
                joint.setVelocities([0, 0, 0, 0, 0, column.velocities[i]])
                self._balls[i] = body

    def _add(self, dart: Any, name: str, shape: Any, height: float, bounce: float) -> Any:
        """Add a body, and give the joint it hangs on."""
        skeleton = dart.dynamics.Skeleton(name)
        fixed = name == "table"
        make = skeleton.createWeldJointAndBodyNodePair if fixed else skeleton.createFreeJointAndBodyNodePair
        joint, body = make(None)
        place = np.eye(4)
        place[2, 3] = height
        joint.setTransformFromParentBodyNode(dart.math.Isometry3(place))
        node = body.createShapeNode(shape)
        node.createCollisionAspect()
        surface = node.createDynamicsAspect()
        surface.setRestitutionCoeff(bounce)
        surface.setFrictionCoeff(0.0)
        self._world.addSkeleton(skeleton)
        return joint

    def step(self) -> None:
        self._world.step()

    def velocities(self) -> Sequence[float]:
        return [self._balls[i].getLinearVelocity()[2] for i in range(len(self._balls))]
