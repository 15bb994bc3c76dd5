"""Independent solution of contact graphs by the model: normal modes between events, events by sign changes on a grid.

It uses nothing of the package but the parameters. Between events the motion is a sum over the eigenvectors of
A = sqrt(K) W sqrt(K), where K holds the stiffnesses and W is the Delassus matrix. No event is certified: two events
within one step of the grid are missed, and then a finer grid gives another answer. Contacts with e = 0 and contacts
that become rigid cannot be solved.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

INACTIVE, COMPRESSION, RESTITUTION = range(3)

#: Rates and forces below this share of the largest one count as 0 where only their sign matters.
ZERO = 1e-12

#: Step of the time grid in radians of the fastest mode, and number of grid points that are evaluated at once.
RESOLUTION, POINTS = 0.02, 4000


class Answer(NamedTuple):
    impulses: np.ndarray
    rates: np.ndarray
    events: int


class _Modes:
    """Motion with a fixed set of active contacts: forces, rates and impulses at any time after a given state."""

    def __init__(self, W, k, active, F, w):
        self.W, self.active, self.w = W[:, active], active, w
        self.root = np.sqrt(k[active])
        values, self.Q = np.linalg.eigh(self.root[:, None] * W[np.ix_(active, active)] * self.root)
        self.omega = np.sqrt(np.where(values > 1e-13 * values[-1], values, 0.0))
        self.z, self.u = self.Q.T @ (F[active] / self.root), self.Q.T @ (self.root * w[active])

    def impulse(self, t):
        """Return the impulses of the A active contacts since the start, shape (..., A)."""
        t = np.asarray(t)[..., None]
        oscillates = self.omega > 0
        omega = np.where(oscillates, self.omega, 1.0)
        phase = omega * t
        swing = self.z * np.sin(phase) / omega + self.u * 2 * (np.sin(0.5 * phase) / omega) ** 2
        return np.where(oscillates, swing, self.z * t) @ self.Q.T * self.root

    def at(self, t):
        """Return the forces of the active contacts, shape (..., A), and the rates of all contacts, shape (..., C)."""
        t = np.asarray(t)[..., None]
        oscillates = self.omega > 0
        omega = np.where(oscillates, self.omega, 1.0)
        swing = self.z * np.cos(omega * t) + self.u / omega * np.sin(omega * t)
        forces = np.where(oscillates, swing, self.z) @ self.Q.T * self.root
        return forces, self.w - self.impulse(t[..., 0]) @ self.W.T


def integrate(W, k, e, w, *, resolution=RESOLUTION, most=2000):
    W, k, e, w = (np.array(x, float) for x in (W, k, e, w))
    scale, contacts = np.abs(w).max(), len(k)
    F, impulses, phase = np.zeros(contacts), np.zeros(contacts), np.full(contacts, INACTIVE)
    for events in range(most):
        _start(W, k, w, F, phase, scale)
        active = np.flatnonzero(phase != INACTIVE)
        if not active.size:
            return Answer(impulses, w, events)
        modes = _Modes(W, k, active, F, w)
        t, contact, is_force = _first_event(modes, phase, active, resolution, scale)
        impulses[active] += modes.impulse(t)
        F[active], w = modes.at(t)
        _apply(k, e, w, F, phase, contact, is_force)
    raise AssertionError(f"not over after {most} events")


def _start(W, k, w, F, phase, scale):
    """Activate contacts without force whose bodies approach or are about to.

    If the rate of compression is 0, its first derivative that is not 0 decides: the contact is active if it is
    positive.
    """
    idle = (F == 0) & (phase != RESTITUTION)
    phase[idle] = INACTIVE
    undecided = idle & (np.abs(w) <= ZERO * scale)
    w[undecided] = 0.0
    phase[idle & (w > 0)] = COMPRESSION
    force, rate, unit = F.copy(), w.copy(), 1 / np.sqrt((np.diagonal(W) * k).max())
    for _ in range(2 * len(k) + 2):
        active = phase != INACTIVE
        # Take the next derivative, multiplied by the unit of time.
        terms = unit * W * force
        force, rate = np.where(active, unit * k * rate, 0.0), -terms.sum(axis=1)
        rate[np.abs(rate) <= 1e-11 * np.abs(terms).sum(axis=1)] = 0.0
        decided = undecided & (rate != 0)
        phase[decided & (rate > 0)] = COMPRESSION
        undecided &= ~decided


def _first_event(modes, phase, active, resolution, scale):
    """Return the time of the first event, its contact, and whether the force (not the rate) passes zero there."""
    restoring = np.flatnonzero(phase[active] == RESTITUTION)
    signs = np.where(phase == COMPRESSION, 1.0, -1.0)

    def watched(t):
        forces, rates = modes.at(t)
        unit = scale * np.sqrt(modes.root.max() ** 2 / np.diagonal(modes.W[active]).max())
        return np.concatenate([rates * signs / scale, forces[..., restoring] / unit], axis=-1)

    def found(t, which):
        contacts = len(phase)
        is_force = which >= contacts
        return t, active[restoring[which - contacts]] if is_force else which, is_force

    step, start = resolution / modes.omega.max(), 0.0
    before = watched(0.0)
    while True:
        times = start + step * np.arange(1, POINTS + 1)
        values = np.vstack([before, watched(times)])
        falls = (values[1:] < 0).any(axis=1)
        if not falls.any():
            start, before = times[-1], values[-1]
            continue
        i = int(np.argmax(falls))
        ends = []
        for which in np.flatnonzero(values[i + 1] < 0):
            left = times[i] - step
            if values[i, which] <= ZERO and left == 0.0:
                ends.append((0.0, which))  # the function is zero at the start and falls
            else:
                root = brentq(
                    lambda t, which=which: watched(t)[which], left, times[i], xtol=1e-300, rtol=1e-15
                )
                ends.append((root, which))
        return found(*min(ends))


def _apply(k, e, w, F, phase, i, is_force):
    if is_force:
        F[i], phase[i] = 0.0, INACTIVE
    elif phase[i] == COMPRESSION:
        w[i], phase[i] = 0.0, RESTITUTION
        k[i] /= e[i] ** 2
    else:
        w[i], phase[i] = 0.0, COMPRESSION
