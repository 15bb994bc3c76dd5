"""Runs of a scene through the steps of an engine: they find impulses, states and the end of the collision.

**Impulses** come from the balance of momentum, with gravity put back, for a step of length h: dI_i = dI_{i-1} + m_i
(dv_i + g h). The contact forces that an engine reports are never used.

**A contact carries force** in a step if its impulse exceeds `World.rounding` of the momenta in the balance. An impulse
that pulls counts as rounding, unless the contacts of the engine may pull (`World.pulls`). Such a contact also carries
force until its gap opens, once it has begun.

**Without gravity** the collision is over at the end of the first step in which no contact carries force and no bodies
approach. A flight that outlasts the remaining steps is given up.

**In a drop** gravity is off for good from the first flight on. The first flight begins at the end of the first step in
which no contact carries force and at whose end both gaps are open. A drop is also over when balls have settled: when
their energy about equilibrium cannot unload the contacts that are closed. Either B2 has settled on the table while B1
is clear of it and rises, or both balls have settled. Velocities of settled balls are reported as 0; the diagnostic
`rest_speed` is the v2 that remained. The reasons are in docs/theory.md, section 8; engines and references keep these
rules alike.

**A meeting still to come** when a flight is given up changes little if bodies approach slowly. Let p be any velocities
at which all bodies part, and |.| the kinetic norm. Contacts that only push, with impulses P_i >= 0, change v to v' = v
+ sum_i P_i n_i, where n_i . p >= 0. They create no energy, so |v' - p|^2 = |v'|^2 - 2 v' . p + |p|^2 <= |v - p|^2: the
final velocities are no further from p than the velocities of the flight. If the flight is within `SLOWEST_MEETING` of
the nearest such p, the collision counts as over, and p is reported.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import isotonic_regression  # pyright: ignore[reportMissingTypeStubs]

from impact_xval.compliant_baselines.engines.event_free_steps import (
    CONTACT_LAW,
    NOT_STARTED,
    SCENE_NUMBERS,
    count_event_free_steps,
    hermite_interpolate,
)
from impact_xval.compliant_baselines.engines.scanner import MEMORY, FlightPhase, RunEnd, scan
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, periods, reduced_masses
from impact_xval.compliant_baselines.states import Runs, merge_runs
from impact_xval.model.path import Path
from impact_xval.model.status import Status

#: Approximate number of points of a recorded path between the borders of its states.
PATH_POINTS = 2000

#: Energy that an engine may create, over the energy at the start, before its outcome is `unconverged`. Springs and
#: dashpots create no energy; explicit steps of 1/1000 of a period create at most 1e-4 of it.
ENERGY_GAIN_ALLOWED = 0.01

#: Largest change of a velocity, over the speed at the start, by a meeting still to come with which a collision counts
#: as over: a tenth of the default tolerance of a limit. Elastic balls that should rest against one another still
#: approach: at some 1e-8 by MuJoCo's impedance, and at up to 1e-4 because PyBullet's steps damp.
SLOWEST_MEETING = 1e-4

#: Number of steps in a window; the steps of a window are read together.
WINDOW = 256

#: Number of steps in the first window after a leap, and in the first window of an engine that leaps.
SHORT_WINDOW = 8

#: Fewest steps of a leap.
SHORTEST_LEAP = 8

#: Most steps of a leap in a run that records its path, unless the fraction 1/`PATH_SHARE` of the event-free steps is
#: more. Velocities within a leap are interpolated, on the default grid to 5e-5 of |v0|. Leaps of 32 steps are no
#: better; a fraction of a half is worse, 7e-5.
PATH_LEAP, PATH_SHARE = 32, 4


class FirstFlight(NamedTuple):
    """State at the beginning of a drop's first flight; from then on gravity is off."""

    #: Number of steps before the flight.
    n_steps: int
    #: Heights in m, shape (N,).
    heights: Floats


class FlightLead(NamedTuple):
    """The event that came nearest to deciding whether a first flight begins."""

    #: Lead of the event in s. Positive if the flight began, negative if it failed to begin, infinite without such an
    #: event.
    time: float
    #: The contact that decided, counted from 0.
    contact: int


def project_to_separated(
    velocities: Sequence[float], masses: Sequence[float], table: bool = True
) -> tuple[float, ...]:
    """Return the nearest velocities, in the kinetic norm, at which all bodies part or stay together.

    They satisfy v1 >= v2 >= ..., and >= 0 on a table. The unit of masses does not matter.
    """
    regression: Any = isotonic_regression(velocities, weights=masses, increasing=False)
    separated: list[float] = regression.x.tolist()
    return tuple(max(v, 0.0) if table else v for v in separated)


class Run:
    """A run of a scene, in progress or over: it takes the steps of an engine in windows and holds their results.

    Attributes
    ----------
    scene
        The scene.
    max_steps
        Steps after which the run is given up.
    n_steps
        Steps taken.
    end
        State of the run; `RunEnd.GOING` if all `max_steps` are taken.
    failure
        The error message of an engine that failed.
    start
        The engine's heights in m at t = 0, shape (N,).
    velocities, heights
        Velocities in m/s and heights in m after the last step, shape (N,).
    first_flight
        State at the beginning of a drop's first flight; None without a flight.
    effective, accuracy, dropped
        The members of these names of the `World`.
    turning
        0: normals in a line do not turn.
    """

    turning = 0.0

    def __init__(self, scene: Scene, world: World, max_steps: int, record_path: bool = False) -> None:
        self.scene, self.max_steps = scene, max_steps
        self.n_steps = 0
        self.end: RunEnd = RunEnd.GOING
        self.failure = ""
        self.velocities: Floats = np.array(scene.velocities, float)
        self.heights: Floats = np.array(world.heights, float)
        self.start = self.heights
        self.effective, self.accuracy, self.dropped = dict(world.effective), world.accuracy, world.dropped
        self._first_step_share = world.first_step_share
        self.first_flight: FirstFlight | None = None
        self._masses: Floats = np.array(scene.masses)
        self._numbers = _scene_numbers(scene, world)
        self._law = _contact_law(scene, world) if world.longest_leap else None
        self._active = NOT_STARTED
        self._memory = _new_memory(scene)
        # The first step of each state, and the states, window by window.
        self._state_starts: list[NDArray[np.int64]] = []
        self._states: list[NDArray[np.int64]] = []
        # Points of the path, window by window: every `_stride`-th step, the borders between states, and the ends.
        self._points: list[Floats] = [np.array([[0.0, *scene.velocities]])] if record_path else []
        self._stride, self._n_points = 1, 0

    def feed(self, v: Floats, x: Floats) -> bool:
        """Take those of the next steps that belong to the collision.

        Velocities in m/s and heights in m after each step have the shape (n, N). The result is True if a first flight
        begins. The engine then has to go on from the state of this run without gravity.
        """
        active = np.empty(len(v), np.int64)
        steps_left = self.max_steps - self.n_steps - len(v)
        before, numbers = self.velocities, self._numbers
        scanned, end = scan(v, x, before, self._masses, numbers, steps_left, active, self._memory)
        n, self.end = int(scanned), RunEnd(end)
        if n:
            changes = np.flatnonzero(active[:n] != np.append(self._active, active[: n - 1]))
            self._state_starts.append(changes + self.n_steps)
            self._states.append(active[changes])
            if self._points:
                number = self.n_steps + 1 + np.arange(n)
                recorded = number % self._stride == 0
                recorded[-1] = True
                recorded[changes[changes > 0] - 1] = True
                self._record(number[recorded], v[:n][recorded])
            self.velocities, self.heights = v[n - 1].copy(), x[n - 1].copy()
            self._active = int(active[n - 1])
            self.n_steps += n
        if self.end != RunEnd.FIRST_FLIGHT:
            return False
        self.first_flight = FirstFlight(self.n_steps, self.heights)
        self._numbers["gravity"] = 0.0
        self.end = RunEnd.GOING
        return True

    def _record(self, number: NDArray[np.int64], velocities: Floats) -> None:
        """Record points of the path: numbers of steps, and velocities after them."""
        self._points.append(np.column_stack([number.astype(np.float64), velocities]))
        self._n_points += len(number)
        if self._n_points > 4 * PATH_POINTS:
            self.thin_path()

    def thin_path(self) -> None:
        """Double the stride until the path has at most `PATH_POINTS` points, apart from borders and ends."""
        points = np.concatenate(self._points)
        number = points[:, 0].astype(np.int64)
        border = np.isin(number, self.raw_states.start)
        border[[0, -1]] = True
        keep = np.ones(len(number), bool)
        while np.count_nonzero(keep & ~border) > PATH_POINTS:
            self._stride *= 2
            keep = border | (number % self._stride == 0)
        self._points, self._n_points = [points[keep]], int(keep.sum())

    def event_free_steps(self) -> int:
        """Count the next steps in which nothing will happen; 0 if the engine cannot leap."""
        if self._law is None:
            return 0
        return count_event_free_steps(
            self._active, self.velocities, self.heights, self._masses, self._law, self._numbers
        )

    def skip(self, n: int, v: Floats, x: Floats) -> None:
        """Take n event-free steps at once; velocities and heights after the last have the shape (N,).

        Points of the path in between are interpolated, to fourth order in the time of the n steps.
        """
        if self._points:
            first, last = (self.n_steps // self._stride + 1) * self._stride, self.n_steps + n
            number = np.append(np.arange(first, last, self._stride), last)
            self._record(number, self._interpolate(number, n, v, x))
        self.velocities, self.heights = v, x
        self.n_steps += n
        self._memory["n_steps"] += n

    def _interpolate(self, number: NDArray[np.int64], n: int, v: Floats, x: Floats) -> Floats:
        """Interpolate velocities after steps with these numbers, within n event-free steps that end with v and x."""
        between = np.empty((len(number), len(v)))
        hermite_interpolate(
            between,
            self._active,
            self.velocities,
            self.heights,
            v,
            x,
            (number - self.n_steps) / n,
            n * self.scene.step,
            self._masses,
            self._law,
            float(self._numbers["gravity"][0]),
            np.empty((2, len(v))),
        )
        return between

    @property
    def raw_states(self) -> Runs:
        """States step by step, nothing merged."""
        nothing = np.zeros(0, np.int64)
        start = np.concatenate([nothing, *self._state_starts])
        return Runs(start, np.concatenate([nothing, *self._states]), self.n_steps)

    @property
    def starts(self) -> float:
        """Changes of relative velocities in the first steps of contacts that were met at a speed, summed, in m/s.

        The instant within its first step at which a contact is met is arbitrary. This sum bounds the effect of these
        instants. The last step of a contact that pulls until its bodies part counts too. Each change is scaled to a
        whole step (`World.first_step_share`).
        """
        return float(self._memory["starts"][0]) / self._first_step_share

    @property
    def starts_together(self) -> float:
        """The part of `starts` that depends on a neighbouring contact, in m/s.

        Contacts that are met one after the other may fall into one step. The lesser of the two changes in such a step
        tells how much the contacts depend on one another. It is next to nothing if only the engine's rounding loads a
        contact.
        """
        return float(self._memory["starts_together"][0])

    @property
    def flight_lead(self) -> FlightLead:
        """The event that came nearest to deciding whether the first flight begins."""
        return FlightLead(
            float(self._memory["lead"][0]) * self.scene.step, int(self._memory["lead_contact"][0])
        )

    @property
    def points(self) -> Floats | None:
        """Numbers of steps (0 is the start) and velocities after them, shape (n, 1 + N); None if not recorded."""
        return self._points[0] if self._points else None

    @property
    def duration(self) -> float:
        """Duration of the collision in s."""
        return self.n_steps * self.scene.step

    @property
    def meeting_left(self) -> float:
        """Bound in m/s on the change of the reported velocities by a meeting still to come.

        0 if the collision is over, and infinite if the run stopped before a flight.
        """
        if self.end in (RunEnd.APART, RunEnd.B2_SETTLED, RunEnd.BOTH_SETTLED):
            return 0.0
        if self.end != RunEnd.IN_FLIGHT:
            return math.inf
        distance = math.sqrt(float(self._masses @ (self.velocities - self.reported) ** 2))
        return distance / math.sqrt(float(self._masses.min()))

    @property
    def over(self) -> bool:
        """True if the collision is over, except possibly for a meeting that changes next to nothing."""
        return self.meeting_left <= SLOWEST_MEETING * self.scene.speed

    @property
    def b2_settled(self) -> bool:
        """True if the run ended with B2 at rest on the table."""
        return self.end in (RunEnd.B2_SETTLED, RunEnd.BOTH_SETTLED)

    @property
    def status(self) -> Status:
        """``ok`` if the collision is over; ``crashed`` if the engine failed; else ``timeout``.

        A status is a word of `model.status`. `experiments.measures.divergence` (`has_numbers`) lists the statuses that
        keep the numbers of a run that is not over.
        """
        if self.over:
            return "ok"
        return "crashed" if self.end == RunEnd.BROKEN else "timeout"

    @property
    def reported(self) -> tuple[float, ...]:
        """Velocities in m/s for the outcome.

        Velocities of settled balls are 0. For a flight that was given up they are the nearest velocities at which all
        bodies part.
        """
        v: list[float] = self.velocities.tolist()
        if self.end == RunEnd.IN_FLIGHT:
            return project_to_separated(v, self.scene.masses, self.scene.table)
        if self.end == RunEnd.BOTH_SETTLED:
            return 0.0, 0.0
        if self.end == RunEnd.B2_SETTLED:
            return v[0], 0.0
        return tuple(v)

    def problem(self) -> str:
        """Return why the collision is not over; ``""`` if it is."""
        if self.over:
            return ""
        if self.end == RunEnd.BROKEN:
            reason = self.failure or "velocities are no longer finite"
            return f"after {self.n_steps} steps of {self.scene.step:.3g} s: {reason}"
        reason = f"not over after {self.max_steps} steps of {self.scene.step:.3g} s"
        if self.end == RunEnd.IN_FLIGHT:
            reason += f" (after step {self.n_steps} all balls are in flight; the next meeting is after the last step)"
        return reason

    def impulses(self, velocities: ArrayLike, time: Floats | float) -> Floats:
        """Return the impulses in N s up to times in s, from the velocities at these times.

        Velocities have the shape (..., N), times (...), impulses (..., C). The effect of gravity until the first flight
        is removed from the velocities.
        """
        c = self.scene
        falling = time
        if self.first_flight is not None:
            falling = np.minimum(time, self.first_flight.n_steps * c.step)
        changes = np.array(velocities) - np.array(c.velocities) + c.gravity * np.expand_dims(falling, -1)
        return np.cumsum(np.array(c.masses) * changes, axis=-1)[..., : len(c.stiffnesses)]

    def merged_states(self, shortest_state: float) -> Runs:
        """Return the state sequence, with times in steps; `Settings.shortest_state` is the argument."""
        c = self.scene
        closed = int((c.gaps == 0) @ _bits(len(c.stiffnesses)))
        return merge_runs(self.raw_states, shortest_state * min(periods(c)) / c.step, closed)

    def energy_gain(self) -> float:
        """Return the energy gained, over the kinetic energy at the start; the engine has created any positive gain.

        The energy is kinetic, without a table about the centre of mass. While bodies fall, the energy of their heights
        is added. At the start the energy in the support of a settled B2 is added. Energy in springs at the end is left
        out.
        """
        c, m = self.scene, np.array(self.scene.masses)

        def kinetic(v: Floats) -> float:
            return 0.5 * float(m @ (v if c.table else v - m @ v / m.sum()) ** 2)

        # A linear support that carries m2 g at the penetration -x2 holds half the product of both.
        held = -0.5 * c.masses[-1] * c.gravity * float(self.start[-1])
        lowest = self.heights if self.first_flight is None else self.first_flight.heights
        fallen = c.gravity * float(m @ (lowest - self.start))
        before = kinetic(np.array(c.velocities))
        return (kinetic(self.velocities) + fallen - before - held) / before

    def too_much_energy(self) -> str:
        """Return why the result is not converged if it has gained too much energy; else ``""``."""
        if (gain := self.energy_gain()) <= ENERGY_GAIN_ALLOWED:
            return ""
        return f"it ended with {gain:.1%} more energy than it began with: the step is too long"

    def path(self, states: Runs) -> Path:
        """Return the recorded path under a merged state sequence."""
        assert self.points is not None
        # Step n ends at point n. The state of a point is the state in the step before it. At a border between states
        # the point occurs twice, the second time with the state in the step after it.
        times = 1 + np.isin(self.points[:, 0], states.start[1:])
        step = np.repeat(self.points[:, 0].astype(np.int64), times)
        is_second = np.append(False, step[1:] == step[:-1])
        step_of_state = np.maximum(step - 1, 0) + is_second
        state = states.state[np.searchsorted(states.start, step_of_state, side="right") - 1]
        velocities, time = np.repeat(self.points[:, 1:], times, axis=0), np.float64(self.scene.step) * step
        impulses = self.impulses(velocities, time)
        duration = np.diff(time)[:, None]  # 0 before the second point at a border
        means = np.diff(impulses, axis=0) / np.where(duration > 0, duration, 1.0)
        forces = np.vstack([means[:1], np.where(duration > 0, means, np.roll(means, 1, axis=0))])
        acting = (state[:, None] & _bits(len(self.scene.stiffnesses))) != 0
        return Path(time, velocities, impulses, forces, acting)


def _bits(contacts: int) -> NDArray[np.int64]:
    """Return the bit of each contact in a set of contacts."""
    return 1 << np.arange(contacts)


def _scene_numbers(scene: Scene, world: World) -> NDArray[np.void]:
    """Return the numbers of a scene for the kernels; the depth of a settled B2 comes from the world."""
    numbers = np.zeros(1, SCENE_NUMBERS)
    numbers["contacts"] = len(scene.stiffnesses)
    numbers["step"] = scene.step
    numbers["rounding"] = world.rounding
    numbers["pulls"] = world.pulls
    if not scene.gravity:
        return numbers
    (m1, m2), (k1, k2), g, depth = scene.masses, scene.stiffnesses, scene.gravity, world.rest
    numbers["gravity"] = g
    numbers["k1"] = k1
    if not depth:
        # Balls do not sink into a rigid support. The stiffnesses asked for still define a small energy.
        numbers["k2"] = k2
        return numbers
    k2 = m2 * g / depth
    numbers["k2"] = k2
    numbers["depth_of_b2"] = depth
    numbers["depth_of_b1_in_b2"] = m1 * g / k1
    numbers["depth_of_b2_loaded"] = depth + m1 * g / k2
    return numbers


def _contact_law(scene: Scene, world: World) -> NDArray[np.void]:
    """Return a record of `CONTACT_LAW` for each contact, with the numbers of `World.effective`."""
    law = np.zeros(len(scene.stiffnesses), CONTACT_LAW)
    law["stiffness"] = world.effective["stiffness"]
    law["damping"] = world.effective["damping"]
    law["mass"] = reduced_masses(scene)
    return law


def _new_memory(scene: Scene) -> NDArray[np.void]:
    """Return the memory of `scan` at t = 0, at which all gaps count as closed."""
    memory = np.zeros(1, MEMORY)
    memory["lead"] = np.inf
    memory["flight_phase"] = FlightPhase.BEFORE
    memory["closed"] = 1
    memory["closed_at"] = -np.inf
    memory["met_at_speed"] = (scene.gaps > 0) @ _bits(len(scene.stiffnesses))
    return memory


def follow_scene(scene: Scene, world: World, max_steps: int, record_path: bool = False) -> Run:
    """Run a scene until its collision is over or `max_steps` steps are taken; a RuntimeError of the engine ends it."""
    run = Run(scene, world, max_steps, record_path)
    window = SHORT_WINDOW if world.longest_leap else WINDOW
    try:
        while run.end == RunEnd.GOING and run.n_steps < max_steps:
            leap = _next_leap(run, world, record_path)
            if leap >= SHORTEST_LEAP:
                run.skip(*world.leap(leap))
                window = SHORT_WINDOW
                continue
            first_flight = run.feed(*world.advance(min(window, max_steps - run.n_steps)))
            if first_flight:
                world.weightless(run.velocities, run.heights)
            window = min(2 * window, WINDOW)
    except RuntimeError as error:
        run.end, run.failure = RunEnd.BROKEN, " ".join(str(error).split())
    run.dropped = world.dropped
    if record_path:
        run.thin_path()
    return run


def _next_leap(run: Run, world: World, record_path: bool) -> int:
    """Return the number of steps that may be taken in one call."""
    if not world.longest_leap:
        return 0
    event_free = run.event_free_steps()
    leap = min(event_free, run.max_steps - run.n_steps, world.longest_leap)
    return min(leap, max(PATH_LEAP, event_free // PATH_SHARE)) if record_path else leap
