"""PyBullet at the step of 1/240 s that it ships, with restitution, or with stiffness and damping as documented.

**Restitution** (btManifoldResult.cpp): coefficients of two bodies are multiplied; a contact slower than
`restitutionVelocityThreshold`, 0.2 m/s by default, does not bounce (btSequentialImpulseConstraintSolver.cpp).

**Stiffness** (PyBullet Quickstart Guide, `changeDynamics`): contactStiffness and contactDamping of a body, set on both.
The guide does not say how two bodies combine: stiffnesses in series, so that two equal bodies are half as stiff,
dampings added. Ball i is given what contact i asks for, the last ball above a table what the ball above it has.

Everything else is as it is shipped, but friction and the damping of velocities (0.04 of them a second), which are 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from impact_xval.compliant_baselines.contract.registry import KELVIN_VOIGT
from impact_xval.compliant_baselines.engines.packages import import_pybullet
from impact_xval.compliant_baselines.engines.pybullet_engine import PybulletSolver
from impact_xval.compliant_baselines.engines.pybullet_setup import connected
from impact_xval.compliant_baselines.practical.dart import no_factors
from impact_xval.compliant_baselines.practical.mixing import factors
from impact_xval.compliant_baselines.practical.practice import (
    RADIUS,
    Arrangement,
    Practice,
    springs,
    without_spring,
)
from impact_xval.model.columns.column import Column

#: contactBreakingThreshold in m as it is shipped. It is one number of the process (gContactBreakingThreshold of
#: btPersistentManifold.cpp), which a client leaves to the next: the calibrated adapter sets it to next to nothing.
SHIPPED_BREAKING = 0.02


class _Bullet(Practice):
    engine = "Bullet"
    distribution = "pybullet"
    module = "pybullet"
    default_step = 1 / 240

    def unavailable(self) -> str | None:
        """As of the calibrated adapter: wheels end at CPython 3.11."""
        return PybulletSolver().unavailable()

    def load(self) -> object:
        """Import it."""
        return import_pybullet()

    def surfaces(self, column: Column) -> list[dict[str, float]]:
        """Give what `changeDynamics` is told of each body, the table last."""
        raise NotImplementedError

    @contextmanager
    def world(self, column: Column, arrangement: Arrangement) -> Iterator[_World]:
        """Make the column in a client of its own."""
        with connected() as client:
            yield _World(client, column, arrangement, self.surfaces(column))


class BulletRestitution(_Bullet):
    """PyBullet with restitution."""

    name = "pybullet-restitution"
    settings = "as shipped, with restitution; coefficients multiply; no bounce below 0.2 m/s"

    def refuses(self, column: Column) -> str | None:
        """Products of what two bodies have cannot be any coefficients."""
        return no_factors(column)

    def surfaces(self, column: Column) -> list[dict[str, float]]:
        """Restitution of each body."""
        return [{"restitution": bounce} for bounce in factors(column.restitutions) or ()]


class BulletDocumented(_Bullet):
    """PyBullet with contactStiffness and contactDamping on both bodies of a contact."""

    name = "pybullet-documented"
    settings = "contactStiffness and contactDamping asked for on both bodies; else as shipped"
    takes = ("restitution", "stiffness")
    law = KELVIN_VOIGT

    def refuses(self, column: Column) -> str | None:
        """No dashpot is perfectly plastic."""
        return without_spring(column)

    def surfaces(self, column: Column) -> list[dict[str, float]]:
        """Stiffness and damping of each body."""
        contacts, last = springs(column).contacts, max(1, len(column.masses) - 1)
        given = [contacts[min(i, last - 1)] for i in range(len(column.masses))]
        given += contacts[-1:] if column.table else []
        return [{"contactStiffness": contact.k, "contactDamping": contact.c} for contact in given]


class _World:
    def __init__(
        self, client: int, column: Column, arrangement: Arrangement, surfaces: Sequence[dict[str, float]]
    ) -> None:
        self._p: Any = import_pybullet()
        p, self._client = self._p, client
        p.setPhysicsEngineParameter(
            fixedTimeStep=arrangement.step, contactBreakingThreshold=SHIPPED_BREAKING, physicsClientId=client
        )
        heights = arrangement.heights(column)
        self._balls: dict[int, int] = {}
        for i in arrangement.order(column):
            if i == len(column.masses):
                plane = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
                floor = (0.0, 0.0, arrangement.floor())
                body = p.createMultiBody(0, plane, basePosition=floor, physicsClientId=client)
            else:
                sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=RADIUS, physicsClientId=client)
                place = (0.0, 0.0, heights[i])
                body = p.createMultiBody(column.masses[i], sphere, basePosition=place, physicsClientId=client)
                p.resetBaseVelocity(body, (0.0, 0.0, column.velocities[i]), physicsClientId=client)
                self._balls[i] = body
            free = {"lateralFriction": 0.0, "linearDamping": 0.0, "angularDamping": 0.0}
            p.changeDynamics(body, -1, **free, **surfaces[i], physicsClientId=client)

    def step(self) -> None:
        self._p.stepSimulation(self._client)

    def velocities(self) -> Sequence[float]:
        read = self._p.getBaseVelocity
        return [read(self._balls[i], self._client)[0][2] for i in range(len(self._balls))]
