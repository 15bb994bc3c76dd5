"""One column followed through the steps an engine takes, and what came of it: how it ended, its states, its path."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.engines.column import Column
from impact_xval.compliant_baselines.engines.quiet import EngineContacts, between, quiet_steps
from impact_xval.compliant_baselines.engines.trajectory import (
    ALOFT,
    BROKEN,
    FLIGHT,
    FREE,
    GOING,
    REST,
    STUCK,
    Floats,
    ScanParameters,
    new_memory,
    scan,
)
from impact_xval.compliant_baselines.states import Runs, merge_runs
from impact_xval.model.collision import Path, Status

#: A recorded path has about as many points as this between the borders of its states.
PATH_POINTS = 2000

#: Energy an engine may create, over that of B1 before the collision, before its answer counts as
#: `unconverged`. Contacts of springs and dashpots create none; an explicit step of 1/1000 of a period creates
#: 1e-4 of it at most.
ENERGY_GAIN_ALLOWED = 0.01


class Ended(ABC):
    """What runs have in common: how they ended."""

    __slots__ = ()
    column: Any
    end: int
    raw: Runs
    failure: str
    max_steps: int
    fall: Any

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
                f" (after {self.raw.n_steps} all balls are in flight, and meet again only after the last)"
            )
        return reason

    @abstractmethod
    def energy_gain(self) -> float:
        """Give the energy gained, over that at the start."""

    def too_much_energy(self) -> str:
        """Why the result is not converged, if it gained so much energy; else empty."""
        gain = self.energy_gain()
        if gain <= ENERGY_GAIN_ALLOWED:
            return ""
        return f"it ended with {gain:.1%} more energy than it began with: the step is too long"


@dataclass(frozen=True, slots=True)
class Run(Ended):
    """What an engine made of a column.

    Attributes
    ----------
    column : Column
        What it was asked.
    end : int
        How it ended, of the constants of `engines.trajectory`; `GOING` if it ran out of steps.
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
        What contacts that began to carry force again did in their first steps, in m/s (`again` of
        `trajectory.MEMORY`). When in its first step a contact is met is chance: by so much the outcome depends on it.
    max_steps : int
        Steps it was allowed.
    fall : tuple of int and two floats, or None
        Where its first flight began, from which on the bodies no longer fall: number of steps, heights in m; None
        if it had none, or no gravity.
    lead : tuple of float and int
        By how much time, in s, its first flight began, or, negative, did not, and the contact that decided on it.
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
    max_steps: int = 0
    fall: tuple[int, float, float] | None = None
    lead: tuple[float, int] = (inf, 0)

    @property
    def reported(self) -> tuple[float, float]:
        """Velocities in m/s as an outcome states them: those of balls at rest are 0 (`trajectory`)."""
        return 0.0 if self.end == STUCK else self.v1, 0.0 if self.end in (REST, STUCK) else self.v2

    def impulses(self, v1: Any, v2: Any, time: Any) -> tuple[Any, Any]:
        """Impulses of both contacts up to a time in s, in N s, from the velocities then in m/s; gravity put back.

        Numbers or arrays. Gravity has acted until the first flight.
        """
        c = self.column
        falling = time if self.fall is None else np.minimum(time, self.fall[0] * c.step)
        fallen = c.gravity * falling
        impulse1 = c.m1 * (v1 - c.v1 + fallen)
        return impulse1, impulse1 + c.m2 * (v2 - c.v2 + fallen)

    def state_names(self, shortest_state: float) -> tuple[str, ...]:
        """State sequence as an outcome lists it; `shortest_state` as in `solver.Settings`."""
        return states_of(self, shortest_state).names

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

    def path(self, runs: Runs) -> Path:
        """Give the recorded path under a (merged) state sequence."""
        assert self.points is not None
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
        t = np.asarray(step[order] * self.column.step, np.float64)
        impulses = np.stack(self.impulses(v1, v2, t), axis=1)
        between = np.diff(t)[:, None]  # of a point that is given twice none, and the force before it
        means = np.diff(impulses, axis=0) / np.where(between > 0, between, 1.0)
        forces = np.vstack([means[:1], np.where(between > 0, means, np.roll(means, 1, axis=0))])
        acting = np.stack([np.isin(state, (1, 3)), np.isin(state, (1, 2))], axis=1)
        return Path(t, np.stack([v1, v2], axis=1), impulses, forces, acting)


def states_of(run: Run, shortest_state: float) -> Runs:
    """State sequence of a run, in steps; `shortest_state` as in `solver.Settings`."""
    return merge_runs(run.raw, shortest_state * run.column.period / run.column.step)


class Recorder:
    """Takes the steps of one column as an engine delivers them, in blocks, until the collision is over.

    Parameters
    ----------
    column : Column
        What the engine was asked.
    x1, x2 : float
        Heights at t = 0 in m, as the engine has them.
    k2 : float
        Stiffness in N/m of the support as the engine has it, about static equilibrium.
    max_steps : int
        Steps it may take.
    record_path : bool
        Whether to keep points.
    contacts : EngineContacts, optional
        The contacts as the engine has them, by default those asked for; for `quiet_steps` and `skip`.
    """

    def __init__(
        self,
        column: Column,
        x1: float,
        x2: float,
        k2: float,
        max_steps: int,
        record_path: bool,
        contacts: EngineContacts | None = None,
    ) -> None:
        self.column = column
        self._max_steps = max_steps
        self.end = GOING
        rest = -column.m2 * column.gravity / k2
        self.parameters = ScanParameters(
            column.step, column.gravity, column.m1, column.m2, column.contact1.k, k2, rest
        )
        self._v = np.array([column.v1, column.v2])
        self._x = np.array([x1, x2])
        self._start = (x1, x2)
        self.n_steps = 0
        self._last_code = 0
        one, two = column.contact1, column.contact2
        self._contacts = contacts or EngineContacts(one.k, one.c, two.k, two.c, one.mass)
        self._packed = np.array([*self.parameters, *self._contacts])
        self._fall: tuple[int, float, float] | None = None
        self._memory = new_memory()
        self._starts, self._states = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        self._record_path = record_path
        self._points = [np.array([[0.0, column.v1, column.v2]])]
        self._n_points, self._stride = 1, 1

    @property
    def state(self) -> tuple[Floats, Floats]:
        """Heights in m and velocities in m/s after the last step taken, shape (2,) each."""
        return self._x, self._v

    def feed(self, v: Floats, x: Floats) -> int:
        """Take the next steps, up to the one after which the collision is over, given up or in its first flight.

        Parameters
        ----------
        v, x : ndarray, shape (n, 2)
            Velocities in m/s and heights in m of B1 and B2 after each step.

        Returns
        -------
        int
            `GOING`; `FLIGHT` if the engine has to go on from `state` without gravity; else these were the last.
        """
        codes = np.empty(len(v), np.int8)
        left = self._max_steps - self.n_steps - len(v)
        n, self.end = scan(v, x, self._v, self.parameters, left, codes, self._memory)
        codes = codes[:n]
        if n:
            changes = np.flatnonzero(np.diff(codes, prepend=np.int8(self._last_code)))
            self._starts.append(changes + self.n_steps)
            self._states.append(codes[changes].astype(np.int64))
            if self._record_path:
                self._keep(v[:n], changes)
            self._v, self._x = v[n - 1].copy(), x[n - 1].copy()
            self._last_code = int(codes[-1])
            self.n_steps += n
        if self.end == FLIGHT:
            self._fall = self.n_steps, float(self._x[0]), float(self._x[1])
            self.parameters = self.parameters._replace(g=0.0)
            self._packed = np.array([*self.parameters, *self._contacts])
            self.end = GOING
            return FLIGHT
        return self.end

    def quiet_steps(self) -> int:
        """Count the next steps in which nothing will happen (`engines.quiet`)."""
        return quiet_steps(self._last_code, self._v, self._x, self._packed)

    def skip(self, n: int, v: Floats, x: Floats) -> None:
        """Take n steps together, in which nothing happened: as in the last one that was fed, all along.

        Points of the path in between lie on the cubics through the velocities and accelerations at both ends,
        the accelerations from the law. That is of fourth order in the time of the n steps, and of first in their
        own: within 6e-5 of |v0| of what each step would have given, for 32 steps of 1/1000 of a period.

        Parameters
        ----------
        n : int
            Number of steps.
        v, x : ndarray, shape (2,)
            Velocities in m/s and heights in m of B1 and B2 after the last of them.
        """
        if self._record_path:
            ends = (self._v, self._x, v, x)
            self._append(between(self._last_code, *ends, self.n_steps, n, self._stride, self._packed))
        self._v, self._x = v, x
        self.n_steps += n
        self._memory["n_steps"] += n

    def _keep(self, v: Floats, changes: NDArray[np.int64]) -> None:
        """Keep every `stride`-th point, the borders, and the last one of the block."""
        number = self.n_steps + 1 + np.arange(len(v))
        wanted = number % self._stride == 0
        wanted[-1] = True
        wanted[changes[changes > 0] - 1] = True
        self._append(np.column_stack([number[wanted].astype(np.float64), v[wanted]]))

    def _append(self, points: Floats) -> None:
        self._points.append(points)
        self._n_points += len(points)
        if self._n_points > 4 * PATH_POINTS:
            self._thin()

    def _thin(self) -> Floats:
        """Double the stride until the points between borders are at most `PATH_POINTS`."""
        points = np.concatenate(self._points)
        number = points[:, 0].astype(np.int64)
        border = np.isin(number, np.concatenate(self._starts))
        border[[0, -1]] = True
        keep = np.ones(len(number), bool)
        while np.count_nonzero(keep & ~border) > PATH_POINTS:
            self._stride *= 2
            keep = border | (number % self._stride == 0)
        self._points = [points[keep]]
        self._n_points = len(self._points[0])
        return self._points[0]

    def finish(self, failure: str = "") -> Run:
        """Close the record; `failure` is what the engine complained of, if it did."""
        (memory,) = self._memory
        (v1, v2), (x1, x2), (x1_start, x2_start) = self._v, self._x, self._start
        return Run(
            self.column,
            BROKEN if failure else self.end,
            float(v1),
            float(v2),
            float(x1),
            float(x2),
            x1_start,
            x2_start,
            raw=Runs(np.concatenate(self._starts), np.concatenate(self._states), self.n_steps),
            points=self._thin() if self._record_path else None,
            failure=failure,
            starts=float(memory["again"]),
            max_steps=self._max_steps,
            fall=self._fall,
            lead=(float(memory["lead"]) * self.column.step, int(memory["lead_contact"])),
        )
