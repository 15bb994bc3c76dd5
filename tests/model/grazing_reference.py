"""Grazing margins of balls with linear contacts, computed from the definition in docs/theory.md, section 6.

This is the independent reference for the margins that the model states. It uses no solver of the package. Between two
events the motion is a sum over the eigenvectors of the stiffness matrix, computed by numpy. Events and turning points
are sign changes on a fine grid, refined by bisection.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from impact_xval.model import Collision
from impact_xval.model.arrays import Floats

COMPRESSION, RESTITUTION, INACTIVE = "compression", "restitution", "inactive"

#: Points of the time grid per period of the fastest mode; largest number of segments per collision; largest number of
#: grid points per segment.
FINE, MOST_SEGMENTS, MOST_POINTS = 500, 100, 100_000

#: The margin ignores a turning point if the point could change less than the first share of the impact energy, or if
#: the rate there exceeds the second share of its amplitude.
LEAST_STAKE, LARGEST = 1e-6, 0.05


def sign_change(f: Callable[[Any], Any], low: float, high: float) -> float:
    """Find by bisection where a function that is positive at `low` stops being positive."""
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if f(middle) > 0 else (low, middle)
    return high


class Segment:
    """Motion of all balls while the same contacts are active, from the velocities and forces at the start."""

    def __init__(
        self, masses: Floats, rates: Floats, k: list[float], acting: list[int], v: Floats, F: Floats
    ) -> None:
        stiffness = sum(k[i] * np.outer(rates[i], rates[i]) for i in acting)
        root = 1 / np.sqrt(masses)
        squares, vectors = np.linalg.eigh(stiffness * np.outer(root, root))
        self.omega = np.sqrt(np.maximum(squares, 0))
        # a free motion of the bodies has no frequency; a very low one avoids a division by zero
        self.omega[self.omega < 1e-10 * self.omega.max()] = 1e-10 * self.omega.max()
        self.modes = root[:, None] * vectors
        self.a = vectors.T @ (v / root)
        pushes = rates[acting].T @ F[acting]
        self.b = vectors.T @ (-pushes * root) / self.omega
        self.k, self.F, self.shapes = k, F, rates @ self.modes

    def rate(self, i: int, t: Any) -> Any:
        """Return the compression rate of contact i at the times t."""
        angle = np.multiply.outer(t, self.omega)
        return (self.a * np.cos(angle) + self.b * np.sin(angle)) @ self.shapes[i]

    def slope(self, i: int, t: Any) -> Any:
        """Return the time derivative of the compression rate of contact i at the times t."""
        angle = np.multiply.outer(t, self.omega)
        return (self.omega * (self.b * np.cos(angle) - self.a * np.sin(angle))) @ self.shapes[i]

    def force(self, i: int, t: Any) -> Any:
        """Return the force of contact i at the times t: its stiffness times the integral of its compression rate."""
        angle = np.multiply.outer(t, self.omega)
        done = (self.a * np.sin(angle) + 2 * self.b * np.sin(0.5 * angle) ** 2) / self.omega
        return self.F[i] + self.k[i] * (done @ self.shapes[i])

    def amplitude(self, i: int) -> float:
        """Return the sum of the amplitudes of all sinusoids in the compression rate of contact i."""
        return float(np.abs(self.shapes[i]) @ np.hypot(self.a, self.b))

    def velocities(self, t: float) -> Floats:
        """Return the velocities of all balls at time t."""
        return self.modes @ (self.a * np.cos(self.omega * t) + self.b * np.sin(self.omega * t))


def reference(collision: Collision) -> tuple[float, Floats]:
    """Return the grazing margin and the final velocities of a collision, or NaN if the collision is too long."""
    masses, v, k = np.array(collision.masses), np.array(collision.velocities), list(collision.stiffnesses)
    e, contacts, balls = collision.restitutions, len(k), len(masses)
    # Row i turns the velocities of the balls into the compression rate of contact i, which is v_{i+1} - v_i.
    rates = np.eye(contacts, balls, 1) - np.eye(contacts, balls)
    relative = v if collision.table else v - masses @ v / masses.sum()
    energy = 0.5 * masses @ relative**2
    phases, F = [COMPRESSION if rate >= 0 else INACTIVE for rate in rates @ v], np.zeros(contacts)
    margin = np.inf
    for _ in range(MOST_SEGMENTS):
        acting = [i for i in range(contacts) if phases[i] != INACTIVE]
        if not acting:
            return margin, v
        here = Segment(masses, rates, k, acting, v, F)
        watched = functions_until_events(here, phases)
        step, start, events = 2 * np.pi / here.omega.max() / FINE, 0.0, []
        while not events and start < MOST_POINTS * step:
            grid = start + step * np.arange(501)
            for name, i, f in watched:
                # the first point of the grid is left out: a rate may be zero at the start
                below = np.flatnonzero(f(grid[1:]) < 0)
                if below.size:
                    low = max(grid[below[0]], 1e-7 * step)
                    events.append((sign_change(f, low, grid[below[0] + 1]), name, i))
            start = grid[-1]
        if not events:
            break
        end, name, i = min(events)
        margin = min(margin, *(nearest_turn(here, j, end, (1 - e[j] ** 2) / energy) for j in acting))
        v = here.velocities(end)
        F = np.array([here.force(j, end) if j in acting else 0.0 for j in range(contacts)])
        if name == "force":
            phases[i], F[i] = INACTIVE, 0.0
        else:
            v[i] = v[i + 1] if i + 1 < balls else 0.0
            ends = phases[i] == COMPRESSION
            phases[i] = RESTITUTION if ends else COMPRESSION
            k[i] /= e[i] ** 2 if ends else 1.0
    return np.nan, np.full(balls, np.nan)


def functions_until_events(here: Segment, phases: list[str]) -> list[tuple[str, int, Callable[[Any], Any]]]:
    """List the functions of time that stay positive until an event happens, each with its name and its contact."""
    watched: list[tuple[str, int, Callable[[Any], Any]]] = []
    for i in range(len(phases)):
        sign = 1.0 if phases[i] == COMPRESSION else -1.0
        watched.append(("rate", i, lambda t, i=i, sign=sign: sign * here.rate(i, t)))
        if phases[i] == RESTITUTION:
            watched.append(("force", i, lambda t, i=i: here.force(i, t)))
    return watched


def nearest_turn(here: Segment, i: int, end: float, loss: float) -> float:
    """Return the smallest absolute rate at a contact's turning points before `end`, relative to the rate's amplitude.

    Turning points without a stake are ignored (`LEAST_STAKE`, `LARGEST`). The result is infinite if none is left.
    """
    nearest, grid = np.inf, np.linspace(0, end, 1000 + int(100 * end * here.omega.max()))
    slopes = here.slope(i, grid)
    for at in np.flatnonzero(slopes[:-1] * slopes[1:] < 0):
        sign = np.sign(slopes[at])
        t = sign_change(lambda t, sign=sign: sign * here.slope(i, t), grid[at], grid[at + 1])
        share = abs(here.rate(i, t)) / here.amplitude(i)
        if share < LARGEST and loss * here.force(i, t) ** 2 / (2 * here.k[i]) > LEAST_STAKE:
            nearest = min(nearest, share)
    return float(nearest)
