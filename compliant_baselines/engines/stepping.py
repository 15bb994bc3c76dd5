"""Runs of a scene through the steps of an engine: they find impulses, states and the end of the collision.

**Impulses** follow from the balance of momentum. In a step of length h the impulse of contact i is dI_i = dI_{i-1} +
m_i (dv_i + g h), where g h takes the effect of gravity out. The contact forces that an engine reports are never used.

**A contact carries force** in a step if its impulse is larger than the rounding of the momenta, `World.rounding` times
their sum. In engines whose contacts only push, a pulling impulse is taken for rounding (`World.pulls`). Contacts of
some engines may pull. Such a contact is taken to carry force from its first impulse until its gap opens.

**Without gravity** the collision is over at the end of the first step in which no contact carries force and no bodies
approach. A flight that lasts longer than the remaining steps is given up.

**In a drop** gravity is switched off for good when the first flight begins: at the end of the first step in which no
contact carries force, and after which both gaps are open. From then on the rule without gravity applies. A drop is over
earlier if balls settle. Balls have settled if their energy about equilibrium is too small to unload the contacts that
are closed. Either only B2 has settled on the table, while B1 is clear of it and rises, or both balls have settled. The
velocities of settled balls are reported as 0. The diagnostic `rest_speed` is the velocity that B2 still had.
docs/theory.md, section 8, gives the reasons. The exact solvers follow the same rules.

**A flight that is given up**, because it lasts longer than the remaining steps, may end with a further meeting. This
meeting changes little if bodies approach slowly. Proof: let p be any velocities at which all bodies part, and |.| the
kinetic norm. Contacts that only push, with impulses P_i >= 0, change v to v' = v + sum_i P_i n_i, where n_i . p >= 0.
They create no energy, so |v' - p|^2 = |v'|^2 - 2 v' . p + |p|^2 <= |v - p|^2. So the final velocities are no further
from p than the velocities in flight. If the velocities in flight are within `SLOWEST_MEETING` of the nearest such p,
the collision is taken to be over, and p is reported.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy  # pyright: ignore[reportMissingTypeStubs]
from numpy.typing import ArrayLike, NDArray

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

#: SciPy loads `scipy.optimize` at its first use. Most collisions do without it, and without the 0.2 s that this takes.
_scipy: Any = scipy

#: Approximate number of points of a recorded path that are not borders between states.
PATH_POINTS = 2000

#: Largest energy that an engine may create, over the energy at the start. With more, the outcome is `unconverged`.
#: Springs and dashpots create no energy; explicit steps of 1/1000 of a period create at most 1e-4 of it.
ENERGY_GAIN_ALLOWED = 0.01

#: Largest change of a velocity by a meeting that is still to come, over the speed at the start. If the change is at
#: most this large, the collision is taken to be over. The number is a tenth of the default tolerance of a limit.
#: Elastic balls that should come to rest against one another still approach slowly: at about 1e-8 by MuJoCo's
#: impedance, and at up to 1e-4 because PyBullet's steps damp.
SLOWEST_MEETING = 1e-4

#: Number of steps in a window. The steps of a window are taken first and then read together.
WINDOW = 256

#: Number of steps in the first window of a run, and in the first window after many steps were taken in one call. Only
#: for engines that can take many steps in one call.
SHORT_WINDOW = 8

#: Smallest number of steps that are taken in one call without reading them.
SHORTEST_LEAP = 8

#: Largest number of steps in one call if a path is recorded, unless 1/`PATH_SHARE` of the steps without an event is
#: more. Velocities within these steps are interpolated, on the default grid to 5e-5 of |v0|. With 32 steps a call the
#: error is no smaller; with a fraction of a half it is larger, 7e-5.
PATH_LEAP, PATH_SHARE = 32, 4


class FirstFlight(NamedTuple):
    """State at the beginning of a drop's first flight. From then on gravity is off."""

    #: Number of steps before the flight begins.
    n_steps: int
    #: Heights in m at which the flight begins, shape (N,).
    heights: Floats


class FlightLead(NamedTuple):
    """The closing of a gap that came nearest to starting or preventing the first flight of a drop."""

    #: Time in s between the event and the beginning of the flight. It is positive if the flight began, negative if the
    #: event prevented it, and infinite if there was no event of this kind.
    time: float
    #: The contact whose gap closed in this event, counted from 0.
    contact: int


def project_to_separated(
    velocities: Sequence[float], masses: Sequence[float], table: bool = True
) -> tuple[float, ...]:
    """Return the nearest velocities, in the kinetic norm, at which all bodies part or stay together.

    They satisfy v1 >= v2 >= ..., and on a table all are >= 0. The unit of the masses does not matter.
    """
    separated = list(velocities)
    if any(above < below for above, below in pairwise(velocities)):
        regression = _scipy.optimize.isotonic_regression(velocities, weights=masses, increasing=False)
        separated = regression.x.tolist()
    return tuple(max(v, 0.0) if table else v for v in separated)


def describe_energy_gain(gain: float, *, has_fixed_body: bool) -> str:
    """Return a sentence on a gain of energy, which is given as a share of the energy at the start.

    The sentence is empty if the gain is at most `ENERGY_GAIN_ALLOWED`. Without a fixed body the energy is that of the
    motion relative to the centre of mass.
    """
    if gain <= ENERGY_GAIN_ALLOWED:
        return ""
    energy = "energy" if has_fixed_body else "energy, relative to the centre of mass,"
    return (
        f"it ended with {gain:.1%} more {energy} than it began with: its step is too long, or its contacts create "
        "energy"
    )


class Run:
    """A run of a scene, during or after the collision: it reads an engine's steps in windows and keeps the results.

    Attributes
    ----------
    scene
        The scene.
    max_steps
        Largest number of steps. A run that is not over then is given up.
    n_steps
        Number of steps taken.
    end
        State of the run. It is `RunEnd.GOING` while the run goes on, and also if `max_steps` steps were taken without
        an end.
    failure
        The error message of an engine that failed.
    start
        Heights in m at t = 0 in the engine, shape (N,).
    velocities, heights
        Velocities in m/s and heights in m after the last step, shape (N,).
    first_flight
        State at the beginning of a drop's first flight; None without a flight.
    effective, accuracy, dropped
        Copies of the members of the same names of the `World`, the scene inside the engine.
    turning
        0, because normals in a line do not turn.
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
        # The first step of each state, and the state itself, window by window.
        self._state_starts: list[NDArray[np.int64]] = []
        self._states: list[NDArray[np.int64]] = []
        # Points of the path, window by window: every `_stride`-th step, the borders between states, and the ends of
        # windows.
        self._points: list[Floats] = [np.array([[0.0, *scene.velocities]])] if record_path else []
        self._stride, self._n_points = 1, 0

    def feed(self, v: Floats, x: Floats) -> bool:
        """Follow the collision through the next steps of the engine. Return True if a first flight begins.

        v and x are the velocities in m/s and heights in m after each step, shape (n, N). Steps after the end of the
        collision are ignored. When a first flight begins, the engine has to continue without gravity from the
        velocities and heights of this run.
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
        """Record points of the path: the numbers of steps, and the velocities in m/s after them."""
        self._points.append(np.column_stack([number.astype(np.float64), velocities]))
        self._n_points += len(number)
        if self._n_points > 4 * PATH_POINTS:
            self.thin_path()

    def thin_path(self) -> None:
        """Thin the path until it has at most `PATH_POINTS` points in addition to borders of states and ends.

        The stride between recorded steps is doubled as often as needed.
        """
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
        """Return the number of next steps in which no event happens; 0 if the engine is read after every step."""
        if self._law is None:
            return 0
        return count_event_free_steps(
            self._active, self.velocities, self.heights, self._masses, self._law, self._numbers
        )

    def skip(self, n: int, v: Floats, x: Floats) -> None:
        """Record n steps without an event; only the velocities v in m/s and heights x in m after the last are known.

        Points of the path in between are interpolated, with an error of fourth order in the time of the n steps.
        """
        if self._points:
            first, last = (self.n_steps // self._stride + 1) * self._stride, self.n_steps + n
            number = np.append(np.arange(first, last, self._stride), last)
            self._record(number, self._interpolate(number, n, v, x))
        self.velocities, self.heights = v, x
        self.n_steps += n
        self._memory["n_steps"] += n

    def _interpolate(self, number: NDArray[np.int64], n: int, v: Floats, x: Floats) -> Floats:
        """Return interpolated velocities in m/s after the steps `number`, within n steps without an event.

        v and x are the velocities and heights after the last of these n steps.
        """
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
        """The sequence of states as they were read, without a filter."""
        nothing = np.zeros(0, np.int64)
        start = np.concatenate([nothing, *self._state_starts])
        return Runs(start, np.concatenate([nothing, *self._states]), self.n_steps)

    @property
    def starts(self) -> float:
        """Sum of the changes of relative velocities in m/s in the first time steps of contacts.

        Only contacts are added whose bodies met at a speed. Bodies meet at an arbitrary instant within a step. This sum
        bounds how much these instants change the outcome. The last step of a contact that pulls until its bodies part
        is included. Each change is scaled to a whole step (`World.first_step_share`).
        """
        return float(self._memory["starts"][0]) / self._first_step_share

    @property
    def starts_together(self) -> float:
        """The part of `starts` that depends on a neighbouring contact, in m/s.

        Two contacts that would begin one after the other may begin in the same step. The smaller of their two changes
        shows how much they depend on one another. It is almost nothing if only the engine's rounding loads a contact.
        """
        return float(self._memory["starts_together"][0])

    @property
    def flight_lead(self) -> FlightLead:
        """The closing of a gap that came nearest to starting or preventing the first flight."""
        return FlightLead(
            float(self._memory["lead"][0]) * self.scene.step, int(self._memory["lead_contact"][0])
        )

    @property
    def points(self) -> Floats | None:
        """Points of the recorded path, shape (n, 1 + N), or None: number of steps, and velocities in m/s after them."""
        return self._points[0] if self._points else None

    @property
    def duration(self) -> float:
        """Duration of the collision in s."""
        return self.n_steps * self.scene.step

    @property
    def meeting_left(self) -> float:
        """Bound in m/s on the change of the reported velocities by a meeting that is still to come.

        It is 0 if the collision is over, and infinite if the run stopped while a contact was active.
        """
        if self.end in (RunEnd.APART, RunEnd.B2_SETTLED, RunEnd.BOTH_SETTLED):
            return 0.0
        if self.end != RunEnd.IN_FLIGHT:
            return math.inf
        distance = math.sqrt(float(self._masses @ (self.velocities - self.reported) ** 2))
        return distance / math.sqrt(float(self._masses.min()))

    @property
    def over(self) -> bool:
        """True if the collision is over, or only a meeting that changes almost nothing is still to come."""
        return self.meeting_left <= SLOWEST_MEETING * self.scene.speed

    @property
    def b2_settled(self) -> bool:
        """True if the run ended with B2 at rest on the table."""
        return self.end in (RunEnd.B2_SETTLED, RunEnd.BOTH_SETTLED)

    @property
    def status(self) -> Status:
        """``ok`` if the collision is over; ``crashed`` if the engine failed; else ``timeout``.

        All statuses are listed in `model.status`. `experiments.measures.divergence` (`has_numbers`) lists the statuses
        of runs that are not over but still have velocities.
        """
        if self.over:
            return "ok"
        return "crashed" if self.end == RunEnd.BROKEN else "timeout"

    @property
    def reported(self) -> tuple[float, ...]:
        """Velocities in m/s that the outcome reports.

        The velocities of settled balls are 0. If a flight was given up, these are the nearest velocities at which all
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
        """Return the reason why the collision is not over; ``""`` if it is over."""
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
        """Return the impulses in N s up to times in s, from the velocities in m/s at these times.

        Velocities have the shape (..., N), times (...), impulses (..., C). The effect of gravity until the first flight
        is removed.
        """
        c = self.scene
        falling = time
        if self.first_flight is not None:
            falling = np.minimum(time, self.first_flight.n_steps * c.step)
        changes = np.array(velocities) - np.array(c.velocities) + c.gravity * np.expand_dims(falling, -1)
        return np.cumsum(np.array(c.masses) * changes, axis=-1)[..., : len(c.stiffnesses)]

    def merged_states(self, shortest_state: float) -> Runs:
        """Return the sequence of sets of active contacts, without very short states; times are numbers of steps.

        `states.merge_runs` removes the states that are shorter than `shortest_state` times the shortest contact period.
        """
        c = self.scene
        closed = int((c.gaps == 0) @ _bits(len(c.stiffnesses)))
        return merge_runs(self.raw_states, shortest_state * min(periods(c)) / c.step, closed)

    def energy_gain(self) -> float:
        """Return the gain of energy over the kinetic energy at the start; the engine has created any positive gain.

        The energy is kinetic; without a table it is that of the motion relative to the centre of mass. While gravity
        acts, the energy of heights is added. At the start the energy in the support of a settled B2 is added. Energy
        that springs hold at the end is ignored.
        """
        c, m = self.scene, np.array(self.scene.masses)

        def kinetic(v: Floats) -> float:
            return 0.5 * float(m @ (v if c.table else v - m @ v / m.sum()) ** 2)

        # A linear support that carries the weight m2 g at the depth -x2 holds the energy m2 g (-x2)/2.
        held = -0.5 * c.masses[-1] * c.gravity * float(self.start[-1])
        lowest = self.heights if self.first_flight is None else self.first_flight.heights
        fallen = c.gravity * float(m @ (lowest - self.start))
        before = kinetic(np.array(c.velocities))
        return (kinetic(self.velocities) + fallen - before - held) / before

    def too_much_energy(self) -> str:
        """Return a sentence for a run that ended with too much energy.

        The sentence is empty if the gain of energy is at most `ENERGY_GAIN_ALLOWED`.
        """
        return describe_energy_gain(self.energy_gain(), has_fixed_body=self.scene.table)

    def path(self, states: Runs) -> Path:
        """Return the recorded path, with the filtered sequence of states."""
        assert self.points is not None
        # The point of the path after step n has the state in step n. At a border between two states there are two such
        # points; the second one has the state in step n + 1.
        times = 1 + np.isin(self.points[:, 0], states.start[1:])
        step = np.repeat(self.points[:, 0].astype(np.int64), times)
        is_second = np.append(False, step[1:] == step[:-1])
        step_of_state = np.maximum(step - 1, 0) + is_second
        state = states.state[np.searchsorted(states.start, step_of_state, side="right") - 1]
        velocities, time = np.repeat(self.points[:, 1:], times, axis=0), np.float64(self.scene.step) * step
        impulses = self.impulses(velocities, time)
        duration = np.diff(time)[:, None]  # 0 for the second of the two points at a border
        means = np.diff(impulses, axis=0) / np.where(duration > 0, duration, 1.0)
        forces = np.vstack([means[:1], np.where(duration > 0, means, np.roll(means, 1, axis=0))])
        acting = (state[:, None] & _bits(len(self.scene.stiffnesses))) != 0
        return Path(time, velocities, impulses, forces, acting)


def _bits(contacts: int) -> NDArray[np.int64]:
    """Return for each contact the bit that stands for it in a set of contacts."""
    return 1 << np.arange(contacts)


def _scene_numbers(scene: Scene, world: World) -> NDArray[np.void]:
    """Return the parameters of a scene as a record of `SCENE_NUMBERS` for compiled functions.

    The world gives the depth at which B2 rests in the table.
    """
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
        # Balls do not sink into a rigid support. The stiffnesses asked for still define how little energy a settled
        # ball has.
        numbers["k2"] = k2
        return numbers
    k2 = m2 * g / depth
    numbers["k2"] = k2
    numbers["depth_of_b2"] = depth
    numbers["depth_of_b1_in_b2"] = m1 * g / k1
    numbers["depth_of_b2_loaded"] = depth + m1 * g / k2
    return numbers


def _contact_law(scene: Scene, world: World) -> NDArray[np.void]:
    """Return a record of `CONTACT_LAW` for each contact, with the parameters that the engine uses."""
    law = np.zeros(len(scene.stiffnesses), CONTACT_LAW)
    law["stiffness"] = world.effective["stiffness"]
    law["damping"] = world.effective["damping"]
    law["mass"] = reduced_masses(scene)
    return law


def _new_memory(scene: Scene) -> NDArray[np.void]:
    """Return the memory of `scan` before the first step, in which all gaps are noted as closed."""
    memory = np.zeros(1, MEMORY)
    memory["lead"] = np.inf
    memory["flight_phase"] = FlightPhase.BEFORE
    memory["closed"] = 1
    memory["closed_at"] = -np.inf
    memory["met_at_speed"] = (scene.gaps > 0) @ _bits(len(scene.stiffnesses))
    return memory


def follow_scene(scene: Scene, world: World, max_steps: int, record_path: bool = False) -> Run:
    """Run a scene until its collision is over or `max_steps` steps are taken.

    If the engine raises a RuntimeError, the run ends with the state `RunEnd.BROKEN`.
    """
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
    """Return how many steps may be taken in one call without reading them; 0 if the engine is read after every step."""
    if not world.longest_leap:
        return 0
    event_free = run.event_free_steps()
    leap = min(event_free, run.max_steps - run.n_steps, world.longest_leap)
    return min(leap, max(PATH_LEAP, event_free // PATH_SHARE)) if record_path else leap
