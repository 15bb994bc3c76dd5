"""A collision over time, from the path of an outcome: forces, heights and contacts at any instant, dimensionless.

**Units** are those of `Collision.units`, in which m1 = k1 = 1 and balls meet with 1: time sqrt(m1/k1) where contacts
are linear, impulse m1 abs(v0), force their quotient.

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

from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision
from impact_xval.model.path import Path

#: Share of the impulses that may pass after the time shown: balls may meet again much later.
TAIL = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """A collision of N balls with C contacts over time: n instants since first touch, rising.

    `velocities` and `heights`, 0 where springs are unloaded and touch, have shape (n, N); `impulses`, passed so far,
    and `acting`, which contacts act from each instant on, (n, C).
    """

    time: Floats
    velocities: Floats
    heights: Floats
    impulses: Floats
    acting: NDArray[np.bool_]

    @property
    def middles(self) -> Floats:
        """Middles of the intervals, shape (n - 1,): instants of `forces`."""
        return 0.5 * (self.time[1:] + self.time[:-1])

    @property
    def forces(self) -> Floats:
        """Mean force of each contact in every interval, shape (n - 1, C)."""
        return np.diff(self.impulses, axis=0) / np.diff(self.time)[:, None]

    @property
    def compressions(self) -> Floats:
        """Compressions of the springs of the contacts, shape (n, C); negative where a contact is open."""
        contacts = self.impulses.shape[1]
        table = np.zeros((len(self.time), 1))
        return np.hstack([self.heights, table])[:, 1 : 1 + contacts] - self.heights[:, :contacts]

    def at(self, instants: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
        """Return heights and velocities of the balls at instants, forces of the contacts, and which are active.

        After the last one bodies fly on as they do then, and no contact acts.
        """

        def of(known: Floats, values: Floats) -> Floats:
            of_columns: list[Floats] = [np.interp(instants, known, column) for column in values.T]
            return np.column_stack(of_columns)

        after = np.maximum(instants - self.time[-1], 0)[:, None]
        interval = np.searchsorted(self.time, instants, side="right") - 1
        return (
            of(self.time, self.heights) + after * self.velocities[-1],
            of(self.time, self.velocities),
            np.where(after > 0, 0.0, of(self.middles, self.forces)),
            self.acting[interval] & (instants < self.time[-1])[:, None],
        )


def instant_of_tail(time: Floats, passed: Floats) -> float:
    """Return the instant at which all but `TAIL` of an impulse has passed."""
    return float(time[np.searchsorted(passed, (1 - TAIL) * passed[-1])])


def make_history(collision: Collision, path: Path, gravity: float = 0.0) -> History | None:
    """Make the history of a path in the units of its collision; None if the path has no finite times.

    With gravity (m/s^2) the lower one of two balls begins in static equilibrium on its support.
    """
    unit = collision.units
    time = path.time / unit.time
    if not (np.isfinite(time).all() and time[-1] > 0):
        return None
    # On a border a point is given once for each state: the last of them says what follows.
    kept = np.append(np.diff(time) > 0, True)
    time, velocities = time[kept], path.velocities[kept] / unit.velocity
    steps = 0.5 * (velocities[1:] + velocities[:-1]) * np.diff(time)[:, None]
    apart = np.append(collision.gaps, [0.0] * (not collision.table))  # of each ball from the one below
    start = np.cumsum(apart[::-1])[::-1]
    if gravity:
        start = start - collision.m2 * gravity / collision.k2
    heights = np.vstack([np.zeros(len(start)), np.cumsum(steps, axis=0)]) + start / (
        unit.velocity * unit.time
    )
    return History(time, velocities, heights, path.impulses[kept] / unit.impulse, path.active[kept])
