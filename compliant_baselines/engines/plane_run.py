"""Runs of a scene in a plane through the steps of an engine: they find forces and the end of the collision.

All contacts touch at t = 0, and there is no gravity. With velocities v, displacements x and the matrix J of fixed
normals (`Arrangement.jacobian`), rates of compression are -J v and gaps are J x.

**A contact carries force** in a step if its impulse is larger than rounding, and larger than `TURNED` times the largest
impulse of the step. Rounding is the fraction `World.rounding` of the momenta. The impulses P follow from the changes of
momentum, J^T P = M dv, by least squares. If J^T does not have full rank, contacts depend on one another, and this is
one of several ways to distribute the impulses. The impulses decide on states and on the error of a limit, but never
change velocities.

**The collision is over** at the end of the first step in which momenta change only by rounding and no bodies in contact
approach. The run also ends in flight, while bodies still approach, if two conditions are satisfied. The next meeting is
further ahead than the collision has lasted, and it can change velocities only a little, by the bound of `stepping`.
Then the nearest velocities, in the kinetic norm, at which all bodies part are reported. A flight that lasts longer than
the remaining steps is given up.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize  # pyright: ignore[reportMissingTypeStubs]

from impact_xval.compliant_baselines.engines.scanner import RunEnd
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, periods
from impact_xval.compliant_baselines.engines.stepping import (
    ENERGY_GAIN_ALLOWED,
    SLOWEST_MEETING,
    WINDOW,
    FlightLead,
)
from impact_xval.compliant_baselines.states import Runs, merge_runs
from impact_xval.model.arrays import Booleans
from impact_xval.model.status import Status

_optimize: Any = optimize

#: Fraction of the largest impulse of a step. Normals that have turned may make so much appear at another contact, and
#: such an impulse is ignored.
TURNED = 1e-4

#: Gap in radii above which a contact has opened. It is larger than the rounding of positions and an initial overlap.
OPEN = 2.0**-44

#: Rounding of a rate of compression, over the sum of the magnitudes of its terms.
RATE_ROUNDING = 2.0**-48


def project_to_parting(velocities: Floats, scene: Scene) -> Floats:
    """Return the nearest velocities, in the kinetic norm, at which no bodies in contact approach; shape (N axes,).

    They are v + M^-1 J^T P, where P >= 0 are the impulses of a plastic impact at all contacts.
    """
    J, root = scene.arrangement.jacobian, np.sqrt(scene.inertia)
    impulses: Floats = _optimize.nnls((J / root).T, -root * velocities)[0]
    return velocities + J.T @ impulses / scene.inertia


def _rows_of_change(acts: Booleans, opened: Booleans, moved: Booleans) -> Booleans:
    """Return the steps of a block that `PlaneRun` looks at one by one, shape (n steps,).

    These are the first step, each step in which a contact becomes active, inactive or opens, and the first step of each
    flight. In later steps of a flight the velocities are the same, and the next meeting comes nearer by one step while
    one step fewer remains: whether the flight ends the run does not change.

    Parameters
    ----------
    acts, opened
        Contacts that carry force in each step, and contacts that are open before it, shape (n steps, N contacts).
    moved
        Steps in which the momentum of a body changes, shape (n steps,).
    """
    open_and_idle = opened & ~acts
    changes = np.ones(len(acts), bool)
    changes[1:] = (acts[1:] != acts[:-1]).any(axis=1) | (open_and_idle[1:] != open_and_idle[:-1]).any(axis=1)
    changes[1:] |= moved[:-1] & ~moved[1:]
    return changes


class PlaneRun:
    """A run of a scene in a plane, during or after the collision; members are named as in `stepping.Run`.

    Attributes
    ----------
    scene
        The scene.
    max_steps
        Number of steps after which the run is given up.
    n_steps
        Number of steps taken.
    end
        State of the run; still `RunEnd.GOING` if all `max_steps` are taken.
    failure
        The error message of an engine that failed.
    velocities, heights
        Velocities in m/s and heights in m after the last step, shape (N axes,).
    effective, accuracy, dropped
        The members of these names of the `World`.
    starts, starts_together
        Sum of the changes of relative velocities in m/s in the first steps of contacts whose bodies met at a speed; and
        the part of this sum that depends on another contact of the same body.
    turning
        Largest angle in rad by which a normal has turned until the last step with a force.
    first_flight, flight_lead, b2_settled
        Values for a run without gravity: no first flight, an infinite lead, and B2 not settled.
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
        """Go through the next steps until the collision is over; v and x are their results, shape (n, N axes)."""
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
        """Record the active contacts of a step, and the changes of velocity by contacts that begin in it at a speed."""
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
        """Record by which angle the normals of contacts have turned at the displacements x in m, shape (N axes,)."""
        places = np.reshape(x - self._start, (-1, self.scene.axes))
        for touch in self.scene.arrangement.touches:
            if touch.second is None:
                continue
            apart = places[touch.first] - places[touch.second]
            across = apart - (apart @ np.array(touch.normal)) * np.array(touch.normal)
            self.turning = max(self.turning, float(np.linalg.norm(across)) / (2 * self._world.radius))

    def _end_of_flight(self, approaching: bool) -> RunEnd:
        """Return the state of the run after a step without forces; `approaching` says if bodies in contact approach."""
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
        """Return a bound in m/s on the change of a velocity by a meeting that is still to come."""
        change = project_to_parting(self.velocities, self.scene) - self.velocities
        return math.sqrt(float(self._inertia @ change**2) / float(self._inertia.min()))

    @property
    def starts(self) -> float:
        """Changes of velocities in m/s in the first steps of contacts, summed and scaled to whole steps.

        The scale is `World.first_step_share`.
        """
        return self._starts / self._first_step_share

    @property
    def duration(self) -> float:
        """Duration of the collision in s."""
        return self.n_steps * self.scene.step

    @property
    def reported(self) -> tuple[float, ...]:
        """Velocities in m/s that the outcome reports, shape (N axes,)."""
        if self.end == RunEnd.IN_FLIGHT:
            return tuple(project_to_parting(self.velocities, self.scene).tolist())
        return tuple(self.velocities.tolist())

    @property
    def meeting_left(self) -> float:
        """Bound in m/s on the change of the reported velocities by a meeting that is still to come."""
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
        """Return the filtered sequence of states, with times in steps (`states.merge_runs`).

        `shortest_state` is `Settings.shortest_state`.
        """
        sets = np.concatenate([np.zeros(0, np.int64), *self._sets])
        starts = np.flatnonzero(np.diff(sets, prepend=-1))
        shortest = shortest_state * min(periods(self.scene)) / self.scene.step
        return merge_runs(Runs(starts, sets[starts], self.n_steps), shortest, int(_bits(len(self._J)).sum()))

    def energy_gain(self) -> float:
        """Return the gain of kinetic energy, over the kinetic energy at the start.

        Without a fixed body the energy is that of the motion relative to the centre of mass.
        """
        m = np.array(self.scene.masses)

        def kinetic(velocities: Floats) -> float:
            v = np.reshape(velocities, (len(m), -1))
            mean = 0.0 if self.scene.table else m @ v / m.sum()
            return 0.5 * float((m @ (v - mean) ** 2).sum())

        before = kinetic(np.array(self.scene.velocities))
        return (kinetic(self.velocities) - before) / before

    def too_much_energy(self) -> str:
        """Return the reason why a result with too much energy is not converged.

        ``""`` if it has not gained too much.
        """
        if (gain := self.energy_gain()) <= ENERGY_GAIN_ALLOWED:
            return ""
        return f"it ended with {gain:.1%} more energy than it began with: the step is too long"


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
