"""PyBullet with coefficients of restitution: sequential impulses in double precision, as most users run it.

PyBullet multiplies the coefficients of two bodies. A ball has two parts at the same place, a base and a link
(`engines.pybullet`). The base meets the ball below and has the restitution e of this contact. The link meets the ball
above and has `Settings.partner_restitution`. Overlaps are not corrected (`contactERP` = 0), and restitution has no
threshold.

With its default settings (`shipped`) PyBullet keeps all defaults except one: the damping of free flight is off.
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

#: Arguments that switch off the damping of free flight. With damping, velocities would change between impacts, which
#: would look like forces of contacts.
UNDAMPED = {"linearDamping": 0.0, "angularDamping": 0.0}


class BulletWorld(RigidWorld):
    """A scene in PyBullet: a plane and spheres in a connection, from which everything else is removed."""

    def __init__(self, scene: Scene, radius: float, p: Client) -> None:
        super().__init__(scene, radius)
        self._p = p
        p.resetSimulation()
        exact = scene.mapping != "shipped"
        # All scenes of a process share this threshold, and another scene may have changed it.
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
        """Take a step, and return the velocities in m/s and the heights of the balls' centres in m after it."""
        p, client = self._p.module, self._p.number
        p.stepSimulation(client)
        v = [p.getBaseVelocity(ball, client)[0][2] for ball in self._balls]
        return v, [p.getBasePositionAndOrientation(ball, client)[0][2] for ball in self._balls]


class PybulletRestitution(RigidEngine):
    """PyBullet with rigid contacts; each call opens its own connection."""

    name, distribution, module = "pybullet-restitution", "pybullet", "pybullet"
    title, way_out, shipped_step = "PyBullet", Pybullet.way_out, 1 / 240

    @contextmanager
    def running(self) -> Generator[None]:
        """Open a connection in which scenes are set up and run."""
        with connected() as self._client:
            yield

    def world(self, scene: Scene) -> BulletWorld:
        """Set up a scene in the open connection."""
        return BulletWorld(scene, self.radius(scene), self._client)
