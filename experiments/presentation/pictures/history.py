"""A collision over time, from the path of an outcome: forces, heights and state at any instant, dimensionless.

**Units** are those in which m1 = k1 = 1 and v0 = -1 (`Collision.units`): time sqrt(m1/k1), impulse m1 abs(v0), force
abs(v0) sqrt(m1 k1).

**The clock.** References and engines move in time. The model is stated in impulses and has no time; its path carries
the time in which its contact forces, F = sqrt(2 k E), pass on those impulses: dI = F dt turns equation (15),
dI2/dI1 = sqrt(k2 E2/(k1 E1)), into two springs in time. Of a contact without or with infinite stiffness it is infinite
or meaningless, and such a collision has no history.

**Forces** are impulses over times between neighbouring points of the path, at the middle of each; **heights** are
integrals of velocities. The model has no positions: its heights are those that its velocities imply, and where balls
of the model still overlap when their contact has ended, that is what its assumption of frozen positions leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.collision import Collision, Path

Floats = NDArray[np.float64]

#: Share of the impulses that may pass after what is shown: balls may meet again long after.
TAIL = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """A collision over time.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Instants since first touch, rising.
    velocities, heights : ndarray, shape (n, 2)
        Of B1 and B2; heights are 0 where springs are unloaded and touch.
    impulses : ndarray, shape (n, 2)
        Passed so far by contacts 1 and 2.
    state : ndarray of int, shape (n,)
        From each instant on, 1 to 4 for S1 to S4.
    """

    time: Floats
    velocities: Floats
    heights: Floats
    impulses: Floats
    state: NDArray[np.int64]

    @property
    def between(self) -> Floats:
        """Middles of the intervals, shape (n - 1,): instants of `forces`."""
        return 0.5 * (self.time[1:] + self.time[:-1])

    @property
    def forces(self) -> Floats:
        """Mean force of contacts 1 and 2 in every interval, shape (n - 1, 2)."""
        return np.diff(self.impulses, axis=0) / np.diff(self.time)[:, None]

    @property
    def compressions(self) -> Floats:
        """Of the springs of contacts 1 and 2, shape (n, 2); negative where the contact is open."""
        return np.stack([self.heights[:, 1] - self.heights[:, 0], -self.heights[:, 1]], axis=1)

    @property
    def ended(self) -> float:
        """When all impulses but `TAIL` of their sum have passed."""
        return passed_at(self.time, self.impulses)

    def height(self, time: Floats) -> Floats:
        """Heights at instants, shape (m, 2); after the last one bodies fly on as they do then."""
        within = np.column_stack([np.interp(time, self.time, x) for x in self.heights.T])
        return within + np.maximum(time - self.time[-1], 0.0)[:, None] * self.velocities[-1]

    def velocity(self, time: Floats) -> Floats:
        """Velocities at instants, shape (m, 2)."""
        return np.column_stack([np.interp(time, self.time, v) for v in self.velocities.T])

    def force(self, time: Floats) -> Floats:
        """Give forces of contacts 1 and 2 at instants, shape (m, 2); 0 after the last one."""
        forces = np.column_stack([np.interp(time, self.between, f) for f in self.forces.T])
        return np.where((time > self.time[-1])[:, None], 0.0, forces)

    def state_at(self, time: Floats) -> NDArray[np.int64]:
        """State at instants, shape (m,); S4 after the last one."""
        at = np.searchsorted(self.time, time, side="right") - 1
        return np.where(time >= self.time[-1], 4, self.state[at])


def passed_at(time: Floats, impulses: Floats) -> float:
    """Return when all impulses but `TAIL` of their sum have passed, for impulses so far of shape (n, 2)."""
    passed = impulses.sum(axis=1)
    return float(time[np.searchsorted(passed, (1 - TAIL) * passed[-1])])


def history_of(collision: Collision, path: Path, gravity: float = 0.0) -> History | None:
    """Make a history of a path.

    Parameters
    ----------
    collision : Collision
    path : Path
        In the units of the collision.
    gravity : float
        In m/s^2: with it B2 begins in static equilibrium on its support.

    Returns
    -------
    History or None
        None where the path has no finite clock.
    """
    unit = collision.units
    time = path.time / unit.time
    if not (np.isfinite(time).all() and time[-1] > 0):
        return None
    # On a border a point is given once for each state: the last of them says what follows.
    kept = np.append(np.diff(time) > 0, True)
    time, state = time[kept], path.state[kept]
    velocities = np.column_stack([path.v1, path.v2])[kept] / unit.velocity
    impulses = np.column_stack([path.impulse1, path.impulse2])[kept] / unit.impulse
    steps = 0.5 * (velocities[1:] + velocities[:-1]) * np.diff(time)[:, None]
    sunk = collision.m2 * gravity / collision.k2 / (unit.velocity * unit.time)
    heights = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]) - sunk
    return History(time, velocities, heights, impulses, state)
