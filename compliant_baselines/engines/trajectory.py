"""What velocities and heights, step by step, say of a collision: impulses, states, and when it is over.

**Impulses** come from the balance of momentum, with gravity put back, for a step of length h:
dI1 = m1 (dv1 + g h), dI2 = dI1 + m2 (dv2 + g h). No engine's own account of its contact forces is used.

**A contact carries force** in a step if its impulse exceeds what rounding alone can make of it: `ROUNDING`
units in the last place of the momenta the balance is made of. An engine updates a velocity by one or two
additions, each good to half a unit, and makes the increment from a handful of products; 64 leaves an order of
magnitude above that, and lies, at a step of 1/1000 of a period, eleven orders below the impulse per step of a
fully loaded contact.

**States** follow step by step from which contacts carry force; the sequence they make is read by the rules of
`states`.

**In flight the bodies do not fall** (drop only). From the first instant at which no contact is closed, read as the end
of the first step in which none carries force and at whose end both gaps are open, gravity is off, for good: what is
still to meet meets as in an impact. B2 on the table with its weight is a contact, and so is a contact whose bodies
overlap without force. Otherwise the outcome would be that of the flight: two balls that part with B2 faster by 1e-4
|v0| would fall for many times the length of the contact and then meet at whatever speed they have come to. Engines
and references keep this one rule; for an adapter a scan ends there with `FLIGHT`.

**The collision is over** at the end of the first step in which B1 is clear of B2, B2 is clear of the table or
at rest on it, and v1 >= v2 >= 0.

* *Clear*, without gravity: the contact carries no force. The velocities then stay as they are, each contact
  opens at a constant rate >= 0, and a force that grows with penetration and with its rate never returns. With
  gravity that does not follow, since B2 may sink back or stop B1 again: clear then means no force *and* an
  open gap.
* *At rest* (drop only): an elastic B2 never stops vibrating on its support. It is at rest when it cannot lift
  off any more: its energy about equilibrium, (m2 v2^2 + k2 (x2 - x2_eq)^2)/2, does not exceed the (m2 g)^2/(2
  k2) it takes to unload the contact; in other words the amplitude of its velocity is at most g/omega2. Its
  velocity after the collision is then reported as 0: that is the mean over its vibration, it depends on no
  phase, and it joins smoothly to the lift-off velocity, which goes to 0 at that same energy. What v2 was is
  `rest_speed`.
* *Stuck* (drop only): likewise, if the energy of both balls about their common equilibrium cannot unload
  either contact, (m1 g)^2/(2 k1) and ((m1 + m2) g)^2/(2 k2), B1 never leaves B2. Both velocities are then 0.

**Given up early** is a flight that outlasts the steps that are left: both balls in the air, and the next
touch beyond the last step. So end two balls that leave with all but the same velocity, B2 the faster.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from impact_xval.model.chain.rest import FREE, GOING, REST, STUCK

Floats = NDArray[np.float64]

#: Units in the last place of the momenta below which an impulse per step counts as none.
ROUNDING = 64.0
EPSILON = float(np.finfo(np.float64).eps)

#: How a scan ended, beside `GOING`, `FREE`, `REST` and `STUCK`.
BROKEN, ALOFT, FLIGHT = 4, 5, 6


class ScanParameters(NamedTuple):
    """What `scan` needs to know of a column, in SI units; k2 and x2_rest as the engine has them."""

    h: float
    g: float
    m1: float
    m2: float
    k1: float
    k2: float
    x2_rest: float


#: What `scan` remembers from one call to the next. A pair of numbers is that of contacts 1 and 2. What a caller may
#: want of it:
#:
#: * n_steps: number of steps so far;
#: * again: what contacts that began to carry force *again* did in their first step, summed as changes of the relative
#:   velocity of their pair in m/s;
#: * lead, lead_contact: by how many steps the first flight of a drop began or did not, and which contact decided on
#:   that: after so many of flight it closed, or, negative, it had closed so many before the other one opened. The
#:   nearest such event; infinite without one.
#:
#: The rest is for the next call: whether a contact carries force (1, 0, or -1 as long as it never has); whether its
#: gap is closed, and the step at which it last closed; the step at which the first flight began (-1 before it, -2 once
#: a gap has closed again).
MEMORY = np.dtype(
    [(name, "f8") for name in ("n_steps", "again", "lead", "lead_contact", "flight")]
    + [(name, "f8", 2) for name in ("loaded", "closed", "closed_at")]
)


def new_memory() -> NDArray[np.void]:
    """Memory of `scan` in which nothing has happened yet, shape (1,) of `MEMORY`."""
    memory = np.zeros(1, MEMORY)
    memory["lead"] = np.inf
    memory["flight"] = memory["loaded"] = -1
    memory["closed"], memory["closed_at"] = 1, -np.inf  # as far back as there was a past
    return memory


@numba.njit(cache=True)
def _remember(memory, contact, loaded, impulse, inverse_mass):  # pragma: no cover (compiled)
    """Note what a contact did in a step."""
    if loaded and memory.loaded[contact] == 0:
        memory.again += impulse * inverse_mass
    if loaded or memory.loaded[contact] == 1:
        memory.loaded[contact] = 1.0 if loaded else 0.0


@numba.njit(cache=True)
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
            memory.lead, memory.lead_contact = lead, met + 1
    memory.closed[0], memory.closed[1] = 1.0 if closed1 else 0.0, 1.0 if closed2 else 0.0
    if memory.flight == -1 and not (closed1 or closed2):
        memory.flight = now


@numba.njit(cache=True)
def scan(  # pragma: no cover (compiled)
    v: Floats,
    x: Floats,
    before: Floats,
    p: ScanParameters,
    left: int,
    codes: NDArray[np.int8],
    memory: NDArray[np.void],
) -> tuple[int, int]:
    """Go through a window of steps until the collision is over.

    Parameters
    ----------
    v, x : ndarray, shape (n, 2)
        Velocities and heights of B1 and B2 after each step.
    before : ndarray, shape (2,)
        Velocities before the first step.
    p : ScanParameters
        The column.
    left : int
        Number of steps that may still be taken after these.
    codes : ndarray of int8, shape (n,)
        Filled with the raw state, 1 to 4, of each step.
    memory : ndarray of `MEMORY`, shape (1,)
        Of the windows before, `new_memory` before the first.

    Returns
    -------
    steps : int
        Number of steps gone through; if the collision is over, it was over after the last of them.
    end : int
        `GOING`, `FREE`, `REST`, `STUCK`, `ALOFT` (given up), `FLIGHT` (from here on without gravity: the steps that
        follow are not those of this collision), or `BROKEN` (a number that is not finite).
    """
    eps = ROUNDING * EPSILON
    seen = memory[0]
    gh = p.g * p.h
    u1, u2 = before[0], before[1]
    stuck_below = 0.5 * p.g * p.g * min(p.m1**2 / p.k1, (p.m1 + p.m2) ** 2 / p.k2)
    x12_rest = p.x2_rest - p.m1 * p.g / p.k2  # where B2 rests with B1 on it
    d1_rest = p.m1 * p.g / p.k1
    for i in range(v.shape[0]):
        v1, v2, x1, x2 = v[i, 0], v[i, 1], x[i, 0], x[i, 1]
        if not (math.isfinite(v1) and math.isfinite(v2) and math.isfinite(x1) and math.isfinite(x2)):
            return i, BROKEN
        impulse1 = p.m1 * (v1 - u1 + gh)
        impulse2 = impulse1 + p.m2 * (v2 - u2 + gh)
        noise1 = eps * p.m1 * (abs(v1) + abs(u1) + gh)
        noise2 = noise1 + eps * p.m2 * (abs(v2) + abs(u2) + gh)
        loaded1, loaded2 = impulse1 > noise1, impulse2 > noise2
        codes[i] = (1 if loaded2 else 3) if loaded1 else (2 if loaded2 else 4)
        u1, u2 = v1, v2
        seen.n_steps += 1
        _remember(seen, 0, loaded1, impulse1, 1 / p.m1 + 1 / p.m2)
        _remember(seen, 1, loaded2, impulse2, 1 / p.m2)

        weightless = p.g == 0
        if not weightless or seen.flight >= 0:
            _follow_gaps(seen, x1 < x2, x2 < 0)
        if not loaded1 and (weightless or x1 >= x2) and v1 >= v2:
            if not loaded2 and (weightless or x2 >= 0) and v2 >= 0:
                return i + 1, FREE
            if not weightless and v1 >= 0:
                energy = p.m2 * v2 * v2 + p.k2 * (x2 - p.x2_rest) ** 2
                if energy <= (p.m2 * p.g) ** 2 / p.k2:
                    return i + 1, REST
        if codes[i] == 4 and x1 >= x2 >= 0:
            if not weightless:
                return i + 1, FLIGHT
            meet = (x1 - x2) / (v2 - v1) if v2 > v1 else np.inf
            land = -x2 / v2 if v2 < 0 else np.inf
            if min(meet, land) > (v.shape[0] - i + left) * p.h:
                return i + 1, ALOFT
        if not weightless and loaded1 and loaded2:
            energy = p.m1 * v1 * v1 + p.m2 * v2 * v2
            energy += p.k1 * (x2 - x1 - d1_rest) ** 2 + p.k2 * (x2 - x12_rest) ** 2
            if 0.5 * energy <= stuck_below:
                return i + 1, STUCK
    return v.shape[0], GOING
