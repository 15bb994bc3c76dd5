"""Independent solution of contact graphs by laws in time: DOP853 of scipy, events by sign changes on its dense output.

It uses nothing of the package but the parameters. Its steps are short compared with the fastest period, so that it
hardly ever misses two events that are close together. Contacts that become rigid cannot be solved.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

OPEN, LOADED, COMPRESSION, RESTITUTION, SLACK = range(5)
BISTIFFNESS, KELVIN_VOIGT = "bistiffness", "kelvin-voigt"
COMPRESSION_DASHPOT, LINEAR_DASHPOT = "compression-dashpot", "linear-dashpot"

#: Rates below this share of the largest one count as 0 where only their sign matters.
ZERO = 1e-12


class Answer(NamedTuple):
    impulses: np.ndarray
    rates: np.ndarray
    events: int


class _Run:
    def __init__(self, law, W, k, e, w, b):
        self.law, self.W, self.k, self.e, self.b = (
            law,
            np.array(W),
            np.array(k, float),
            np.array(e),
            np.array(b),
        )
        self.w, self.scale = np.array(w, float), np.abs(w).max()
        self.delta, self.impulses = np.zeros(len(k)), np.zeros(len(k))
        self.phase = np.full(len(k), OPEN)
        self.first = COMPRESSION if law in (BISTIFFNESS, COMPRESSION_DASHPOT) else LOADED
        self.phase[self.w > ZERO * self.scale] = self.first

    def decide(self):
        """Activate contacts at rest without depth that are about to be compressed; return the undecided ones.

        The first derivative of the rate of compression that is not 0 decides: a contact is active if it is positive. A
        contact that nothing presses or opens stays undecided.
        """
        undecided = (self.phase == OPEN) & (self.delta == 0) & (np.abs(self.w) <= ZERO * self.scale)
        self.w[undecided] = 0.0
        unit = 1 / np.sqrt((np.diagonal(self.W) * self.k).max())
        delta, rate = self.delta, self.w
        for _ in range(2 * len(self.k) + 2):
            terms = unit * self.W * self.forces(delta, rate)
            delta, rate = unit * rate, -terms.sum(axis=1)
            rate[np.abs(rate) <= 1e-11 * np.abs(terms).sum(axis=1)] = 0.0
            self.phase[undecided & (rate > 0)] = self.first
            undecided &= rate == 0
        return undecided

    def forces(self, delta, w):
        damped = np.isin(self.phase, (LOADED, COMPRESSION))
        active = damped | (self.phase == RESTITUTION)
        return np.where(active, self.k * delta, 0.0) + np.where(damped, self.b * w, 0.0)

    def watched(self, undecided):
        """Yield functions of (delta, w) that pass zero at an event, with direction, contact and next phase."""
        for i, phase in enumerate(self.phase):
            if undecided[i]:
                continue
            gap = lambda delta, w, i=i: delta[i]  # noqa: E731
            rate = lambda delta, w, i=i: w[i]  # noqa: E731
            force = lambda delta, w, i=i: self.k[i] * delta[i] + self.b[i] * w[i]  # noqa: E731
            if phase == OPEN:
                yield gap, 1, i, self.first
            elif phase == COMPRESSION:
                yield rate, -1, i, RESTITUTION
            elif phase == RESTITUTION:
                yield rate, 1, i, COMPRESSION
                yield gap, -1, i, OPEN
            elif phase == SLACK:
                yield force, 1, i, LOADED
                yield gap, -1, i, OPEN
            elif self.law == LINEAR_DASHPOT:
                yield gap, -1, i, OPEN
            else:
                yield force, -1, i, SLACK if self.b[i] else OPEN

    def follow(self, step):
        """Integrate to the first event, and apply the event."""
        n, functions = len(self.k), list(self.watched(self.decide()))
        moving = np.sqrt(np.linalg.eigvalsh(self.W)[-1] * self.k.max())
        moving += np.linalg.eigvalsh(self.W)[-1] * self.b.max()

        def slope(_, y):
            forces = self.forces(y[:n], y[n : 2 * n])
            return np.concatenate([y[n : 2 * n], -self.W @ forces, forces])

        def as_event(function, direction):
            def event(_, y):
                return function(y[:n], y[n : 2 * n])

            event.terminal, event.direction = True, direction
            return event

        start = np.concatenate([self.delta, self.w, self.impulses])
        went = solve_ivp(
            slope, (0, 1e6), start, "DOP853", max_step=step / moving, rtol=1e-13, atol=1e-15 * self.scale,
            events=[as_event(function, direction) for function, direction, *_ in functions],
        )  # fmt: skip
        self.delta, self.w, self.impulses = np.split(went.y[:, -1], 3)
        which = next(i for i, times in enumerate(went.t_events) if len(times))
        self.apply(*functions[which][2:])

    def apply(self, i, phase):
        before, self.phase[i] = self.phase[i], phase
        if phase == OPEN or before == OPEN:
            self.delta[i] = 0.0
        if {before, phase} == {COMPRESSION, RESTITUTION}:
            self.w[i] = 0.0
        if self.law == BISTIFFNESS and (before, phase) == (COMPRESSION, RESTITUTION):
            self.delta[i] *= self.e[i] ** 2
            self.k[i] /= self.e[i] ** 2


def integrate(law, W, k, e, w, b, *, step=0.05, most=400):
    run = _Run(law, W, k, e, w, b)
    for events in range(most):
        if not np.isin(run.phase, (LOADED, COMPRESSION, RESTITUTION)).any():
            closing = (run.w > ZERO * run.scale) & (run.phase == OPEN)
            if not closing.any():
                return Answer(run.impulses, run.w, events)
            times = np.where(closing, -run.delta / np.where(closing, run.w, 1.0), np.inf)
            run.delta = run.delta + times.min() * run.w
            run.phase[(run.phase == SLACK) & (run.delta <= 0)] = OPEN
            run.apply(int(times.argmin()), run.first)
            continue
        run.follow(step)
    raise AssertionError(f"not over after {most} events")
