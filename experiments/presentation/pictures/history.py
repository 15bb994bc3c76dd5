"""A collision over time, made from the path of an outcome: forces, heights and active contacts at any instant.

A history needs an outcome with a path. The animation (`motion`) and the figure of forces call this module.

**Units** are those of `Collision.units`, in which m1 = k1 = 1 and balls meet with speed 1. The unit of time is
sqrt(m1/k1) if contacts are linear. The unit of impulse is m1 abs(v0). The unit of force is the unit of impulse over the
unit of time.

**Time of the model.** References and engines move in time. The model is stated in impulses I, and has no time. The path
of the model has times nevertheless: the time that contact forces F = sqrt(2 k E) would need for these impulses, where k
is the stiffness and E the elastic energy of a contact. With dI = F dt, equation (15), dI2/dI1 = sqrt(k2 E2/(k1 E1)),
describes two springs in time. This time is infinite or meaningless for a contact of zero or infinite stiffness. A
collision with such a contact has no history.

**Forces** are differences of the impulses between neighbouring points of the path, divided by the differences in time.
They belong to the middles of these intervals. **Heights** are integrals of the velocities. The model has no positions,
so its heights are integrals of its velocities too. Balls of the model may still overlap when their contact has ended,
because the model assumes that positions do not change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision
from impact_xval.model.path import Path

#: Fraction of the impulses that may pass after the last instant that is shown, because balls may meet again much later.
TAIL = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """A collision of N balls with C contacts at n instants.

    Attributes
    ----------
    time
        Instants since first touch, rising, shape (n,).
    velocities, heights
        Velocities and heights of the balls, shape (n, N). A height is 0 where the springs are unloaded and touch.
    impulses
        Impulse that each contact has passed so far, shape (n, C).
    acting
        Whether a contact is active from an instant on, shape (n, C).
    """

    time: Floats
    velocities: Floats
    heights: Floats
    impulses: Floats
    acting: NDArray[np.bool_]

    @property
    def middles(self) -> Floats:
        """Instants of `forces`, which are the middles of the intervals, shape (n - 1,)."""
        return 0.5 * (self.time[1:] + self.time[:-1])

    @property
    def forces(self) -> Floats:
        """Mean force of each contact in every interval, shape (n - 1, C)."""
        return np.diff(self.impulses, axis=0) / np.diff(self.time)[:, None]

    @property
    def compressions(self) -> Floats:
        """Compressions of the springs of the contacts, shape (n, C); negative for an open contact."""
        contacts = self.impulses.shape[1]
        table = np.zeros((len(self.time), 1))
        return np.hstack([self.heights, table])[:, 1 : 1 + contacts] - self.heights[:, :contacts]

    def at(self, instants: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
        """Return the state at given instants: heights, velocities, forces, and whether each contact is active.

        After the last instant of the history, balls keep their velocities, and no contact is active.
        """

        def of(known: Floats, values: Floats) -> Floats:
            """Return values interpolated at the given instants, from values that are known at some other instants."""
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
    """Return the instant from which on only the fraction `TAIL` of an impulse has still to pass.

    `passed` is the impulse that has passed at each instant of `time`.
    """
    return float(time[np.searchsorted(passed, (1 - TAIL) * passed[-1])])


def make_history(collision: Collision, path: Path, gravity: float = 0.0) -> History | None:
    """Return the history of a path in the units of its collision; None if the times of the path are not finite.

    With gravity (in m/s^2), the lower of two balls starts in static equilibrium on the table.
    """
    unit = collision.units
    time = path.time / unit.time
    if not (np.isfinite(time).all() and time[-1] > 0):
        return None
    # A point on the border of two states is in the path twice, once for each state. The second of the two has the next
    # state.
    kept = np.append(np.diff(time) > 0, True)
    time, velocities = time[kept], path.velocities[kept] / unit.velocity
    steps = 0.5 * (velocities[1:] + velocities[:-1]) * np.diff(time)[:, None]
    apart = np.append(
        collision.gaps, [0.0] * (not collision.table)
    )  # gap between each ball and the body below it
    start = np.cumsum(apart[::-1])[::-1]
    if gravity:
        start = start - collision.m2 * gravity / collision.k2
    heights = np.vstack([np.zeros(len(start)), np.cumsum(steps, axis=0)]) + start / (
        unit.velocity * unit.time
    )
    return History(time, velocities, heights, path.impulses[kept] / unit.impulse, path.active[kept])
