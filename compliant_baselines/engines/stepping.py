"""A scene followed through the steps an engine takes, and what they say: impulses, states, and when it is over.

**Impulses** come from the balance of momentum, with gravity put back, for a step of length h:
dI_i = dI_{i-1} + m_i (dv_i + g h). No engine's own account of its contact forces is used.

**A contact carries force** in a step if its impulse exceeds `World.rounding` of the momenta the balance is made of.

**The collision is over** at the end of the first step in which no contact carries force and no bodies approach. In a
drop, gravity is off for good from the first flight on: the end of the first step in which no contact carries force and
at whose end both gaps are open. It is over when both gaps are open as well, or B2 is *at rest* on the table with B1
clear of it and rising, or both are *stuck*: when the energy about equilibrium cannot unload what is closed. Velocities
at rest are reported as 0; what v2 was is `rest_speed`. The reasons are in docs/theory.md, section 8; engines and
references keep these rules alike. A flight that outlasts the steps that are left is given up.

**A meeting that is left** when a flight is given up changes little if bodies approach slowly. Let p be any velocities
at which all bodies part, and |.| the kinetic norm. Contacts that only push, with impulses P_i >= 0, change v to v' = v
+ sum_i P_i n_i, where n_i . p >= 0. They create no energy, so |v' - p|^2 = |v'|^2 - 2 v' . p + |p|^2 <= |v - p|^2: the
end is no further from p than the flight is. Where the flight is within `SLOWEST_MEETING` of the nearest such p, the
collision is over, and p is reported.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_xval.compliant_baselines.engines.quiet import between, quiet_steps, rests, sticks
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, periods, reduced_masses
from impact_xval.compliant_baselines.states import Runs, merge_runs
from impact_xval.model.chain.record import ChainEnding
from impact_xval.model.compiled import strict_float, strict_float_helper
from impact_xval.model.path import Path
from impact_xval.model.status import Status

GOING, FREE = int(ChainEnding.UNFINISHED), int(ChainEnding.FREE)
REST, STUCK = int(ChainEnding.LOWER_SETTLED), int(ChainEnding.BOTH_SETTLED)

#: How a scan ended, beside `GOING`, `FREE`, `REST` and `STUCK`.
BROKEN, ALOFT, FLIGHT = 4, 5, 6

#: A recorded path has about as many points as this between the borders of its states.
PATH_POINTS = 2000

#: Energy an engine may create, over that at the start, before its answer counts as `unconverged`. Contacts of springs
#: and dashpots create none; an explicit step of 1/1000 of a period creates 1e-4 of it at most.
ENERGY_GAIN_ALLOWED = 0.01

#: Largest change of a velocity, over the speed at the start, by a meeting that is left when a collision counts as over:
#: a tenth of the default tolerance of a limit. Elastic balls that should rest approach one another at some 1e-8 by
#: MuJoCo's impedance, and at up to 1e-4 by what PyBullet's steps damp.
SLOWEST_MEETING = 1e-4

#: Steps read before the next look at what comes, those of an engine that leaps the first time, and its shortest leap.
WINDOW, SHORT_WINDOW, SHORTEST_LEAP = 256, 8, 8

#: Longest leap of a run that records its path: so many steps, or if that is more the quiet ones over this. In between
#: velocities are interpolated, on the default grid to 5e-5 of |v0|, as by leaps of 32; half the quiet steps give 7e-5.
PATH_LEAP, PATH_SHARE = 32, 4

#: What `scan` remembers from one call to the next:
#:
#: * loaded, met: the contacts that carry force, and those that are met at a speed if they begin to, as they have ceased
#:   to or were open at first; as bits;
#: * n_steps so far; again: `Run.starts`; together: `Run.starts_together`;
#: * lead, lead_contact: after so many steps of flight the contact closed, or, negative, it had closed so many before
#:   the other one opened. The nearest such event; infinite without one;
#: * flight: the step at which the first flight began (-1 before it, -2 once a gap has closed again);
#: * closed, closed_at: whether the gap of a contact is closed, and the step at which it last closed.
MEMORY = np.dtype(
    [("loaded", "i8"), ("met", "i8")]
    + [(name, "f8") for name in ("n_steps", "again", "together", "lead", "lead_contact", "flight")]
    + [(name, "f8", 2) for name in ("closed", "closed_at")]
)


@strict_float_helper
def _follow_gaps(memory, closed1, closed2):  # pragma: no cover (compiled)
    """Note by how much time the first flight begins or not."""
    now = memory.n_steps
    for contact in range(2):
        closed, other = (closed1, closed2) if contact == 0 else (closed2, closed1)
        was, lead, met = memory.closed[contact] > 0, np.inf, contact
        if closed and not was:
            memory.closed_at[contact] = now
            if memory.flight >= 0:
                lead, memory.flight = now - memory.flight, -2.0
        elif was and not closed and other:
            lead, met = memory.closed_at[1 - contact] - now, 1 - contact
        if abs(lead) < abs(memory.lead):
            memory.lead, memory.lead_contact = lead, met
    memory.closed[0], memory.closed[1] = 1.0 if closed1 else 0.0, 1.0 if closed2 else 0.0
    if memory.flight == -1 and not (closed1 or closed2):
        memory.flight = now


@strict_float_helper
def _end_of_drop(code, v, x, masses, weight):  # pragma: no cover (compiled)
    """How a drop of two balls ends after this step, if it does."""
    v1, v2, x1, x2 = v[0], v[1], x[0], x[1]
    if not code & 1 and x1 >= x2 and v1 >= v2:
        if not code & 2 and x2 >= 0 and v2 >= 0:
            return FREE
        if v1 >= 0 and rests(v, x, masses, weight, 1.0):
            return REST
    if code == 0 and x1 >= x2 >= 0:
        return FLIGHT
    if code == 3 and sticks(v, x, masses, weight, 1.0):
        return STUCK
    return GOING


@strict_float
def scan(
    v, x, before, masses, contacts, weight, rounding, h, left, codes, memory
):  # pragma: no cover (compiled)
    """Go through a window of steps until the collision is over: how many steps, and how it ended after the last.

    `v` in m/s and `x` in m, shape (n, N), are the state after each step, `before` the velocities before the first;
    `left` is the number of steps that may still be taken after these. `contacts` is N with a table, N - 1 without;
    `rounding` is as of `World`. `weight` holds of a drop g in m/s^2, k1 and k2 in N/m, and in m how deep B2 rests
    alone, B1 in B2, and B2 with B1 on it; else zeros. `codes`, shape (n,), is filled with the state of each step, as
    bits. The end is `GOING`, `FREE`, `REST`, `STUCK`, `ALOFT` (given up), `FLIGHT` (from here on without gravity), or
    `BROKEN` (a number that is not finite).
    """
    seen, balls, g = memory[0], masses.size, weight[0]
    for i in range(v.shape[0]):
        # Changes of relative velocity at the contact above: in this step, and of these those that were its first.
        above, above_first = 0.0, 0.0
        impulse, noise, code = 0.0, 0.0, np.int64(0)
        apart, meet = True, np.inf
        for j in range(balls):
            old = before[j] if i == 0 else v[i - 1, j]
            if not (math.isfinite(v[i, j]) and math.isfinite(x[i, j])):
                return i, BROKEN
            impulse += masses[j] * (v[i, j] - old + g * h)
            noise += rounding * masses[j] * (abs(v[i, j]) + abs(old) + g * h)
            if j == contacts:
                break
            inverse, rate, gap = 1 / masses[j], -v[i, j], x[i, j]
            if j + 1 < balls:
                inverse += 1 / masses[j + 1]
                rate, gap = v[i, j + 1] - v[i, j], x[i, j] - x[i, j + 1]
            bit = 1 << j
            change, first = 0.0, 0.0
            if impulse > noise:
                code |= bit
                change = impulse * inverse
                if seen.met & bit and not seen.loaded & bit:
                    first = change
                    seen.again += first
            elif seen.loaded & bit:
                seen.met |= bit
            if first > 0 or above_first > 0:
                seen.together += min(change, above)
            above, above_first = change, first
            if rate > 0:
                apart = False
                meet = min(meet, max(gap, 0.0) / rate)
        seen.loaded = codes[i] = code
        seen.n_steps += 1
        if g > 0 or seen.flight >= 0:
            _follow_gaps(seen, x[i, 0] < x[i, 1], x[i, 1] < 0)
        end = GOING
        if g > 0:
            end = _end_of_drop(code, v[i], x[i], masses, weight)
        elif code == 0 and apart:
            end = FREE
        elif code == 0 and meet > (v.shape[0] - i + left) * h:
            end = ALOFT
        if end != GOING:
            return i + 1, end
    return v.shape[0], GOING


def parted(velocities: Sequence[float], weights: Sequence[float], table: bool = True) -> tuple[float, ...]:
    """Nearest velocities with v1 >= v2 >= ..., and >= 0 on a table, in the kinetic norm; `weights` are masses.

    Neighbours in the wrong order are pooled until none are (isotonic regression).
    """
    pools: list[tuple[float, float, int]] = []
    for velocity, weight in zip(velocities, weights, strict=True):
        v, w, n = velocity, weight, 1
        while pools and v > pools[-1][0]:
            above, mass, count = pools.pop()
            v, w, n = (mass * above + w * v) / (mass + w), mass + w, n + count
        pools.append((v, w, n))
    return tuple(max(v, 0.0) if table else v for v, _, n in pools for _ in range(n))


class Run:
    """What an engine made of a scene: takes its steps in blocks until the collision is over, and says what came of it.

    Heights at the `start`, as the engine had them, and `velocities` and `heights` after `n_steps` have the shape (N,).
    `end` is as of `scan`: `GOING` if it ran out of `max_steps`; `failure` is what the engine itself complained of.
    `fall` is the number of steps and the heights at the first flight, from which on bodies no longer fall.
    """

    def __init__(self, scene: Scene, world: World, max_steps: int, record_path: bool = False) -> None:
        self.scene, self.max_steps, self.end, self.n_steps, self.failure = scene, max_steps, GOING, 0, ""
        self.velocities, self.heights = np.array(scene.velocities, float), np.array(world.heights, float)
        self.start, self.effective, self.accuracy = self.heights, dict(world.effective), world.accuracy
        self.dropped = world.dropped
        self.fall: tuple[int, Floats] | None = None
        self._masses, self._rounding, self._code = np.array(scene.masses), world.rounding, -1
        self._weight = np.zeros(6)
        if scene.gravity:
            (m1, m2), (k1, k2), g, rest = scene.masses, scene.stiffnesses, scene.gravity, world.rest
            k2 = m2 * g / rest if rest else k2
            # On a rigid support nothing goes in; the stiffnesses asked for still say what a small energy is.
            together = (m1 * g / k1, rest + m1 * g / k2) if rest else (0.0, 0.0)
            self._weight[:] = g, k1, k2, rest, *together
        if world.longest_leap:
            says = world.effective
            self._law = np.array([says["stiffness"], says["damping"], reduced_masses(scene)])
        # A record array: an interpreted `scan` reads its fields too. Closed as far back as there was a past.
        memory = self._memory = np.zeros(1, MEMORY).view(np.recarray)
        memory.lead, memory.flight, memory.closed, memory.closed_at = np.inf, -1, 1, -np.inf
        memory.met = (scene.gaps > 0) @ (1 << np.arange(len(scene.stiffnesses)))
        # Steps after which the state is another, and that state, by windows.
        self._changes = [(np.zeros(0, np.int64), np.zeros(0, np.int64))]
        # Points of the path: every `_stride`-th, borders between states, and the ends.
        self._points = [np.array([[0.0, *scene.velocities]])] if record_path else []
        self._stride, self._size = 1, 0

    def feed(self, v: Floats, x: Floats) -> bool:
        """Take velocities and heights after the next steps, shape (n, N), up to the end, or to a first flight.

        Gives whether it is that, so that the engine has to go on from the state of this run without gravity.
        """
        codes = np.empty(len(v), np.int64)
        left, contacts = self.max_steps - self.n_steps - len(v), len(self.scene.stiffnesses)
        before, h = self.velocities, self.scene.step
        how = self._masses, contacts, self._weight, self._rounding, h, left, codes, self._memory
        n, self.end = scan(v, x, before, *how)
        if n:
            changes = np.flatnonzero(codes[:n] != np.append(self._code, codes[: n - 1]))
            self._changes.append((changes + self.n_steps, codes[changes]))
            if self._points:
                number = self.n_steps + 1 + np.arange(n)
                wanted = number % self._stride == 0
                wanted[-1] = True
                wanted[changes[changes > 0] - 1] = True
                self._keep(number[wanted], v[:n][wanted])
            self.velocities, self.heights, self._code = v[n - 1].copy(), x[n - 1].copy(), int(codes[n - 1])
            self.n_steps += n
        if self.end != FLIGHT:
            return False
        self.fall = self.n_steps, self.heights
        self._weight, self.end = np.zeros(6), GOING
        return True

    def _keep(self, number: NDArray[np.int64], velocities: Floats) -> None:
        self._points.append(np.column_stack([number, velocities]))
        self._size += len(number)
        if self._size > 4 * PATH_POINTS:
            self.thin()

    def thin(self) -> None:
        """Double the stride until the points of the path between borders are at most `PATH_POINTS`."""
        points = np.concatenate(self._points)
        number = points[:, 0].astype(np.int64)
        border = np.isin(number, self.raw.start)
        border[[0, -1]] = True
        keep = np.ones(len(number), bool)
        while np.count_nonzero(keep & ~border) > PATH_POINTS:
            self._stride *= 2
            keep = border | (number % self._stride == 0)
        self._points, self._size = [points[keep]], int(keep.sum())

    def quiet_steps(self) -> int:
        """Count the next steps in which nothing will happen (`engines.quiet`)."""
        state = self._code, self.velocities, self.heights, self._masses
        return quiet_steps(*state, self._law, self._weight, self.scene.step)

    def skip(self, n: int, v: Floats, x: Floats) -> None:
        """Take n steps together in which nothing happened; velocities and heights after the last, shape (N,) each.

        Points of the path in between are interpolated, which is of fourth order in the time of the n steps.
        """
        if self._points:
            first, last = (self.n_steps // self._stride + 1) * self._stride, self.n_steps + n
            number = np.append(np.arange(first, last, self._stride), last)
            ends = self.velocities, self.heights, v, x
            how = (number - self.n_steps) / n, n * self.scene.step, self._masses, self._law, self._weight[0]
            self._keep(number, between(self._code, *ends, *how))
        self.velocities, self.heights = v, x
        self.n_steps += n
        self._memory.n_steps += n

    @property
    def raw(self) -> Runs:
        """States step by step, nothing merged."""
        start, state = map(np.concatenate, zip(*self._changes, strict=True))
        return Runs(start, state, self.n_steps)

    @property
    def starts(self) -> float:
        """What contacts met at a speed did in their first steps: changes of the relative velocity, summed, in m/s.

        When within a step one is met is arbitrary: so much depends on it.
        """
        return float(self._memory.again[0])

    @property
    def starts_together(self) -> float:
        """What neighbouring contacts did in one step, the first step of one of them: the lesser change, summed, in m/s.

        Contacts that are met one after the other may fall into one step. The lesser one says how much they depend on
        one another; where an engine's rounding alone loads a contact, it is next to nothing.
        """
        return float(self._memory.together[0])

    @property
    def lead(self) -> tuple[float, int]:
        """Time in s by which its first flight began, or, negative, did not, and the contact, from 0, that decided."""
        return float(self._memory.lead[0]) * self.scene.step, int(self._memory.lead_contact[0])

    @property
    def points(self) -> Floats | None:
        """Number of the step (0 is the start) and velocities after it, shape (n, 1 + N); None if not asked for."""
        return self._points[0] if self._points else None

    @property
    def duration(self) -> float:
        """Time it took, in s."""
        return self.n_steps * self.scene.step

    @property
    def meeting_left(self) -> float:
        """Bound in m/s the difference of the velocities at the end from those reported, by a meeting that is left.

        Infinite where the run stopped otherwise than in flight, 0 where the collision came to its end.
        """
        if self.end != ALOFT:
            return 0.0 if self.end in (FREE, REST, STUCK) else math.inf
        distance = math.sqrt(float(self._masses @ (self.velocities - self.reported) ** 2))
        return distance / math.sqrt(float(self._masses.min()))

    @property
    def over(self) -> bool:
        """Whether the collision came to its end, but for a meeting that changes next to nothing."""
        return self.meeting_left <= SLOWEST_MEETING * self.scene.speed

    @property
    def status(self) -> Status:
        """``ok`` if the collision came to its end; ``crashed`` if the engine broke; else ``timeout``."""
        return "ok" if self.over else "crashed" if self.end == BROKEN else "timeout"

    @property
    def reported(self) -> tuple[float, ...]:
        """Velocities in m/s as an outcome states them: those of balls at rest are 0.

        In a flight that was given up they are the nearest at which all bodies part.
        """
        v = self.velocities.tolist()
        if self.end == ALOFT:
            return parted(v, self.scene.masses, self.scene.table)
        return tuple([0.0, 0.0] if self.end == STUCK else [v[0], 0.0] if self.end == REST else v)

    def problem(self) -> str:
        """Why the collision is not over, in words; empty if it is."""
        if self.over:
            return ""
        if self.end == BROKEN:
            why = self.failure or "velocities are no longer finite"
            return f"after {self.n_steps} steps of {self.scene.step:.3g} s: {why}"
        reason = f"not over after {self.max_steps} steps of {self.scene.step:.3g} s"
        if self.end == ALOFT:
            reason += f" (after {self.n_steps} all balls are in flight, and meet again only after the last)"
        return reason

    def impulses(self, velocities: ArrayLike, time: Floats | float) -> Floats:
        """Impulses in N s up to a time in s, from the velocities then; gravity, until the first flight, put back."""
        c = self.scene
        falling = time if self.fall is None else np.minimum(time, self.fall[0] * c.step)
        changes = np.array(velocities) - np.array(c.velocities) + c.gravity * np.expand_dims(falling, -1)
        return np.cumsum(np.array(c.masses) * changes, axis=-1)[..., : len(c.stiffnesses)]

    def states(self, shortest_state: float) -> Runs:
        """State sequence, in steps; `shortest_state` as in `solver.Settings`."""
        c = self.scene
        closed = (c.gaps == 0) @ (1 << np.arange(len(c.stiffnesses)))
        return merge_runs(self.raw, shortest_state * min(periods(c)) / c.step, closed)

    def energy_gain(self) -> float:
        """Give the energy gained over the kinetic energy at the start: a positive value is the engine's doing.

        Kinetic energy, without a table that about the centre of mass, and, as long as the bodies fall, height count,
        and so does what the support of a settled B2 holds at the start; not what springs hold at the end.
        """
        c, m = self.scene, np.array(self.scene.masses)

        def kinetic(v: Floats) -> float:
            return 0.5 * float(m @ (v if c.table else v - m @ v / m.sum()) ** 2)

        # A linear support that carries m2 g at the penetration -x2 holds half their product.
        held = -0.5 * c.masses[-1] * c.gravity * float(self.start[-1])
        fallen = c.gravity * float(m @ ((self.heights if self.fall is None else self.fall[1]) - self.start))
        before = kinetic(np.array(c.velocities))
        return (kinetic(self.velocities) + fallen - before - held) / before

    def too_much_energy(self) -> str:
        """Why the result is not converged, if it gained so much energy; else empty."""
        if (gain := self.energy_gain()) <= ENERGY_GAIN_ALLOWED:
            return ""
        return f"it ended with {gain:.1%} more energy than it began with: the step is too long"

    def path(self, runs: Runs) -> Path:
        """Give the recorded path under a (merged) state sequence."""
        assert self.points is not None
        # Step n ends at point n. The state of a point is that of the step before it; at a border the point is
        # given again, with the state of the step after it.
        times = 1 + np.isin(self.points[:, 0], runs.start[1:])
        step = np.repeat(self.points[:, 0].astype(np.int64), times)
        of = np.maximum(step - 1, 0) + np.append(False, step[1:] == step[:-1])
        state = runs.state[np.searchsorted(runs.start, of, side="right") - 1]
        velocities, time = np.repeat(self.points[:, 1:], times, axis=0), np.float64(self.scene.step) * step
        impulses = self.impulses(velocities, time)
        between = np.diff(time)[:, None]  # of a point that is given twice none, and the force before it
        means = np.diff(impulses, axis=0) / np.where(between > 0, between, 1.0)
        forces = np.vstack([means[:1], np.where(between > 0, means, np.roll(means, 1, axis=0))])
        acting = (state[:, None] >> np.arange(impulses.shape[1]) & 1).astype(np.bool_)
        return Path(time, velocities, impulses, forces, acting)


def follow(scene: Scene, world: World, max_steps: int, record_path: bool = False) -> Run:
    """Run a scene until its collision is over or `max_steps` steps are taken; a RuntimeError of the engine ends it."""
    run = Run(scene, world, max_steps, record_path)
    longest = world.longest_leap
    window = SHORT_WINDOW if longest else WINDOW
    try:
        while run.end == GOING and (left := max_steps - run.n_steps) > 0:
            quiet = run.quiet_steps() if longest else 0
            n = min(quiet, max(PATH_LEAP, quiet // PATH_SHARE) if record_path else quiet, left, longest)
            if n >= SHORTEST_LEAP:
                run.skip(*world.leap(n))
                window = SHORT_WINDOW
                continue
            if run.feed(*world.advance(min(window, left))):
                world.weightless(run.velocities, run.heights)
            window = min(2 * window, WINDOW)
    except RuntimeError as error:
        run.end, run.failure = BROKEN, " ".join(str(error).split())
    run.dropped = world.dropped
    if record_path:
        run.thin()
    return run
