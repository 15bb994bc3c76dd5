"""Collapses: infinite sequences of impacts in a finite time, after which the bodies move on together.

The state of a line is given by the relative velocities u and the gaps g of its contacts. Suppose that a cycle of
impacts multiplies all u of some contacts by r and all their g by s. The next cycle then differs only by these factors,
because the effect of an impact is proportional to u, and the first gap to close depends only on g/u. Each cycle takes
s/r of the time of the cycle before. If r < 1 and s < r, infinitely many cycles take a finite time, after which u and g
are 0. (McNamara and Young, Physics of Fluids A 4:496, 1992, for three balls, where r and s are the eigenvalues of a
cycle; Cipra, Dini, Kennedy and Kolan, Physica D 125:183, 1999, for four.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Floats

Bools = NDArray[np.bool_]

#: Largest relative difference from common factors r and s with which a cycle is taken to repeat the cycle before.
SAME_FACTOR = 1e-10

#: Largest relative difference of the factors of the velocities, over (1 - r)^2. If e is slightly too large for a
#: collapse, u turns by a small angle t in each cycle. The factors then differ by t^2, and the bodies part after pi/t
#: cycles. At t^2 = 1e-3 (1 - r)^2 all speeds have shrunk to e^-99 when the bodies part.
LINGERING = 1e-3

#: Speeds and gaps, over the largest at the start. Below them a sequence of impacts is taken for a collapse even without
#: a cycle. Below 1e-308 the order in which gaps close would be lost.
VANISHED_SPEED, VANISHED_GAP = 1e-100, 1e-200


class Watch:
    """A recorded state after an impact, and a summary of the impacts since then.

    It is compared with later states to find cycles of impacts. A collapse of infinitely many impacts can take the place
    of an impact.
    """

    def __init__(self, events: int, u: Floats, gaps: Floats, touching: Bools, struck: Bools) -> None:
        #: Number of impacts so far, and number of impacts when this state was recorded.
        self.events, self.begun = events, events
        #: The recorded state, and the contacts of the impact before it.
        self.u, self.gaps, self.touching, self.struck = u, gaps, touching, struck
        #: Since this state: contacts that had an impact, largest relative velocities in m/s, and time in s.
        self.active, self.fastest, self.elapsed = np.zeros(u.size, bool), np.abs(u), 0.0

    def note(self, u: Floats, struck: Bools) -> None:
        """Record an impact in the contacts `struck`, after which the relative velocities are u in m/s."""
        self.active |= struck
        np.maximum(self.fastest, np.abs(u), out=self.fastest)

    def time_to_collapse(
        self, u: Floats, gaps: Floats, touching: Bools, struck: Bools, vanished: tuple[float, float]
    ) -> float | None:
        """Return the time in s until the active contacts are closed and at rest; None if no collapse is certain.

        Without a cycle, a collapse is certain only below a speed in m/s, or below a gap in m that is not 0. `vanished`
        contains this speed and this gap.
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
        if time is None or not self._is_undisturbed(time, u, gaps, touching):
            return None
        return time

    def _time_of_cycles(self, u: Floats, gaps: Floats, touching: Bools) -> float | None:
        """Return the time in s of all further cycles; None if the recorded impacts are not a cycle that shrinks."""
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

    def _is_undisturbed(self, time: float, u: Floats, gaps: Floats, touching: Bools) -> bool:
        """Return True if no inactive contact closes, or changes the sign of its rate, within a time in s.

        Contacts that approach during all of this time are left to the impact law afterwards.
        """
        beside = np.zeros(u.size, bool)
        beside[1:] |= self.active[:-1]
        beside[:-1] |= self.active[1:]
        # Relative to the centre of mass of the active bodies, no body is faster than the sum of all relative
        # velocities.
        change = np.where(beside, 2 * self.fastest[self.active].sum(), 0.0)
        undisturbed = np.where(touching, np.abs(u) >= change, gaps + (u - change) * time > 0)
        return bool(undisturbed[~self.active].all())


def _common_factor(before: Floats, now: Floats) -> tuple[float, float]:
    """Return the factor between two arrays, and the largest relative difference of an element's factor from it."""
    nonzero = before != 0
    if not nonzero.any() or now[~nonzero].any():
        return np.nan, np.inf
    factors = now[nonzero] / before[nonzero]
    factor = float(factors[np.abs(before[nonzero]).argmax()])
    if not factor:
        return factor, np.inf
    return factor, float(np.abs(factors - factor).max() / abs(factor))
