"""What an engine made of a column: how the run ended, its states, and the path it left."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.contact.column import Column
from impact_xval.compliant_baselines.contract.state_runs import Runs, merge_runs
from impact_xval.compliant_baselines.contract.trajectory import (
    ALOFT,
    BROKEN,
    FREE,
    REST,
    STUCK,
    Floats,
)
from impact_xval.model.collision import ImpulseCurve, Status


@dataclass(frozen=True, slots=True)
class Run:
    """What an engine made of a column.

    Attributes
    ----------
    column : Column
        What it was asked.
    end : int
        How it ended, of the constants of `contract.trajectory`; `GOING` if it ran out of steps.
    v1, v2, x1, x2 : float
        Velocities in m/s and heights in m at the end.
    x1_start, x2_start : float
        Heights in m at the start, as the engine had them.
    raw : Runs
        States step by step, nothing merged.
    points : ndarray, shape (n, 3), or None
        Number of the step (0 is the start), v1, v2; the borders between raw states are among them.
    failure : str
        What the engine itself complained of, if it did.
    starts : float
        What contacts that began to carry force again did in their first steps, summed as changes of the
        relative velocity of their pair in m/s. When in its first step a contact is met is chance: by so much
        the outcome depends on it.
    unloaded : tuple of float
        When contacts 1 and 2 last ceased to carry force, in s, to a fraction of a step (`trajectory.scan`);
        NaN if they never did.
    max_steps : int
        Steps it was allowed.
    fall : tuple of int and two floats, or None
        Where its first flight began, from which on the bodies no longer fall: number of steps, heights in m; None
        if it had none, or no gravity.
    lead : tuple of float and int
        By how much time, in s, its first flight began, or, negative, did not, and the contact that decided on it
        (`trajectory.scan`).
    """

    column: Column
    end: int
    v1: float
    v2: float
    x1: float
    x2: float
    x1_start: float
    x2_start: float
    raw: Runs
    points: Floats | None
    failure: str = ""
    starts: float = 0.0
    unloaded: tuple[float, float] = (nan, nan)
    max_steps: int = 0
    fall: tuple[int, float, float] | None = None
    lead: tuple[float, int] = (inf, 0)

    @property
    def duration(self) -> float:
        """Time the run took, in s."""
        return self.raw.n_steps * self.column.step

    @property
    def over(self) -> bool:
        """Whether the collision came to its end."""
        return self.end in (FREE, REST, STUCK)

    @property
    def status(self) -> Status:
        """``ok`` if the collision came to its end; ``crashed`` if the engine broke; else ``timeout``."""
        return "ok" if self.over else "crashed" if self.end == BROKEN else "timeout"

    @property
    def reported(self) -> tuple[float, float]:
        """Velocities in m/s as an outcome states them: those of balls at rest are 0 (`trajectory`)."""
        return 0.0 if self.end == STUCK else self.v1, 0.0 if self.end in (REST, STUCK) else self.v2

    def problem(self) -> str:
        """Why the collision is not over, in words; empty if it is."""
        if self.over:
            return ""
        if self.end == BROKEN:
            why = self.failure or "velocities are no longer finite"
            return f"after {self.raw.n_steps} steps of {self.column.step:.3g} s: {why}"
        if self.fall is not None and self.fall[0] == self.raw.n_steps < self.max_steps:
            return "it ended with the first flight: its adapter has to go on from Recorder.state, without gravity"
        reason = f"not over after max_steps = {self.max_steps} steps of {self.column.step:.3g} s"
        if self.end == ALOFT:
            reason += (
                f" (after {self.raw.n_steps} both balls are in flight, and meet again only after the last)"
            )
        return reason

    def impulses(self, v1: float, v2: float) -> tuple[float, float]:
        """Give the total impulses of both contacts, in N s, for final velocities in m/s; gravity put back."""
        c = self.column
        fallen = c.gravity * self._falling(self.duration)
        impulse1 = c.m1 * (v1 - c.v1 + fallen)
        return impulse1, impulse1 + c.m2 * (v2 - c.v2 + fallen)

    def _falling(self, time: Any) -> Any:
        """For how long up to a time, or to each of some, gravity acted, in s."""
        return time if self.fall is None else np.minimum(time, self.fall[0] * self.column.step)

    def energy_gain(self) -> float:
        """Give the energy gained over the kinetic energy at the start, without what springs hold at the end.

        Kinetic energy and, as long as the bodies fall, height count, and so does what the support of a settled B2
        holds at the start. Dissipation and springs left loaded only make it smaller: a positive value is the
        engine's doing.
        """
        c = self.column

        def energy(v1: float, v2: float, x1: float, x2: float) -> float:
            return 0.5 * (c.m1 * v1 * v1 + c.m2 * v2 * v2) + c.gravity * (c.m1 * x1 + c.m2 * x2)

        # A linear support that carries m2 g at the penetration -x2_start holds half their product.
        held = -0.5 * c.m2 * c.gravity * self.x2_start if c.settled else 0.0
        before = energy(c.v1, c.v2, self.x1_start, self.x2_start) + held
        x1, x2 = (self.x1, self.x2) if self.fall is None else self.fall[1:]
        return (energy(self.v1, self.v2, x1, x2) - before) / energy(c.v1, c.v2, 0, 0)

    def path(self, runs: Runs) -> ImpulseCurve:
        """Give the recorded path under a (merged) state sequence; energies unknown."""
        assert self.points is not None
        c = self.column
        step = self.points[:, 0].astype(np.int64)
        # Step n ends at point n. The state of a point is that of the step before it; at a border the point is
        # given again, with the state of the step after it.
        at = np.searchsorted(runs.start, np.maximum(step - 1, 0), side="right") - 1
        again = np.flatnonzero(np.isin(step, runs.start[1:]))
        order = np.sort(np.concatenate([np.arange(step.size), again]), kind="stable")
        state_index = at[order]
        state_index[1:] += (order[1:] == order[:-1]).astype(state_index.dtype)
        state = runs.state[state_index]
        v1, v2 = self.points[order, 1], self.points[order, 2]
        t = np.asarray(step[order] * c.step, np.float64)
        fallen = c.gravity * self._falling(t)
        impulse1 = c.m1 * (v1 - c.v1 + fallen)
        impulse2 = impulse1 + c.m2 * (v2 - c.v2 + fallen)
        phase1 = np.where(np.isin(state, (1, 3)), np.where(v2 > v1, 1, 2), 0)
        phase2 = np.where(np.isin(state, (1, 2)), np.where(v2 < 0, 1, 2), 0)
        return ImpulseCurve(t, impulse1, impulse2, v1, v2, None, None, state, phase1, phase2)


def states_of(run: Run, shortest_state: float) -> Runs:
    """State sequence of a run, in steps; `shortest_state` as in `contract.solver.Settings`."""
    return merge_runs(run.raw, shortest_state * run.column.period / run.column.step)
