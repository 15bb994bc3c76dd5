"""Solvers that fail on chosen cells, in every way a solver and its process can."""

import ctypes
import os
import time

from tests.experiments.fakes import Shifted

#: Values of e1 that make a cell fatal, by what happens.
SEGFAULT, HANG, LEAVE, RAISE, SHORT = 0.901, 0.902, 0.903, 0.904, 0.905


def _harm(e1):
    if e1 == SEGFAULT:
        ctypes.string_at(0)
    elif e1 == HANG:
        while True:
            time.sleep(1)
    elif e1 == LEAVE:
        os._exit(3)
    elif e1 == RAISE:
        raise ZeroDivisionError("a bug")


class Faulty(Shifted):
    """The model's answer, 0.01 m/s faster, where it lives to give one."""

    def solve_many(self, collisions, settings):
        for c in collisions:
            _harm(c.e1)
        return super().solve_many([c for c in collisions if c.e1 != SHORT], settings)


class FaultyModel(Faulty):
    """The reference itself, that dies."""

    name = "state-transition"


class SlowToStart(Shifted):
    """Takes five seconds to answer the first time, as one does whose kernels are to be compiled."""

    started = False

    def solve_many(self, collisions, settings):
        if not SlowToStart.started:
            time.sleep(5)
        SlowToStart.started = True
        return super().solve_many(collisions, settings)


class Slow(Shifted):
    """Takes its time for each collision, so that a run can be ended in the middle."""

    def solve_many(self, collisions, settings):
        time.sleep(0.05 * len(collisions))
        return super().solve_many(collisions, settings)


faulty, faulty_model = Faulty.resolve, FaultyModel.resolve
slow_to_start, slow = SlowToStart.resolve, Slow.resolve
