"""A scene of balls in a plane, run step by step in an engine.

`PlaneRun` receives the results of steps. It finds in which steps contacts carry force, and when the collision is over.
`follow_plane_scene` lets an engine take steps until then. Used by `engine` and `convergence`.

All contacts touch at t = 0, and there is no gravity. The velocities of all balls are v. Their displacements from the
places where they would just touch are x. A row of the matrix J belongs to a contact, and contains the contact's normal
at t = 0 (`Arrangement.jacobian`). The rates of compression are -J v, and the gaps are J x.

**A contact carries force** in a step if its impulse is larger than rounding, and larger than `TURNED` times the largest
impulse of the step. Rounding is the fraction `World.rounding` of the momenta. The impulses P of a step are computed
from the changes dv of velocities by least squares: J^T P = M dv, with the diagonal matrix M of masses. If J^T does not
have full rank, several sets of impulses give the same velocities, and the least-squares solution is one of them. The
impulses are used for the sequence of states and for the error of a limit. They never change velocities.

**The collision is over** at the end of the first step in which momenta change only by rounding and no bodies in contact
approach. In a flight no contact carries force, but bodies in contact may still approach and meet again. A flight ends
the run in two cases. In the first case the flight lasts longer than the remaining steps. In the second case the next
meeting is further ahead than the collision has lasted, and it can change velocities by at most
`stepping.SLOWEST_MEETING` times the speed at the start (proof in `stepping`). If a flight has ended the run, the
reported velocities are the nearest ones, in the kinetic norm, at which all bodies part. The collision is taken to be
over only if the next meeting is within this bound (`PlaneRun.over`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy  # pyright: ignore[reportMissingTypeStubs]
from numpy.typing import NDArray

from impact_xval.compliant_baselines.engines.scanner import RunEnd
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, periods
from impact_xval.compliant_baselines.engines.stepping import (
    SLOWEST_MEETING,
    WINDOW,
    FlightLead,
    describe_energy_gain,
)
from impact_xval.compliant_baselines.states import Runs, merge_runs
from impact_xval.model.arrays import Booleans
from impact_xval.model.status import Status

#: SciPy loads `scipy.optimize` at its first use. Commands that step no engine do without the 0.2 s that this takes.
_scipy: Any = scipy

#: Impulses below this fraction of the largest impulse of a step are ignored. While balls move, normals turn a little. J
#: keeps the normals at t = 0, so a part of an impulse can seem to act at another contact.
TURNED = 1e-4

#: Gap in radii above which a contact is taken to be open. It is larger than the rounding of positions and the overlap
#: at the start.
OPEN = 2.0**-44

#: Rounding error of a rate of compression, which is a sum of products in -J v, over the sum of their magnitudes.
RATE_ROUNDING = 2.0**-48


def project_to_parting(velocities: Floats, scene: Scene) -> Floats:
    """Return the nearest velocities, in the kinetic norm, at which no bodies in contact approach; shape (N axes,).

    They are the velocities after a plastic impact at all contacts, v + M^-1 J^T P, with the impulses P >= 0 and the
    diagonal matrix M of masses.
    """
    J, root = scene.arrangement.jacobian, np.sqrt(scene.inertia)
    impulses: Floats = _scipy.optimize.nnls((J / root).T, -root * velocities)[0]
    return velocities + J.T @ impulses / scene.inertia


def _rows_of_change(acts: Booleans, opened: Booleans, moved: Booleans) -> Booleans:
    """Return True for each step of a block that `PlaneRun.feed` must look at alone; shape (n steps,).

    These steps are the first step of the block, each step in which a contact becomes active, becomes inactive or opens,
    and the first step of each flight. Later steps of a flight need no look. Their velocities are the same. Each step
    brings the next meeting nearer by one step, and one step fewer remains. So the answer whether the flight ends the
    run stays the same.

    Parameters
    ----------
    acts, opened
        True where a contact carries force in a step, and where a contact is open before the step; shape (n steps, N
        contacts).
    moved
        True for each step in which the momentum of a body changes; shape (n steps,).
    """
    open_and_idle = opened & ~acts
    changes = np.ones(len(acts), bool)
    changes[1:] = (acts[1:] != acts[:-1]).any(axis=1) | (open_and_idle[1:] != open_and_idle[:-1]).any(axis=1)
    changes[1:] |= moved[:-1] & ~moved[1:]
    return changes


class PlaneRun:
    """A run of a scene in a plane, during or after the collision.

    Its members have the same names as those of `stepping.Run`, the run of a scene in a line.

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
    velocities, heights
        Velocities in m/s and heights in m after the last step, shape (N axes,).
    effective, accuracy, dropped
        Copies of the members of the same names of the `World`, the scene inside the engine.
    starts, starts_together
        Two sums of changes of relative velocities in m/s. `starts` adds up the changes in the first time step of each
        contact whose bodies met at a speed. `starts_together` is the part of it that depends on other contacts of the
        same bodies.
    turning
        Largest angle in rad by which the normal of a contact has turned, from the start to the last step with a force.
    first_flight, flight_lead, b2_settled
        These members describe the end of a drop. A run in a plane has no gravity, so they have fixed values: no first
        flight, an infinite lead, and B2 not settled.
    """

    first_flight = None
    flight_lead = FlightLead(math.inf, 0)
    b2_settled = False

    def __init__(self, scene: Scene, world: World, max_steps: int) -> None:
        self.scene, self.max_steps = scene, max_steps
        self.n_steps, self.end, self.failure = 0, RunEnd.GOING, ""
        self.velocities: Floats = np.array(scene.velocities, float)
        self.heights: Floats = np.array(world.heights, float)
        self.effective, self.accuracy, self.dropped = dict(world.effective), world.accuracy, world.dropped
        self.turning = self.starts_together = self._starts = 0.0
        self._world, self._start = world, self.heights
        self._first_step_share = world.first_step_share
        self._J, self._inertia = scene.arrangement.jacobian, scene.inertia
        self._W = (self._J / self._inertia) @ self._J.T
        self._impulses_of = np.linalg.pinv(self._J.T)
        self._met_at_speed = np.zeros(len(self._J), bool)
        self._active = np.zeros(len(self._J), bool)
        self._sets: list[NDArray[np.int64]] = []

    def feed(self, v: Floats, x: Floats) -> None:
        """Follow the collision through the next n steps of the engine, or until it is over.

        `v` and `x` are the velocities in m/s and displacements in m after each step, shape (n, N axes).
        """
        finite = np.asarray(np.isfinite(v).all(axis=1) & np.isfinite(x).all(axis=1))
        before = np.vstack([self.velocities, v[:-1]])
        x_before = np.vstack([self.heights, x[:-1]])
        with np.errstate(invalid="ignore", over="ignore"):
            changes = self._inertia * (v - before)
            noise = self._world.rounding * self._inertia * (np.abs(v) + np.abs(before))
            moved = np.asarray((np.abs(changes) > noise).any(axis=1))
            impulses = changes @ self._impulses_of.T
            rates, limits = -(v @ self._J.T), np.abs(v) @ np.abs(self._J).T
            resting = np.maximum(RATE_ROUNDING * limits, self._world.resting_rate)
            approaching = np.asarray((rates > resting).any(axis=1))
        largest = np.abs(impulses).max(axis=1, keepdims=True)
        acts = moved[:, None] & (impulses > TURNED * largest)
        opened = x_before @ self._J.T > OPEN * self._world.radius
        n_finite = len(v) if finite.all() else int(finite.argmin())
        n_before, taken = self.n_steps, n_finite
        for row in _rows_of_change(acts, opened, moved)[:n_finite].nonzero()[0].tolist():
            self.n_steps = n_before + row + 1
            self._note_forces(acts[row], opened[row], impulses[row])
            self.velocities, self.heights = v[row], x[row]
            if not moved[row]:
                self.end = self._end_of_flight(bool(approaching[row]))
                if self.end != RunEnd.GOING:
                    taken = row + 1
                    break
        if self.end == RunEnd.GOING and n_finite < len(v):
            self.end = RunEnd.BROKEN
        if taken:
            self.n_steps, self.velocities, self.heights = n_before + taken, v[taken - 1], x[taken - 1]
        self._sets.append(acts[:taken] @ _bits(len(self._J)))
        loaded = np.flatnonzero(moved[:taken])
        if loaded.size:
            self._note_turning(x[loaded[-1]])

    def _note_forces(self, acts: Booleans, opened: Booleans, impulses: Floats) -> None:
        """Record the active contacts of a step, and update `starts` and `starts_together`.

        A change of velocity is added for each contact that becomes active in this step, if it was open or active
        before. Its bodies then met at a speed.
        """
        self._met_at_speed |= opened
        self._met_at_speed |= self._active & ~acts
        starting = acts & ~self._active & self._met_at_speed
        if starting.any():
            changes = np.where(acts, impulses * self._W.diagonal(), 0.0)
            self._starts += float(changes[starting].sum())
            for contact in np.flatnonzero(starting):
                neighbours = (self._W[contact] != 0) & acts
                neighbours[contact] = False
                others = np.minimum(changes[neighbours], changes[contact])
                self.starts_together += float(others.max(initial=0.0))
        self._met_at_speed &= ~acts
        self._active = acts

    def _note_turning(self, x: Floats) -> None:
        """Update `turning`, the largest angle by which a normal has turned.

        `x` are the displacements in m from the places where balls just touch, shape (N axes,).
        """
        places = np.reshape(x - self._start, (-1, self.scene.axes))
        for touch in self.scene.arrangement.touches:
            if touch.second is None:
                continue
            apart = places[touch.first] - places[touch.second]
            across = apart - (apart @ np.array(touch.normal)) * np.array(touch.normal)
            self.turning = max(self.turning, float(np.linalg.norm(across)) / (2 * self._world.radius))

    def _end_of_flight(self, approaching: bool) -> RunEnd:
        """Return the state of the run after a step without forces: over, ended by the flight, or going on.

        `approaching` is True if bodies in contact approach.
        """
        if not approaching:
            return RunEnd.APART
        rates, gaps = -(self._J @ self.velocities), self._J @ self.heights
        nearing = rates > 0
        soonest = float((np.maximum(gaps[nearing], 0.0) / rates[nearing]).min(initial=math.inf))
        if soonest > (self.max_steps - self.n_steps) * self.scene.step:
            return RunEnd.IN_FLIGHT
        if soonest > self.duration and self._distance_to_parting() <= SLOWEST_MEETING * self.scene.speed:
            return RunEnd.IN_FLIGHT
        return RunEnd.GOING

    def _distance_to_parting(self) -> float:
        """Return a bound in m/s on how much a meeting that is still to come can change a velocity."""
        change = project_to_parting(self.velocities, self.scene) - self.velocities
        return math.sqrt(float(self._inertia @ change**2) / float(self._inertia.min()))

    @property
    def starts(self) -> float:
        """Sum of the changes of relative velocities in m/s in the first time steps of contacts, scaled to whole steps.

        In its first step a dashpot gives only a fraction of a full step's impulse in some engines. The sum is divided
        by this fraction, `World.first_step_share`.
        """
        return self._starts / self._first_step_share

    @property
    def duration(self) -> float:
        """Duration of the collision in s."""
        return self.n_steps * self.scene.step

    @property
    def reported(self) -> tuple[float, ...]:
        """Final velocities in m/s, as the outcome reports them; shape (N axes,).

        After a flight that ends the run they are the nearest velocities at which all bodies part.
        """
        if self.end == RunEnd.IN_FLIGHT:
            return tuple(project_to_parting(self.velocities, self.scene).tolist())
        return tuple(self.velocities.tolist())

    @property
    def meeting_left(self) -> float:
        """Bound in m/s on how much a meeting that is still to come can change the reported velocities.

        It is 0 if bodies part, and infinite if the run has not come to an end.
        """
        if self.end == RunEnd.APART:
            return 0.0
        return self._distance_to_parting() if self.end == RunEnd.IN_FLIGHT else math.inf

    @property
    def over(self) -> bool:
        """True if the collision is over, or only a meeting that changes almost nothing is still to come."""
        return self.meeting_left <= SLOWEST_MEETING * self.scene.speed

    @property
    def status(self) -> Status:
        """``ok`` if the collision is over; ``crashed`` if the engine failed; else ``timeout``."""
        if self.over:
            return "ok"
        return "crashed" if self.end == RunEnd.BROKEN else "timeout"

    def problem(self) -> str:
        """Return the reason why the collision is not over; ``""`` if it is over."""
        if self.over:
            return ""
        after = f"after {self.n_steps} steps of {self.scene.step:.3g} s"
        if self.end == RunEnd.BROKEN:
            return f"{after}: {self.failure or 'velocities are no longer finite'}"
        return f"not over {after}"

    def merged_states(self, shortest_state: float) -> Runs:
        """Return the sequence of sets of active contacts, without very short states; times are numbers of steps.

        `states.merge_runs` removes the states that are shorter than `shortest_state` times the shortest contact period.
        """
        sets = np.concatenate([np.zeros(0, np.int64), *self._sets])
        starts = np.flatnonzero(np.diff(sets, prepend=-1))
        shortest = shortest_state * min(periods(self.scene)) / self.scene.step
        return merge_runs(Runs(starts, sets[starts], self.n_steps), shortest, int(_bits(len(self._J)).sum()))

    def energy_gain(self) -> float:
        """Return the gain of kinetic energy, over the kinetic energy at the start.

        Without a fixed body the kinetic energy is the energy of the motion relative to the centre of mass.
        """
        m = np.array(self.scene.masses)

        def kinetic(velocities: Floats) -> float:
            v = np.reshape(velocities, (len(m), -1))
            mean = 0.0 if self.scene.table else m @ v / m.sum()
            return 0.5 * float((m @ (v - mean) ** 2).sum())

        before = kinetic(np.array(self.scene.velocities))
        return (kinetic(self.velocities) - before) / before

    def too_much_energy(self) -> str:
        """Return a sentence for a run that ended with too much energy.

        The sentence is empty if the gain of energy is at most `ENERGY_GAIN_ALLOWED`.
        """
        return describe_energy_gain(self.energy_gain(), has_fixed_body=self.scene.table)


def _bits(contacts: int) -> NDArray[np.int64]:
    """Return for each contact the bit that stands for it in a set of contacts."""
    return 1 << np.arange(contacts, dtype=np.int64)


def follow_plane_scene(scene: Scene, world: World, max_steps: int) -> PlaneRun:
    """Run a scene in a plane until its collision is over or `max_steps` steps are taken.

    If the engine raises a RuntimeError, the run ends with the state `RunEnd.BROKEN`.
    """
    run = PlaneRun(scene, world, max_steps)
    try:
        while run.end == RunEnd.GOING and run.n_steps < max_steps:
            run.feed(*world.advance(min(WINDOW, max_steps - run.n_steps)))
    except RuntimeError as error:
        run.end, run.failure = RunEnd.BROKEN, " ".join(str(error).split())
    run.dropped = world.dropped
    return run
