"""PyBullet: the column as two spheres on a plane, one column at a time.

Set-up, and why (file names are those of Bullet's source, as PyBullet 3.2.7 ships it):

* Bodies in maximal coordinates (btRigidBody): a step costs 60 % of what it does with multibodies, and the
  default 100 m/s cap of a multibody's velocities does not exist.
* `useSplitImpulse=0`: with it, the default, a contact deeper than 0.04 m gets no force at all from its
  stiffness (btSequentialImpulseConstraintSolver.cpp), which breaks every soft contact and every scaling.
* `contactSlop=0`, `restitutionVelocityThreshold=0`, `solverResidualThreshold=0`: the defaults are absolute
  numbers.
* `contactBreakingThreshold` is `BREAKING_OVER_RADIUS` of the radius, a millionth of the depth to be expected.
  The engine keeps a contact point until its gap exceeds this (default 0.02 m), and stops an approaching pair over
  such a gap ahead of touch; tied to the collision's own scale the contact of this adapter starts at touch, at any
  scale. Not 0: a point is also dropped when it wanders sideways by as much, and rounding makes it do so.
* The table is a plane: its contact with a sphere is exact at any depth, a box's is not.
* `numSolverIterations` is what sequential impulses need to converge to rounding, see `_iterations`.
* No sleeping, no damping, no friction, no rolling: everything stays on the vertical axis by symmetry.
* Heights of single steps are not read: the engine's update is x += h v with the new v, to the last bit or two.
* Everything is in SI units as asked; only the balls' radius is ours (`radius_of`).

How it is stepped: a call from Python and two reads cost more than the step itself. Where nothing can happen
(`engines.quiet`) the engine therefore takes up to `STRIDE` sub-steps in one call, with a bit for
bit identical result: their number is one by which the time of the call divides to the step exactly (`exact`).
A run that records its path takes up to `PATH_STRIDE`. About events, and at the end, every step is read.

A client is connected for a call and serves all of its columns; it is disconnected afterwards. Connecting costs a
thousandth of a chunk of cells, and a client that was kept would be client 0 to whoever else uses PyBullet in this
process and names none.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

import numpy as np

from impact_xval.compliant_baselines.engines.column import Column, radius_of
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.compliant_baselines.engines.line import Line
from impact_xval.compliant_baselines.engines.lines import LineRun
from impact_xval.compliant_baselines.engines.packages import import_pybullet, why_not
from impact_xval.compliant_baselines.engines.pybullet_lines import depth_of_line, run_line
from impact_xval.compliant_baselines.engines.pybullet_setup import (
    LEAST_STRIDE,
    STRIDE,
    ZERO,
    connected,
    exact,
    exact_contacts,
)
from impact_xval.compliant_baselines.engines.quiet import EngineContacts
from impact_xval.compliant_baselines.engines.recording import Recorder, Run
from impact_xval.compliant_baselines.engines.trajectory import FLIGHT, GOING, Floats
from impact_xval.compliant_baselines.mapping import PybulletBody, pybullet_bodies

#: Single steps between two looks at what comes next: the first time, and most.
SHORT_WINDOW, WINDOW = 8, 256

#: `STRIDE` for a run that records its path, which is interpolated in between (`Recorder.skip`).
PATH_STRIDE = 32

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
    distribution = "pybullet"

    def unavailable(self) -> str | None:
        """Why PyBullet cannot run here and the way out; None if it can."""
        way_out = "run pip install 'pybullet>=3.2.7'"
        if sys.version_info >= (3, 12):
            way_out = (
                "it has no wheels beyond CPython 3.11: run with Python 3.11, or build it from source "
                "(pip install --no-binary :all: pybullet)"
            )
        return why_not("PyBullet", self.distribution, import_pybullet, way_out)

    def own_refusal(self, column: Column) -> str | None:
        """Why PyBullet cannot take a column: one of its absolute numbers would replace what was asked."""
        return _beyond(column, depth_of(column))

    def line_refusal(self, line: Line) -> str | None:
        """Why PyBullet cannot take a line: as for two balls, and the naive mapping, which is of two balls."""
        if line.mapping != "calibrated":
            return (
                f"mapping = {line.mapping!r}: PyBullet's is that of two balls on a table; legal: 'calibrated'"
            )
        return _beyond(line, depth_of_line(line))

    def run_lines(self, lines: Sequence[Line], max_steps: int, record_path: bool = False) -> list[LineRun]:
        """Run every line of N balls until its collision is over or `max_steps` steps are taken; in order."""
        with connected() as client:
            return [run_line(client, line, max_steps, record_path) for line in lines]

    def run_columns(self, columns: Sequence[Column], max_steps: int, record_path: bool = False) -> list[Run]:
        """Run every column until its collision is over or `max_steps` steps are taken; in order."""
        # Columns of balls of one size one after the other: only another size makes new bodies.
        order = sorted(range(len(columns)), key=lambda i: radius_of(depth_of(columns[i])))
        runs: dict[int, Run] = {}
        with connected() as client:
            world = World(client)
            for i in order:
                runs[i] = run(world, columns[i], max_steps, record_path)
        return [runs[i] for i in range(len(columns))]


class NaivePybulletSolver(PybulletSolver):
    """PyBullet with the stiffness and damping of the ball-ball contact on both balls, zeta from the textbook."""

    name = "pybullet-naive"


def _beyond(column: Column | Line, depth: float) -> str | None:
    """Which of the engine's absolute numbers a column with penetrations of up to a depth in m exceeds, if any."""
    if column.step <= SHORTEST_STEP:
        return f"step = {column.step:.3g} s: PyBullet takes a step of {SHORTEST_STEP:.1e} s or less for none"
    largest = column.fastest * sum(column.masses)
    if largest > LARGEST_IMPULSE:
        return f"m |v0| = {largest:.3g} N s: PyBullet caps a contact at {LARGEST_IMPULSE:.0e} N s a step"
    radius = radius_of(depth)
    if 2 * math.sqrt(3) * radius > LARGEST_BODY:
        return (
            f"penetrations of up to {depth:.3g} m ask for balls of radius {radius:.3g} m: "
            f"PyBullet drops bodies larger than {LARGEST_BODY:.0e} m; "
            "scale stiffnesses, masses or v0 (Theorem 5)"
        )
    return None


def pairs_of(column: Column) -> tuple[PybulletBody, PybulletBody]:
    """Give stiffness and damping of contacts 1 and 2 as the engine combines them."""
    upper, lower, table = pybullet_bodies(column.contact1, column.contact2, column.mapping)
    return upper.against(lower), lower.against(table)


def depth_of(column: Column) -> float:
    """Depth in m that no penetration exceeds."""
    pair1, pair2 = pairs_of(column)
    return column.depth(pair1.stiffness, pair2.stiffness)


def _iterations(column: Column) -> int:
    """Count the iterations after which sequential impulses on this column are converged to rounding.

    One sweep over both contacts shrinks the error by g12^2/(g11 g22), with g the inverse-mass matrix of the
    two contacts and the engine's compliance 1/(h (h k + c)) on its diagonal (Gauss-Seidel on a 2x2 system):
    1e-5 at a step of 1/1000 of a period, 0.02 at 1/10.
    """
    pair1, pair2 = pairs_of(column)
    h = column.step
    g11 = 1 / column.contact1.mass + 1 / (h * (h * pair1.stiffness + pair1.damping))
    g22 = 1 / column.m2 + 1 / (h * (h * pair2.stiffness + pair2.damping))
    shrink = 1 / ((column.m2 * g11) * (column.m2 * g22))
    shrink = min(max(shrink, sys.float_info.min), 1 - sys.float_info.epsilon)  # where it is rounded to 0 or 1
    # 36.7 = -ln(1.1e-16); two more, for the cap at zero force to settle which contacts act.
    return 2 + min(1000, max(2, math.ceil(36.7 / -math.log(shrink))))


class World:
    """One plane and two spheres in a client, set up for a column at a time, and stepped.

    Bodies cost a hundred times as much to make as to set up again: they are made anew only for another radius.
    Nothing of a run is left to the next one: before it the balls are taken apart for a step, in which the engine
    forgets their contact points and with them what it warm-starts from.

    Parameters
    ----------
    client : int
        A PyBullet client, for this world alone.
    """

    def __init__(self, client: int) -> None:
        self._p, self._client = import_pybullet(), client
        self._radius = self._h = 0.0
        self._stride = 0
        self.balls: tuple[int, int] = (-1, -1)

    def prepare(self, column: Column) -> tuple[float, float, float]:
        """Set a column up; give the heights of B1 and B2 at t = 0 in m and the support's stiffness in N/m."""
        p, client = self._p, self._client
        upper, lower, table = pybullet_bodies(column.contact1, column.contact2, column.mapping)
        k2 = lower.against(table).stiffness
        radius = radius_of(depth_of(column))
        if radius != self._radius:
            self._make(radius)
        self._h, self._stride = column.step, 0
        p.setPhysicsEngineParameter(
            fixedTimeStep=column.step,
            numSubSteps=0,
            numSolverIterations=_iterations(column),
            physicsClientId=client,
        )
        b1, b2 = self.balls
        for body, mass, own in ((b1, column.m1, upper), (b2, column.m2, lower), (0, 0, table)):
            p.changeDynamics(
                body,
                -1,
                mass=mass,
                contactStiffness=own.stiffness,
                contactDamping=own.damping,
                physicsClientId=client,
            )
        p.setGravity(0, 0, 0, physicsClientId=client)
        self._place(20 * radius, 10 * radius, 0.0, 0.0)
        p.stepSimulation(client)
        p.setGravity(0, 0, -column.gravity, physicsClientId=client)
        x1, x2 = column.start(column.m2 * column.gravity / k2, radius)
        self._place(3 * radius + x1, radius + x2, column.v1, column.v2)
        return x1, x2, k2

    def _make(self, radius: float) -> None:
        p, client = self._p, self._client
        p.resetSimulation(physicsClientId=client)
        p.setPhysicsEngineParameter(**exact_contacts(radius), physicsClientId=client)
        plane = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
        sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=radius, physicsClientId=client)
        bodies = []
        for mass, shape, z in ((0, plane, 0.0), (1, sphere, 10 * radius), (1, sphere, 20 * radius)):
            body = p.createMultiBody(
                mass, shape, basePosition=(0, 0, z), useMaximalCoordinates=1, physicsClientId=client
            )
            p.changeDynamics(
                body,
                -1,
                **dict.fromkeys(ZERO, 0),
                activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING,
                physicsClientId=client,
            )
            bodies.append(body)
        self.balls = bodies[2], bodies[1]
        self._radius = radius

    def _place(self, z1: float, z2: float, v1: float, v2: float) -> None:
        for ball, z, v in zip(self.balls, (z1, z2), (v1, v2), strict=True):
            self._p.resetBasePositionAndOrientation(
                ball, (0, 0, z), (0, 0, 0, 1), physicsClientId=self._client
            )
            self._p.resetBaseVelocity(ball, (0, 0, v), (0, 0, 0), physicsClientId=self._client)

    def singly(self, n: int, x: Floats, until_flight: bool) -> tuple[Floats, Floats]:
        """Take n steps, or, until a flight, fewer: up to the first after which both gaps are open.

        From the heights before the first, in m, shape (2,); gives velocities and heights after each, shape (steps, 2).
        """
        self._set_stride(0)
        step, read, client, h = self._p.stepSimulation, self._p.getBaseVelocity, self._client, self._h
        b1, b2 = self.balls
        x1, x2 = map(float, x)
        states = []
        for _ in range(n):
            step(client)
            v1, v2 = read(b1, client)[0][2], read(b2, client)[0][2]
            x1, x2 = x1 + h * v1, x2 + h * v2
            states.append((v1, v2, x1, x2))
            if until_flight and x1 >= x2 >= 0:
                break
        taken = np.array(states)
        return taken[:, :2].copy(), taken[:, 2:].copy()

    def stop_falling(self) -> None:
        """Switch gravity off."""
        self._p.setGravity(0, 0, 0, physicsClientId=self._client)

    def together(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps in one call, see `exact`; give velocities and heights after the last."""
        self._set_stride(n)
        self._p.stepSimulation(self._client)
        read, where, client = self._p.getBaseVelocity, self._p.getBasePositionAndOrientation, self._client
        b1, b2 = self.balls
        v = np.array([read(b1, client)[0][2], read(b2, client)[0][2]])
        z1, z2 = where(b1, client)[0][2], where(b2, client)[0][2]
        return v, np.array([z1 - 3 * self._radius, z2 - self._radius])

    def _set_stride(self, n: int) -> None:
        if n != self._stride:
            self._p.setPhysicsEngineParameter(
                fixedTimeStep=max(1, n) * self._h, numSubSteps=n, physicsClientId=self._client
            )
            self._stride = n


def run(world: World, column: Column, max_steps: int, record_path: bool) -> Run:
    """Run one column until its collision is over or `max_steps` steps are taken."""
    x1, x2, k2 = world.prepare(column)
    one, two = pairs_of(column)
    contacts = EngineContacts(one.stiffness, one.damping, two.stiffness, two.damping, column.contact1.mass)
    recorder = Recorder(column, x1, x2, k2, max_steps, record_path, contacts)
    most = PATH_STRIDE if record_path else STRIDE
    x = np.array([x1, x2])
    end, window, falling = GOING, SHORT_WINDOW, column.gravity > 0
    while end == GOING and recorder.n_steps < max_steps:
        left = max_steps - recorder.n_steps
        n = min(recorder.quiet_steps(), left, most)
        if n >= LEAST_STRIDE:
            n = exact(n, column.step)
            v, x = world.together(n)
            recorder.skip(n, v, x)
            window = SHORT_WINDOW
        else:
            v, heights = world.singly(min(window, left), x, falling)
            window = min(2 * window, WINDOW)
            end, x = recorder.feed(v, heights), heights[-1]
            if end == FLIGHT:
                # A flight begins with a step after which both gaps are open: the last of those just taken.
                world.stop_falling()
                end, falling = GOING, False
    return recorder.finish()
