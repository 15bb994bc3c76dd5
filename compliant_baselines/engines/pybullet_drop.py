"""PyBullet as a solver: what it refuses, and why; how it is set up and stepped is `pybullet_world`'s.

A client is connected for a call and serves all of its columns; it is disconnected afterwards. Connecting costs a
thousandth of a chunk of cells, and a client that was kept would be client 0 to whoever else uses PyBullet in this
process and names none.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

from impact_xval.compliant_baselines.contact.column import Column, radius_of
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.compliant_baselines.engines.engine_run import Run
from impact_xval.compliant_baselines.engines.pybullet_world import (
    World,
    connected,
    depth_of,
    run,
)

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
        radius = radius_of(depth_of(column))
        if 2 * math.sqrt(3) * radius > LARGEST_BODY:
            return (
                f"penetrations of up to {depth_of(column):.3g} m ask for balls of radius {radius:.3g} m: "
                f"PyBullet drops bodies larger than {LARGEST_BODY:.0e} m; "
                "scale stiffnesses, masses or v0 (Theorem 5)"
            )
        return None

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
