"""Solvers that misbehave on purpose, in every way a solver and its process can.

They are in a module of their own, because worker processes must be able to import them.
"""

import ctypes
import dataclasses
import os
import time

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Solver
from impact_xval.model import Outcome, solve
from impact_xval.model.graph import GraphCollisionOutcome, solve_graph_collision


class Shifted(Solver):
    """The model's answer with balls that are 0.01 m/s faster.

    Of two balls on a table only B1 is faster, of other chains every ball.
    """

    name = "mujoco"

    @classmethod
    def resolve(cls, name):
        """Return this solver for its own name, a missing engine for PyBullet, and the real solver for other names."""
        return cls() if name == cls.name else Missing() if name == "pybullet" else get_solver(name)

    def version(self):
        return "shifted 1"

    def solve_many(self, collisions, settings):
        return [self.moved(c, settings) for c in collisions]

    def moved(self, collision, settings):
        pair = collision.falls_on_resting
        o = solve(collision, path=settings.record_path and pair)
        faster = np.add(o.velocities, [0.01, 0.0] if pair else 0.01)
        return dataclasses.replace(o, solver=self.name, velocities=tuple(faster.tolist()))


class ShiftedGraphs(Shifted):
    """A made-up solver that returns the model's answer to a contact graph, with ball 1 faster by 0.01 m/s along x."""

    def solve_graphs(self, collisions, settings):
        outcomes = []
        for collision in collisions:
            (x, z), *others = solve_graph_collision(collision).velocities
            outcomes.append(GraphCollisionOutcome(self.name, ((x + 0.01, z), *others)))
        return outcomes


class Perfect(Shifted):
    """A made-up engine whose answer equals the model's answer to the bit, also in the limit of a time step of zero."""

    def moved(self, collision, settings):
        o = solve(collision, path=settings.record_path)
        limit = {"v1_limit": o.v1, "v2_limit": o.v2, "limit_error": 0.0, "regularisation": 0.0}
        return dataclasses.replace(o, solver=self.name, diagnostics=limit)


class Refusing(Shifted):
    def moved(self, collision, settings):
        return Outcome.failure(self.name, collision, "unrepresentable", "not today")


class Missing(Shifted):
    name = "pybullet"

    def version(self):
        return ""

    def unavailable(self):
        return "no wheel for this Python; use Python 3.11"

    def solve_many(self, collisions, settings):
        raise AssertionError("asked although unavailable")


class Crashing(Shifted):
    """Raises an exception for every batch that holds a cell with e1 = 0.5."""

    def solve_many(self, collisions, settings):
        if any(c.e1 == 0.5 for c in collisions):
            raise ZeroDivisionError("a bug\nof the engine | here")
        return super().solve_many(collisions, settings)


class Interrupting(Shifted):
    """Raises KeyboardInterrupt, as Ctrl-C does, for a cell in the middle chunk of a small run.

    This chunk is solved last.
    """

    def solve_many(self, collisions, settings):
        if any(c.k2 == c.k1 and c.e1 == 0.5 for c in collisions):
            raise KeyboardInterrupt
        return super().solve_many(collisions, settings)


#: Amount by which `Graded` makes B1 faster than the model does, over abs(v0), by k2/k1 and e1.
GRADES = {0.5: {0.5: 0.002, 0.9: 0.004}, 1.0: {0.5: 0.004, 0.9: 0.03}, 2.0: {0.5: 0.1, 0.9: 0.4}}


class Graded(Shifted):
    def moved(self, collision, settings):
        o = solve(collision, path=settings.record_path)
        faster = GRADES[collision.stiffness_ratio][collision.e1] * -collision.v0
        return dataclasses.replace(o, solver=self.name, velocities=(o.v1 + faster, o.v2))


def refusing_all(name):
    solver = Refusing()
    solver.name = name
    return solver


#: Values of e1 for which `Faulty` crashes, hangs, leaves, raises or returns too few outcomes.
SEGFAULT, HANG, LEAVE, RAISE, SHORT = 0.901, 0.902, 0.903, 0.904, 0.905


class Faulty(Shifted):
    def solve_many(self, collisions, settings):
        for c in collisions:
            if c.e1 == SEGFAULT:
                ctypes.string_at(0)
            while c.e1 == HANG:
                time.sleep(1)
            if c.e1 == LEAVE:
                os._exit(3)
            if c.e1 == RAISE:
                raise ZeroDivisionError("a bug")
        return super().solve_many([c for c in collisions if c.e1 != SHORT], settings)


class FaultyModel(Faulty):
    name = "state-transition"


class SlowToStart(Shifted):
    """Takes five seconds for its first answer, as a solver does whose kernels must be compiled."""

    started = False

    def solve_many(self, collisions, settings):
        if not SlowToStart.started:
            time.sleep(5)
        SlowToStart.started = True
        return super().solve_many(collisions, settings)


class Slow(Shifted):
    """Takes 0.05 s for each collision, so that a test can end a run in the middle."""

    def solve_many(self, collisions, settings):
        time.sleep(0.05 * len(collisions))
        return super().solve_many(collisions, settings)


shifted, perfect, graded = (c.resolve for c in (Shifted, Perfect, Graded))
shifted_graphs = ShiftedGraphs.resolve
refusing, crashing, interrupting = (c.resolve for c in (Refusing, Crashing, Interrupting))
faulty, faulty_model = Faulty.resolve, FaultyModel.resolve
slow_to_start, slow = SlowToStart.resolve, Slow.resolve
