"""PyBullet with `restitution`: sequential impulses in double precision, as most of its users run it.

Coefficients of two bodies multiply: e on a ball's base, which meets the ball below, `partner` on its link, which meets
the ball above (`engines.pybullet`). No correction of overlaps (`contactERP` = 0), no threshold of restitution, unless
it is run as it ships: then only the damping of velocities in free flight is switched off.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from impact_xval.compliant_baselines.engines.packages import import_quietly
from impact_xval.compliant_baselines.engines.pybullet import (
    BASE,
    EXACT,
    FIXED,
    FREE,
    LINK,
    Pybullet,
    connected,
)
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.rigid.lines import RigidEngine, RigidWorld

#: Distance in m at which it drops a contact, as it ships (gContactBreakingThreshold of btPersistentManifold.cpp).
SHIPPED_BREAKING = 0.02

#: Velocities that fall between impacts would count as forces of contacts.
UNDAMPED = {"linearDamping": 0.0, "angularDamping": 0.0}


class BulletWorld(RigidWorld):
    """Plane and spheres in a client, which is emptied first."""

    def __init__(self, scene: Scene, client: int) -> None:
        super().__init__(scene)
        p: Any = import_quietly("pybullet")
        self._p, self._client = p, client
        on = {"physicsClientId": client}
        p.resetSimulation(**on)
        exact = scene.mapping != "shipped"
        how: dict[str, Any] = (
            {"numSolverIterations": self.sweeps, "erp": 0, "contactERP": 0, **EXACT} if exact else {}
        )
        # The threshold is the process's: another scene may have set it.
        how["contactBreakingThreshold"] = 1e-4 * self.radius if exact else SHIPPED_BREAKING
        p.setPhysicsEngineParameter(fixedTimeStep=scene.step, numSubSteps=0, **how, **on)
        sphere = p.createCollisionShape(p.GEOM_SPHERE, self.radius, **on)
        link = {**FIXED, "linkCollisionShapeIndices": [sphere], "linkJointTypes": [p.JOINT_FIXED]}
        self._balls = [
            p.createMultiBody(mass, sphere, basePosition=(0, 0, z), **link, **on)
            for mass, z in zip(scene.masses, self.centres, strict=True)
        ]
        bodies = [(ball, LINK) for ball in self._balls]
        if scene.table:
            plane = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE, **on), **on)
            bodies.append((plane, BASE))
        for body, part in [*((ball, BASE) for ball in self._balls), *bodies]:
            p.changeDynamics(body, part, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING, **on)
            p.changeDynamics(body, part, **(FREE if exact else UNDAMPED), **on)
            p.changeDynamics(body, part, restitution=self.partner, **on)
            p.setCollisionFilterGroupMask(body, part, 0, 0, **on)
        said = []
        for ball, above, e in zip(self._balls, bodies[1:], scene.restitutions, strict=False):
            p.changeDynamics(ball, BASE, restitution=e, **on)
            p.setCollisionFilterPair(ball, above[0], BASE, above[1], 1, **on)
            said.append(p.getDynamicsInfo(ball, BASE, client)[5] * p.getDynamicsInfo(*above, client)[5])
        for ball, v in zip(self._balls, scene.velocities, strict=True):
            p.resetBaseVelocity(ball, (0, 0, v), (0, 0, 0), **on)
        step = p.getPhysicsEngineParameters(client)["fixedTimeStep"]
        self.effective = {"restitution": tuple(said), "step": (step,)}

    def step(self) -> tuple[list[float], list[float]]:
        """Take a step."""
        p, client = self._p, self._client
        p.stepSimulation(client)
        v = [p.getBaseVelocity(ball, client)[0][2] for ball in self._balls]
        return v, [p.getBasePositionAndOrientation(ball, client)[0][2] for ball in self._balls]


class PybulletRestitution(RigidEngine):
    """PyBullet, rigid; a client is connected for a call."""

    name, distribution, module = "pybullet-restitution", "pybullet", "pybullet"
    title, way_out, shipped_step = "PyBullet", Pybullet.way_out, 1 / 240

    @contextmanager
    def running(self) -> Iterator[None]:
        """Connect a client."""
        with connected() as self._client:
            yield

    def world(self, scene: Scene) -> BulletWorld:
        """Set a scene up."""
        return BulletWorld(scene, self._client)
