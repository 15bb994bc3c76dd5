"""PyBullet: the column as two spheres on a plane, one column at a time.

Set-up, and why (file names are those of Bullet's source, as PyBullet 3.2.7 ships it):

* Bodies in maximal coordinates (btRigidBody): a step costs 60 % of what it does with multibodies, and the
  default 100 m/s cap of a multibody's velocities does not exist.
* `useSplitImpulse=0`: with it, the default, a contact deeper than 0.04 m gets no force at all from its
  stiffness (btSequentialImpulseConstraintSolver.cpp), which breaks every soft contact and every scaling.
* `contactSlop=0`, `restitutionVelocityThreshold=0`, `solverResidualThreshold=0`: the defaults are absolute
  numbers.
* `contactBreakingThreshold` is `BREAKING_OVER_DEPTH` of the depth to be expected. The engine keeps a contact
  point until its gap exceeds this (default 0.02 m), and stops an approaching pair over such a gap ahead of
  touch; tied to the collision's own scale the contact of this adapter starts at touch, at any scale. Not 0: a
  point is also dropped when it wanders sideways by as much, and rounding makes it do so.
* The table is a plane: its contact with a sphere is exact at any depth, a box's is not.
* `numSolverIterations` is what sequential impulses need to converge to rounding, see `_iterations`.
* No sleeping, no damping, no friction, no rolling: everything stays on the vertical axis by symmetry.
* Velocities are read, heights are not: the engine's update is x += h v with the new v, to the last bit or
  two, and a read costs a seventh of a step.
* Everything is in SI units as asked; only the balls' radius is ours (`radius_of`).

A client is connected for a call and disconnected after it; each column starts from a reset world.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from compliant_baselines.column import Column, radius_of
from compliant_baselines.engine import EngineSolver
from compliant_baselines.mapping import PybulletBody, pybullet_bodies
from compliant_baselines.recording import Recorder, Run

#: Steps between two looks at whether the collision is over.
WINDOW = 256

#: Gap at which the engine forgets a contact point, over the depth to be expected; see the module.
BREAKING_OVER_DEPTH = 1e-6

#: The engine takes a step for none below the rounding of 1.0 (SIMD_EPSILON of btScalar.h).
SHORTEST_STEP = sys.float_info.epsilon

#: Impulse of a contact in one step, in N s, at which the engine caps it
#: (btSequentialImpulseConstraintSolver.cpp).
LARGEST_IMPULSE = 1e10


#: Diagonal in m of the box around a body at which the engine takes it out of the simulation, without a status
#: (btCollisionWorld.cpp, updateSingleAabb).
LARGEST_BODY = 1e6


class PybulletSolver(EngineSolver):
    """PyBullet, where it has wheels (CPython up to 3.11) or was built."""

    name = "pybullet"

    def version(self) -> str:
        """Version of the pybullet package."""
        try:
            return version("pybullet")
        except PackageNotFoundError:
            return ""

    def unavailable(self) -> str | None:
        """Why PyBullet cannot run here and the way out; None if it can."""
        try:
            import pybullet  # noqa: F401
        except ImportError as error:
            if sys.version_info >= (3, 12):
                return (
                    "PyBullet has no wheels beyond CPython 3.11: run with Python 3.11, or build it from "
                    "source (pip install --no-binary :all: pybullet)"
                )
            return f"PyBullet is not installed ({error}): run pip install pybullet"
        return None

    def refusal(self, column: Column) -> str | None:
        """Why PyBullet cannot take a column: one of its absolute numbers would replace what was asked."""
        if column.step <= SHORTEST_STEP:
            return (
                f"step = {column.step:.3g} s: PyBullet takes a step of {SHORTEST_STEP:.1e} s or less for none"
            )
        largest = max(abs(column.v1), abs(column.v2)) * (column.m1 + column.m2)
        if largest > LARGEST_IMPULSE:
            return f"m |v0| = {largest:.3g} N s: PyBullet caps a contact at {LARGEST_IMPULSE:.0e} N s a step"
        radius = radius_of(_depth(column))
        if 2 * math.sqrt(3) * radius > LARGEST_BODY:
            return (
                f"penetrations of up to {_depth(column):.3g} m ask for balls of radius {radius:.3g} m: "
                f"PyBullet drops bodies larger than {LARGEST_BODY:.0e} m; "
                "scale stiffnesses, masses or v0 (Theorem 5)"
            )
        return None

    def run_columns(self, columns: Sequence[Column], max_steps: int, record_path: bool = False) -> list[Run]:
        """Run every column until its collision is over or `max_steps` steps are taken; in order."""
        with _client() as client:
            return [_run(client, column, max_steps, record_path) for column in columns]


@contextmanager
def _client() -> Iterator[int]:
    import pybullet as p

    client = p.connect(p.DIRECT)
    if client < 0:
        raise RuntimeError("PyBullet gave no client: more than 1024 are connected in this process")
    try:
        yield client
    finally:
        p.disconnect(physicsClientId=client)


def _pairs(column: Column) -> tuple[PybulletBody, PybulletBody]:
    """Give stiffness and damping of contacts 1 and 2 as the engine combines them."""
    upper, lower, table = pybullet_bodies(column.contact1, column.contact2, column.mapping)
    return upper.against(lower), lower.against(table)


def _depth(column: Column) -> float:
    """Depth in m that no penetration exceeds."""
    pair1, pair2 = _pairs(column)
    return column.depth(pair1.stiffness, pair2.stiffness)


def _iterations(column: Column) -> int:
    """Count the iterations after which sequential impulses on this column are converged to rounding.

    One sweep over both contacts shrinks the error by g12^2/(g11 g22), with g the inverse-mass matrix of the
    two contacts and the engine's compliance 1/(h (h k + c)) on its diagonal (Gauss-Seidel on a 2x2 system):
    1e-5 at a step of 1/1000 of a period, 0.02 at 1/10.
    """
    pair1, pair2 = _pairs(column)
    h = column.step
    g11 = 1 / column.contact1.mass + 1 / (h * (h * pair1.stiffness + pair1.damping))
    g22 = 1 / column.m2 + 1 / (h * (h * pair2.stiffness + pair2.damping))
    shrink = 1 / (column.m2**2 * g11 * g22)
    # 36.7 = -ln(1.1e-16); two more, for the cap at zero force to settle which contacts act.
    return 2 + min(1000, max(2, math.ceil(36.7 / -math.log(shrink))))


def _build(client: int, column: Column) -> tuple[int, int, float, float, float]:
    """Set the column up in a reset world; give the ids and heights of B1 and B2, the support's stiffness."""
    import pybullet as p

    bodies = pybullet_bodies(column.contact1, column.contact2, column.mapping)
    k2 = bodies[1].against(bodies[2]).stiffness
    depth = _depth(column)
    radius = radius_of(depth)
    x1, x2 = column.start(column.m2 * column.gravity / k2, radius)
    p.resetSimulation(physicsClientId=client)
    p.setPhysicsEngineParameter(
        fixedTimeStep=column.step,
        numSubSteps=0,
        numSolverIterations=_iterations(column),
        solverResidualThreshold=0,
        contactSlop=0,
        contactBreakingThreshold=BREAKING_OVER_DEPTH * depth,
        restitutionVelocityThreshold=0,
        useSplitImpulse=0,
        physicsClientId=client,
    )
    p.setGravity(0, 0, -column.gravity, physicsClientId=client)
    plane = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
    sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=radius, physicsClientId=client)

    def add(mass: float, shape: int, z: float, stiffness: float, damping: float) -> int:
        body = p.createMultiBody(
            mass, shape, basePosition=(0, 0, z), useMaximalCoordinates=1, physicsClientId=client
        )
        p.changeDynamics(
            body,
            -1,
            contactStiffness=stiffness,
            contactDamping=damping,
            restitution=0,
            lateralFriction=0,
            spinningFriction=0,
            rollingFriction=0,
            linearDamping=0,
            angularDamping=0,
            contactProcessingThreshold=0,
            activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        return body

    upper, lower, table = bodies
    add(0, plane, 0, table.stiffness, table.damping)
    b2 = add(column.m2, sphere, radius + x2, lower.stiffness, lower.damping)
    b1 = add(column.m1, sphere, 3 * radius + x1, upper.stiffness, upper.damping)
    p.resetBaseVelocity(b1, (0, 0, column.v1), physicsClientId=client)
    p.resetBaseVelocity(b2, (0, 0, column.v2), physicsClientId=client)
    return b1, b2, x1, x2, k2


def _run(client: int, column: Column, max_steps: int, record_path: bool) -> Run:
    import pybullet as p

    b1, b2, x1, x2, k2 = _build(client, column)
    recorder = Recorder(column, x1, x2, k2, max_steps, record_path)
    step, read = p.stepSimulation, p.getBaseVelocity
    x = np.array([x1, x2])
    v = np.empty((WINDOW, 2))
    done, over = 0, False
    while not over and done < max_steps:
        n = min(WINDOW, max_steps - done)
        for i in range(n):
            step(client)
            v[i] = read(b1, client)[0][2], read(b2, client)[0][2]
        heights = x + column.step * np.cumsum(v[:n], axis=0)
        over = recorder.feed(v[:n], heights)
        x = heights[-1]
        done += n
    return recorder.finish()
