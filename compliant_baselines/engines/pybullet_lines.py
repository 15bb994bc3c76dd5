"""PyBullet: N balls in a line, one line at a time.

PyBullet sets stiffness and damping per body, and a ball inside a line has two contacts. Two balls above a table get by
with a lower ball that is rigid and undamped; longer lines need a body for each side of a ball. So each ball is a
multibody without joints: its base, which meets the ball below, and a massless link fixed to it, at the same place,
which meets the ball above. The base carries the contact, the link is rigid and undamped, and filters let only these
pairs meet. A fixed link has no degree of freedom: nothing is added to the motion.

Else the set-up is that of `engines.pybullet_engine`, for its reasons. Every step is read, but in flight, where the
engine takes up to `STRIDE` sub-steps in a call; heights are those of the engine's update, x += h v with the new v.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.engines.column import radius_of
from impact_xval.compliant_baselines.engines.line import Line
from impact_xval.compliant_baselines.engines.lines import LineRecorder, LineRun
from impact_xval.compliant_baselines.engines.packages import import_pybullet
from impact_xval.compliant_baselines.engines.pybullet_setup import (
    LEAST_STRIDE,
    STRIDE,
    ZERO,
    exact,
    exact_contacts,
)
from impact_xval.compliant_baselines.engines.trajectory import GOING
from impact_xval.compliant_baselines.mapping import PYBULLET_RIGID

#: Steps between two looks at whether the collision is over.
WINDOW = 256

#: Largest speed in m/s of a multibody, whose default cap is 100.
LARGEST_SPEED = 1e30

#: Part of a ball: the base meets the ball below, the link the ball above.
BASE, LINK = -1, 0


def depth_of_line(line: Line) -> float:
    """Depth in m that no penetration exceeds."""
    return line.depth(*(contact.k for contact in line.contacts))


def _iterations(line: Line) -> int:
    """Count the iterations after which sequential impulses on this line are converged to rounding.

    As for two balls (`engines.pybullet_engine`): the spectral radius of Gauss and Seidel's iteration on a symmetric
    tridiagonal matrix is the square of that of Jacobi's.
    """
    inverse = [*(1 / m for m in line.masses), *([0.0] if line.table else [])]
    h = line.step
    diagonal = [
        inverse[i] + inverse[i + 1] + 1 / (h * (h * contact.k + contact.c))
        for i, contact in enumerate(line.contacts)
    ]
    if len(diagonal) < 2:
        return 4
    beside = [inverse[i + 1] / math.sqrt(diagonal[i] * diagonal[i + 1]) for i in range(len(diagonal) - 1)]
    shrink = float(np.abs(np.linalg.eigvalsh(np.diag(beside, 1) + np.diag(beside, -1))).max()) ** 2
    # 36.7 = -ln(1.1e-16); two more, for the cap at zero force to settle which contacts act.
    return 2 + min(1000, max(2, math.ceil(36.7 / -math.log(shrink))))


def run_line(client: int, line: Line, max_steps: int, record_path: bool = False) -> LineRun:
    """Run one line until its collision is over or `max_steps` steps are taken.

    Parameters
    ----------
    client : int
        A PyBullet client, whose bodies are removed.
    line : Line
    max_steps : int
    record_path : bool
        Whether to keep points of its path.
    """
    p, h = import_pybullet(), line.step
    radius = radius_of(depth_of_line(line))
    p.resetSimulation(physicsClientId=client)
    p.setPhysicsEngineParameter(
        fixedTimeStep=h,
        numSubSteps=0,
        numSolverIterations=_iterations(line),
        **exact_contacts(radius),
        physicsClientId=client,
    )
    p.setGravity(0, 0, 0, physicsClientId=client)
    x = line.heights(radius)
    balls = _make(p, client, line, radius, x)
    recorder = LineRecorder(line, max_steps, record_path)
    step, read, end = p.stepSimulation, p.getBaseVelocity, GOING
    while end == GOING and recorder.n_steps < max_steps:
        left = max_steps - recorder.n_steps
        n = min(recorder.flight_steps(x), left, STRIDE)
        if n >= LEAST_STRIDE:
            n = exact(n, h)
            p.setPhysicsEngineParameter(fixedTimeStep=n * h, numSubSteps=n, physicsClientId=client)
            step(client)
            p.setPhysicsEngineParameter(fixedTimeStep=h, numSubSteps=0, physicsClientId=client)
            x = recorder.skip(n, x)
            continue
        rows = []
        for _ in range(min(WINDOW, left)):
            step(client)
            rows.append([read(ball, client)[0][2] for ball in balls])
        v = np.array(rows)
        heights = x + h * np.cumsum(v, axis=0)
        end, x = recorder.feed(v, heights), heights[-1]
    return recorder.finish()


def _make(p: Any, client: int, line: Line, radius: float, x: NDArray[np.float64]) -> list[int]:
    """Make table and balls, at these heights in m; the balls, the upper one first."""
    n = len(line.masses)
    sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=radius, physicsClientId=client)
    balls = []
    for i, (mass, velocity) in enumerate(zip(line.masses, line.velocities, strict=True)):
        ball = p.createMultiBody(
            mass,
            sphere,
            basePosition=(0, 0, (2 * (n - i) - 1) * radius + x[i]),
            linkMasses=[0],
            linkCollisionShapeIndices=[sphere],
            linkVisualShapeIndices=[-1],
            linkPositions=[(0, 0, 0)],
            linkOrientations=[(0, 0, 0, 1)],
            linkInertialFramePositions=[(0, 0, 0)],
            linkInertialFrameOrientations=[(0, 0, 0, 1)],
            linkParentIndices=[0],
            linkJointTypes=[p.JOINT_FIXED],
            linkJointAxis=[(0, 0, 1)],
            physicsClientId=client,
        )
        p.resetBaseVelocity(ball, (0, 0, velocity), (0, 0, 0), physicsClientId=client)
        balls.append(ball)
    sides = [(ball, part) for ball in balls for part in (BASE, LINK)]
    lower = [(ball, LINK) for ball in balls[1:]]
    if line.table:
        plane = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
        table = p.createMultiBody(0, plane, physicsClientId=client)
        sides.append((table, BASE))
        lower.append((table, BASE))
    for body, part in sides:
        p.changeDynamics(
            body,
            part,
            **dict.fromkeys(ZERO, 0),
            maxJointVelocity=LARGEST_SPEED,
            activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        p.setCollisionFilterGroupMask(body, part, 0, 0, physicsClientId=client)
    for ball, (body, part), contact in zip(balls, lower, line.contacts, strict=False):
        _set_contact(p, client, ball, BASE, contact.k, contact.c)
        _set_contact(p, client, body, part, PYBULLET_RIGID, 0.0)
        p.setCollisionFilterPair(ball, body, BASE, part, 1, physicsClientId=client)
    return balls


def _set_contact(p: Any, client: int, body: int, part: int, stiffness: float, damping: float) -> None:
    p.changeDynamics(body, part, contactStiffness=stiffness, contactDamping=damping, physicsClientId=client)
