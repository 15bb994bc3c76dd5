"""Practices that sandboxes import by name: a rigid engine in closed form, and what can become of one."""

import math
import os
import time
from dataclasses import replace

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.practical.chipmunk import Chipmunk
from impact_xval.compliant_baselines.practical.practice import Practice, Simulated


class Exact(Practice):
    """Newton's restitution in closed form, in one step, with more restitution than asked for."""

    name = "exact"
    settings = "none <b>bold</b>"
    engine = distribution = module = "impact_xval"
    default_step = 1e-3
    more = 1.0

    def version(self):
        return "1 <script>alert(1)</script>"

    def load(self):
        return None

    def world(self, column, arrangement):
        raise NotImplementedError

    def simulate(self, column, arrangement=None):
        arrangement = arrangement or self.usual(column)
        asked = replace(column, restitutions=[min(1.0, self.more * e) for e in column.restitutions])
        (outcome,) = get_solver("newton").solve_columns([asked], Settings())
        # What an engine of single precision adds, another one each time.
        noise = 1e-6 * math.sin(time.perf_counter())
        velocities = tuple(v + noise for v in outcome.velocities)
        return self.answered(Simulated(self.name, velocities, 1, 1e-6), arrangement)

    def answered(self, simulated, arrangement):
        return simulated


class Planted(Exact):
    more = 1.01


class Gapped(Exact):
    """Stops at a gap; crosses another order by 0.01."""

    def answered(self, simulated, arrangement):
        if arrangement.gap > 0:
            return replace(simulated, velocities=(0.0,) * len(simulated.velocities))
        if arrangement.reversed_insertion:
            return replace(simulated, velocities=tuple(v + 0.01 for v in simulated.velocities))
        return simulated


class Dying(Exact):
    def answered(self, simulated, arrangement):
        if arrangement.translation:
            os._exit(7)
        return simulated


class Hanging(Exact):
    def answered(self, simulated, arrangement):
        if arrangement.step > self.default_step:
            time.sleep(60)
        return simulated


class Refusing(Exact):
    def simulate(self, column, arrangement=None):
        unknown = (math.nan,) * len(column.masses)
        return Simulated(self.name, unknown, status="unrepresentable", reason="no <i>way</i> | at all")


class Missing(Exact):
    def unavailable(self):
        return "exact is not installed"


class Unloadable(Exact):
    def unavailable(self):
        os._exit(9)


class PlantedChipmunk(Chipmunk):
    """Pymunk's adapter, with 1 % too much restitution."""

    def simulate(self, column, arrangement=None):
        more = [min(1.0, 1.01 * e) for e in column.restitutions]
        return super().simulate(replace(column, restitutions=more), arrangement)


def exact(name):
    return Exact()


def planted(name):
    return Planted()


def gapped(name):
    return Gapped()


def dying(name):
    return Dying()


def hanging(name):
    return Hanging()


def refusing(name):
    return Refusing()


def missing(name):
    return Missing()


def unloadable(name):
    return Unloadable()


def untouchable(name):
    if name == "exact":
        practice = Exact()
        practice.simulate = lambda *given: (_ for _ in ()).throw(AssertionError("answered again"))
        return practice
    raise AssertionError


def chipmunk(name):
    return Chipmunk()


def planted_chipmunk(name):
    return PlantedChipmunk()
