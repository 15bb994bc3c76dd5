"""PyBullet with `restitution`: sequential impulses in double precision, the way in which most users run it.

PyBullet multiplies the coefficients of two bodies. The base of a ball meets the ball below and has the e of that
contact; its link meets the ball above and has `Settings.partner_restitution` (`engines.pybullet`). Overlaps are not
corrected (`contactERP` = 0), and restitution has no threshold.

Run with its defaults (`shipped`), PyBullet keeps all defaults but one: the damping of velocities in free flight is
switched off.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from impact_xval.compliant_baselines.engines.pybullet import (
    BASE,
    EXACT,
    FIXED,
    FREE,
    LINK,
    Client,
    Pybullet,
    connected,
)
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.rigid.lines import RigidEngine, RigidWorld

#: Distance in m at which PyBullet drops a contact by default (gContactBreakingThreshold, btPersistentManifold.cpp).
SHIPPED_BREAKING = 0.02

#: No damping in free flight: changes of velocity between impacts would look like forces of contacts.
UNDAMPED = {"linearDamping": 0.0, "angularDamping": 0.0}


class BulletWorld(RigidWorld):
    """A plane and spheres in a client, which is emptied first."""

    def __init__(self, scene: Scene, radius: float, p: Client) -> None:
        super().__init__(scene, radius)
        self._p = p
        p.resetSimulation()
        exact = scene.mapping != "shipped"
        # The whole process has one threshold, which another scene may have set.
        parameters: dict[str, float] = {"contactBreakingThreshold": SHIPPED_BREAKING}
        if exact:
            parameters["contactBreakingThreshold"] = 1e-4 * self.radius
            parameters |= {"numSolverIterations": self.sweeps, "erp": 0, "contactERP": 0, **EXACT}
        p.setPhysicsEngineParameter(fixedTimeStep=scene.step, numSubSteps=0, **parameters)
        sphere = p.createCollisionShape(p.GEOM_SPHERE, self.radius)
        link = {**FIXED, "linkCollisionShapeIndices": [sphere], "linkJointTypes": [p.JOINT_FIXED]}
        self._balls = [
            p.createMultiBody(mass, sphere, basePosition=centre, **link)
            for mass, centre in zip(scene.masses, self.centres, strict=True)
        ]
        bodies = [(ball, LINK) for ball in self._balls]
        if scene.table:
            plane = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE))
            bodies.append((plane, BASE))
        for body, part in [*((ball, BASE) for ball in self._balls), *bodies]:
            p.changeDynamics(body, part, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING)
            p.changeDynamics(body, part, **(FREE if exact else UNDAMPED))
            p.changeDynamics(body, part, restitution=scene.partner_restitution)
            p.setCollisionFilterGroupMask(body, part, 0, 0)
        products: list[float] = []
        for ball, (body, part), e in zip(self._balls, bodies[1:], scene.restitutions, strict=False):
            p.changeDynamics(ball, BASE, restitution=e)
            p.setCollisionFilterPair(ball, body, BASE, part, 1)
            products.append(p.getDynamicsInfo(ball, BASE)[5] * p.getDynamicsInfo(body, part)[5])
        for ball, v in zip(self._balls, scene.velocities, strict=True):
            p.resetBaseVelocity(ball, (0, 0, v), (0, 0, 0))
        self.effective = {
            "restitution": tuple(products),
            "step": (p.getPhysicsEngineParameters()["fixedTimeStep"],),
        }

    def step(self) -> tuple[list[float], list[float]]:
        """Take a step."""
        p, client = self._p.module, self._p.number
        p.stepSimulation(client)
        v = [p.getBaseVelocity(ball, client)[0][2] for ball in self._balls]
        return v, [p.getBasePositionAndOrientation(ball, client)[0][2] for ball in self._balls]


class PybulletRestitution(RigidEngine):
    """PyBullet with rigid contacts; each call connects its own client."""

    name, distribution, module = "pybullet-restitution", "pybullet", "pybullet"
    title, way_out, shipped_step = "PyBullet", Pybullet.way_out, 1 / 240

    @contextmanager
    def running(self) -> Generator[None]:
        """Connect a client."""
        with connected() as self._client:
            yield

    def world(self, scene: Scene) -> BulletWorld:
        """Set up a scene."""
        return BulletWorld(scene, self.radius(scene), self._client)
