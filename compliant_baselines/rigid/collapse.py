"""Sequences of impacts without an end: the bodies collapse, and move on together.

The state of a line is the relative velocities u and the gaps g of its contacts. If a cycle of impacts multiplies all u
of some contacts by r and all their g by s, the next cycle is the same one, but for these factors: an impact is
homogeneous in u, and which gap closes first depends on g/u alone. Each cycle then takes s/r of the time of the one
before. With r < 1 and s < r the cycles go on without an end in a finite time, after which u and g are 0. (McNamara and
Young, Physics of Fluids A 4:496, 1992, for three balls, where r and s are the eigenvalues of a cycle; Cipra, Dini,
Kennedy and Kolan, Physica D 125:183, 1999, for four.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Floats

Bools = NDArray[np.bool_]

#: Relative deviation from common factors r and s up to which a cycle repeats the one before.
SAME_FACTOR = 1e-10

#: The same, over (1 - r)^2. Where e is a little too large for a collapse, u turns by a small angle t in each cycle, the
#: factors deviate by t^2, and bodies part after pi/t cycles. At t^2 = 1e-3 (1 - r)^2 all speeds have shrunk by e^-99.
LINGERING = 1e-3

#: Speeds over the largest at the start, and gaps over the largest then, below which a sequence counts as one without an
#: end even if no cycle is seen. Which gap closes first would be lost below 1e-308.
VANISHED_SPEED, VANISHED_GAP = 1e-100, 1e-200


class Watch:
    """A state after an impact, and what has been since then.

    What is said of impacts here holds for collapses too, each an event of infinitely many impacts.
    """

    def __init__(self, events: int, u: Floats, gaps: Floats, touching: Bools, struck: Bools) -> None:
        #: Number of impacts until now, and until then.
        self.events, self.begun = events, events
        #: The state then, and the contacts of the impact before it.
        self.u, self.gaps, self.touching, self.struck = u, gaps, touching, struck
        #: Since then: contacts with an impact, largest relative velocities in m/s, and time in s.
        self.active, self.fastest, self.elapsed = np.zeros(u.size, bool), np.abs(u), 0.0

    def note(self, u: Floats, struck: Bools) -> None:
        """Take note of an impact in the contacts `struck`, after which the relative velocities are u."""
        self.active |= struck
        np.maximum(self.fastest, np.abs(u), out=self.fastest)

    def time_to_collapse(
        self, u: Floats, gaps: Floats, touching: Bools, struck: Bools, vanished: tuple[float, float]
    ) -> float | None:
        """Give the time in s after which the active contacts are closed and at rest; None if that is not certain.

        Below a speed in m/s, or a gap in m other than 0, both in `vanished`, it is taken as certain.
        """
        slowed = np.abs(u[self.active]).max()
        if slowed == 0:
            return None
        time = None
        if (struck == self.struck).all():
            time = self._time_of_cycles(u, gaps, touching)
        speed, gap = vanished
        if time is None and (slowed < speed or 0 < gaps[self.active].max() < gap):
            time = self.elapsed
        return time if time is not None and self._undisturbed(time, u, gaps, touching) else None

    def _time_of_cycles(self, u: Floats, gaps: Floats, touching: Bools) -> float | None:
        """Give the time in s of all cycles from now on; None if the impacts since then are not a cycle that shrinks."""
        active = self.active
        if (touching != self.touching)[active].any():
            return None
        r, deviation = _common_factor(self.u[active], u[active])
        if not (0 < r < 1 and deviation <= min(SAME_FACTOR, LINGERING * (1 - r) ** 2)):
            return None
        if self.elapsed == 0:
            return 0.0
        s, deviation = _common_factor(self.gaps[active], gaps[active])
        if not (0 < s < r and deviation <= SAME_FACTOR):
            return None
        return self.elapsed * s / (r - s)

    def _undisturbed(self, time: float, u: Floats, gaps: Floats, touching: Bools) -> bool:
        """Tell whether no other contact closes within a time in s, or turns, whatever the active ones do until then.

        A contact that approaches all the while is one that a law leaves for later.
        """
        beside = np.zeros(u.size, bool)
        beside[1:] |= self.active[:-1]
        beside[:-1] |= self.active[1:]
        # No body moves faster than the sum of all relative velocities against the centre of mass of the active ones.
        change = np.where(beside, 2 * self.fastest[self.active].sum(), 0.0)
        undisturbed = np.where(touching, np.abs(u) >= change, gaps + (u - change) * time > 0)
        return bool(undisturbed[~self.active].all())


def _common_factor(before: Floats, now: Floats) -> tuple[float, float]:
    """Give the factor between two arrays, and the largest relative deviation of an element from it."""
    there = before != 0
    if not there.any() or now[~there].any():
        return np.nan, np.inf
    factors = now[there] / before[there]
    factor = factors[np.abs(before[there]).argmax()]
    return float(factor), float(np.abs(factors - factor).max() / abs(factor)) if factor else np.inf
