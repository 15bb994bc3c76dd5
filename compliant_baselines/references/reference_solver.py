"""What the engine-free references have in common as solvers.

All of them are exact to rounding between events, and none has a time step. Both scenarios of `Settings` are
known to them; `step_fraction`, `shortest_state` and `mapping` do not concern them.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from importlib.metadata import version

import numpy as np

from impact_xval.compliant_baselines.contact.column import unrepresentable
from impact_xval.compliant_baselines.contract.solver import Settings, SolverBase
from impact_xval.compliant_baselines.contract.trajectory import FREE, STUCK
from impact_xval.compliant_baselines.references.jumps import mark
from impact_xval.compliant_baselines.references.piecewise import LOG_WIDTH, TOO_LONG
from impact_xval.compliant_baselines.references.reference_batch import Floats, Followed, ReferenceBatch
from impact_xval.compliant_baselines.references.reference_path import KernelLaw, trace
from impact_xval.model.collision import Collision, Outcome

#: Rows of the first try at a log; a collision that needs more is run once more.
LOG_ROWS = 512


class ReferenceSolver(SolverBase):
    """A reference behind the contract: a subclass says how to follow one collision.

    Statuses beside `ok`: `limit` (only `bistiffness`: a contact became rigid), `unrepresentable` (e_i = 0,
    k_i = 0 or infinite), `timeout` (not over after `Settings.max_steps` stretches).
    """

    @abstractmethod
    def follow(self, collision: Collision, g: float, max_steps: int, log: Floats) -> Followed:
        """Call the kernel, in scaled units."""

    @abstractmethod
    def batch(self, *cells: Floats) -> ReferenceBatch:
        """Follow many collisions at once, given k2/k1, m2/m1, e1, e2 and the gravity number."""

    @abstractmethod
    def law(self, collision: Collision) -> KernelLaw:
        """Say how to read the log of a collision."""

    def version(self) -> str:
        """Version of this project: the reference is its own."""
        return version("impact-xval")

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order."""
        outcomes = [self._one(c, settings) for c in collisions]
        return mark(outcomes, collisions, settings, self.name, self.batch)

    def _one(self, c: Collision, settings: Settings) -> Outcome:
        reason = unrepresentable(c)
        if reason is not None:
            return Outcome.failure(self.name, "unrepresentable", reason)
        unit, speed = math.sqrt(c.m1 / c.k1), -c.v0
        g = settings.gravity * unit / speed if settings.scenario == "drop" else 0.0
        log = np.zeros((LOG_ROWS, LOG_WIDTH))
        result = self.follow(c, g, settings.max_steps, log)
        n_rows = result.n_steps + 1
        if n_rows > LOG_ROWS:
            log = np.zeros((n_rows, LOG_WIDTH))
            result = self.follow(c, g, settings.max_steps, log)
        v1, v2, end, _, _, n_events, n_steps, duration, fall, limited = result
        if end == TOO_LONG:
            return Outcome.failure(
                self.name, "timeout", f"not over after max_steps = {settings.max_steps} stretches"
            )
        path, events, states = trace(c, log[:n_rows], self.law(c), settings.record_path)
        diagnostics = {"duration": duration * unit, "n_steps": float(n_steps)}
        if g > 0:
            diagnostics["gravity_number"] = g / math.sqrt(1 + 1 / c.mass_ratio)
            if fall < duration:
                diagnostics["first_flight"] = fall * unit
        if end != FREE:
            diagnostics["rest_speed"] = v2 * speed
            v1, v2 = (0.0 if end == STUCK else v1), 0.0
        # Impulses go with the velocities reported, as those of engines do.
        impulse1 = 1 + v1 + g * fall
        impulse2 = impulse1 + c.mass_ratio * (v2 + g * fall)
        momentum = c.m1 * speed
        return Outcome(
            solver=self.name,
            v1=v1 * speed,
            v2=v2 * speed,
            impulse1=impulse1 * momentum,
            impulse2=impulse2 * momentum,
            states=states,
            status="limit" if limited else "ok",
            reason="a contact became rigid: closed form from there on" if limited else "",
            n_events=n_events,
            diagnostics=diagnostics,
            path=path,
            events=events,
        )
