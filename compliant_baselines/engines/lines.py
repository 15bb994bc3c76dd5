"""N balls in a line followed through the steps an engine takes, and what came of it; without gravity.

What holds of two balls holds here (`engines.trajectory`, `states`): impulses come from the balance of
momentum, a contact carries force in a step if its impulse exceeds what rounding can make of it, and the collision is
over at the end of the first step in which none does and no bodies approach. A state is the set of contacts that carry
force. In sequences of states a contact that is closed at the start counts as if it carried force until it first does,
and a state held for less than `shortest_state` of the shortest contact period takes the state before it.

A path is kept at every step, as long as that is at most `PATH_POINTS` of them; beyond, at every second, every fourth,
... What happens between two points is the change of the velocities: forces are means, and integrate to the impulses
whatever was left out. A flight needs no points but its ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import groupby

import numba
import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.engines.line import Line
from impact_xval.compliant_baselines.engines.recording import Ended
from impact_xval.compliant_baselines.engines.trajectory import ALOFT, BROKEN, EPSILON, FREE, GOING, ROUNDING
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.compliant_baselines.states import Runs
from impact_xval.model.collision import Collision, Outcome, Path, name_of_set

Floats = NDArray[np.float64]

#: Most points of a path.
PATH_POINTS = 2**14


@dataclass(frozen=True, slots=True)
class LineRun(Ended):
    """What an engine made of a line.

    Attributes
    ----------
    column : Line
        What it was asked.
    end : int
        How it ended, of the constants of `engines.trajectory`; `GOING` if it ran out of steps.
    reported : tuple of float
        Velocities at the end in m/s.
    raw : Runs
        States step by step, as bits: 2^i for contact i, counted from 0.
    failure : str
        What the engine itself complained of, if it did.
    starts : float
        As of `recording.Run`.
    max_steps : int
        Steps it was allowed.
    points : ndarray, shape (n, 1 + N), or None
        Number of the step (0 is the start) and velocities after it, in m/s; the first and the last among them.
    fall : None
        There is no gravity that a first flight would end.
    """

    column: Line
    end: int
    reported: tuple[float, ...]
    raw: Runs
    failure: str
    starts: float
    max_steps: int
    points: Floats | None = None
    fall: None = None

    def state_names(self, shortest_state: float) -> tuple[str, ...]:
        """Name the sets of contacts that carry force; the last one is empty."""
        shortest = shortest_state * self.column.period / self.column.step
        seen = 0
        held: list[int] = []
        lengths = np.diff(np.append(self.raw.start, self.raw.end)).tolist()
        pairs = groupby(zip(lengths, self._shown(), strict=True), key=lambda pair: pair[1])
        for length, state in ((sum(n for n, _ in group), state) for state, group in pairs):
            seen |= state
            if not held or length >= shortest * (1 - 1e-9):
                held.append(state)
        sets = [state for state, _ in groupby([*held, 0])]
        paper = self.column.table and len(self.column.masses) == 2
        return tuple(name_of_set(state, paper) for state in sets)

    def _shown(self) -> list[int]:
        """List the states of `raw`, in which contacts that were closed at first count until they first carry force."""
        waiting = sum(1 << i for i, gap in enumerate(self.column.gaps) if gap == 0)
        states = []
        for state in self.raw.state.tolist():
            waiting &= ~state
            states.append(state | waiting)
        return states

    def path(self) -> Path:
        """Give the path that was recorded; the force at the start is that of the first interval."""
        assert self.points is not None
        contacts = len(self.column.contacts)
        number, velocities = self.points[:, 0], self.points[:, 1:]
        time = number * self.column.step
        changes = np.array(self.column.masses) * (velocities - velocities[0])
        impulses = np.cumsum(changes, axis=1)[:, :contacts]
        forces = np.diff(impulses, axis=0) / np.diff(time)[:, None]
        state = np.array(self._shown())[np.searchsorted(self.raw.start, number, side="right") - 1]
        state[-1] = 0
        return Path(
            time,
            velocities,
            impulses,
            np.vstack([forces[:1], forces]),
            (state[:, None] >> np.arange(contacts) & 1).astype(np.bool_),
        )

    def energy_gain(self) -> float:
        """Give the energy gained, over the kinetic energy at the start relative to the centre of mass or the table."""
        m = np.array(self.column.masses)
        before, after = np.array(self.column.velocities), np.array(self.reported)
        if not self.column.table:
            before, after = before - m @ before / m.sum(), after - m @ after / m.sum()
        return float(m @ after**2 / (m @ before**2) - 1)


@numba.njit(cache=True)
def scan(v, x, before, masses, table, h, left, codes, memory):  # pragma: no cover (compiled)
    """Go through a window of steps until the collision is over.

    Parameters
    ----------
    v, x : ndarray, shape (n, N)
        Velocities and heights after each step.
    before : ndarray, shape (N,)
        Velocities before the first one.
    masses : ndarray, shape (N,)
    table : bool
    h : float
        Length of a step.
    left : int
        Number of steps that may still be taken after these.
    codes : ndarray of int64, shape (n,)
        Filled with the state of each step, as bits.
    memory : ndarray of int64, shape (2,), and of float64, shape (1,)
        Contacts that carry force, and those that are met at a speed if they begin to: they have ceased to, or were open
        at first. What contacts so met did in their first step, as a change of the relative velocity of their pair.

    Returns
    -------
    steps, end : int
        As of `engines.trajectory.scan`: `GOING`, `FREE`, `ALOFT` or `BROKEN`.
    """
    sets, again = memory
    balls = masses.size
    contacts = balls if table else balls - 1
    for i in range(v.shape[0]):
        impulse, noise, code = 0.0, 0.0, 0
        apart, meet = True, np.inf
        for j in range(balls):
            old = before[j] if i == 0 else v[i - 1, j]
            if not (math.isfinite(v[i, j]) and math.isfinite(x[i, j])):
                return i, BROKEN
            impulse += masses[j] * (v[i, j] - old)
            noise += ROUNDING * EPSILON * masses[j] * (abs(v[i, j]) + abs(old))
            if j == contacts:
                break
            inverse = 1 / masses[j]
            rate, gap = -v[i, j], x[i, j]
            if j + 1 < balls:
                inverse += 1 / masses[j + 1]
                rate, gap = v[i, j + 1] - v[i, j], x[i, j] - x[i, j + 1]
            bit = 1 << j
            if impulse > noise:
                code |= bit
                if sets[1] & bit and not sets[0] & bit:
                    again[0] += impulse * inverse
            elif sets[0] & bit:
                sets[1] |= bit
            if rate > 0:
                apart = False
                meet = min(meet, max(gap, 0.0) / rate)
        sets[0] = code
        codes[i] = code
        if code == 0:
            if apart:
                return i + 1, FREE
            if meet > (v.shape[0] - i + left) * h:
                return i + 1, ALOFT
    return v.shape[0], GOING


class LineRecorder:
    """Takes the steps of one line as an engine delivers them, in blocks, until the collision is over."""

    def __init__(self, line: Line, max_steps: int, record_path: bool = False) -> None:
        self.column, self.max_steps = line, max_steps
        self.end, self.n_steps = GOING, 0
        self._v = np.array(line.velocities)
        self._masses = np.array(line.masses)
        self._memory = np.array([0, sum(1 << i for i, gap in enumerate(line.gaps) if gap > 0)]), np.zeros(1)
        self._codes: list[NDArray[np.int64]] = []
        self._starts: list[NDArray[np.int64]] = []
        self._last_code = -1
        self._path = _Path(len(line.masses)) if record_path else None

    def feed(self, v: Floats, x: Floats) -> int:
        """Take the next steps, velocities in m/s and heights in m of shape (n, N): how it ended, or `GOING`."""
        codes = np.empty(len(v), np.int64)
        left = self.max_steps - self.n_steps - len(v)
        line = self.column
        n, self.end = scan(v, x, self._v, self._masses, line.table, line.step, left, codes, self._memory)
        if n:
            if self._path:
                self._path.keep(
                    self.n_steps, np.vstack([self._v, v[:n]]), np.append(self._last_code, codes[:n])
                )
            changes = np.flatnonzero(np.diff(codes[:n], prepend=self._last_code))
            self._starts.append(changes + self.n_steps)
            self._codes.append(codes[changes])
            self._v, self._last_code = v[n - 1].copy(), int(codes[n - 1])
            self.n_steps += n
        return self.end

    def flight_steps(self, x: Floats) -> int:
        """Count the next steps in which all balls fly, two less than their time has; 0 if any contact carries force.

        Heights in m, shape (N,), after the last step taken.
        """
        if self._last_code != 0:
            return 0
        line, v = self.column, self._v
        gaps, rates = (-np.diff([*values, *([0.0] if line.table else [])]) for values in (x, -v))
        closing = rates > 0
        if not closing.any() or (gaps[closing] <= 0).any():
            return 0
        return max(0, int(min(float((gaps[closing] / rates[closing]).min()) / line.step, 1e6)) - 2)

    def skip(self, n: int, x: Floats) -> Floats:
        """Take n steps of flight from these heights in m, in which velocities stay; the heights after them."""
        self.n_steps += n
        return x + n * self.column.step * self._v

    def finish(self, failure: str = "") -> LineRun:
        """Close the record; `failure` is what the engine complained of, if it did."""
        none = [np.zeros(0, np.int64)]
        raw = Runs(np.concatenate(self._starts or none), np.concatenate(self._codes or none), self.n_steps)
        return LineRun(
            column=self.column,
            end=BROKEN if failure else self.end,
            reported=tuple(self._v.tolist()),
            raw=raw,
            failure=failure,
            starts=float(self._memory[1][0]),
            max_steps=self.max_steps,
            points=self._path.closed(self.n_steps, self._v) if self._path else None,
        )


class _Path:
    """The points of a path, a number of them that is bounded."""

    def __init__(self, balls: int) -> None:
        self._stride = 1
        self._points, self._ends = np.empty((0, 1 + balls)), np.empty(0, bool)

    def keep(self, before: int, v: Floats, codes: NDArray[np.int64]) -> None:
        """Keep what is needed of a block of steps.

        Parameters
        ----------
        before : int
            Number of steps before the block.
        v : ndarray, shape (1 + n, N)
            Velocities in m/s, before the block and after each of its steps.
        codes : ndarray, shape (1 + n,)
            States of the last step before the block, and of each of its steps.
        """
        number = before + np.arange(len(codes) - 1)
        loaded = codes != 0
        # Each point stands between two steps. Between two without force it is as the one before it.
        ends = loaded[1:] != loaded[:-1]
        ends[number == 0] = True
        wanted = ends | loaded[1:] & (number % self._stride == 0)
        self._points = np.vstack([self._points, np.column_stack([number, v[:-1]])[wanted]])
        self._ends = np.append(self._ends, ends[wanted])
        while len(self._points) >= PATH_POINTS:
            self._stride *= 2
            kept = self._points[:, 0] % self._stride == 0
            # The ends of flights too, as long as there is room for them.
            if self._ends.sum() < PATH_POINTS // 2:
                kept |= self._ends
            self._points, self._ends = self._points[kept], self._ends[kept]

    def closed(self, n_steps: int, v: Floats) -> Floats:
        """Give all points, with that of the end: the number of steps, and velocities in m/s."""
        return np.vstack([self._points, [n_steps, *v]])


def outcome_of_line(solver: str, column: Collision, run: LineRun, settings: Settings) -> Outcome:
    """Turn a finished run into an outcome; `diagnostics` as of `engine.outcome_of`."""
    if not run.over:
        return Outcome.failure(solver, column, run.status, run.problem())
    changes = np.array(column.masses) * np.subtract(run.reported, column.velocities)
    states = run.state_names(settings.shortest_state)
    reason = run.too_much_energy()
    return Outcome(
        solver=solver,
        velocities=run.reported,
        impulses=tuple(np.cumsum(changes)[: len(column.stiffnesses)].tolist()),
        states=states,
        status="unconverged" if reason else "ok",
        reason=reason,
        n_events=len(states) - 1,
        diagnostics={
            "step": run.column.step,
            "n_steps": float(run.raw.n_steps),
            "duration": run.duration,
            "energy_gain": run.energy_gain(),
        },
        path=run.path() if run.points is not None else None,
    )
