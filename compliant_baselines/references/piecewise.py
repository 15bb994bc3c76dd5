"""What the engine-free references share: free flight, when a collision is over, the record of stretches.

The collision is over by the rule of `contract.trajectory`, read in continuous time: at the first
instant at which it holds, not at the end of the step in which it began to. The three ways to be over become
true

* where a contact opens or B1 and B2 reach the same velocity, which are borders of stretches (so is the first flight,
  from which on a kernel goes on with g = 0), or
* where energy about equilibrium falls to what it takes to unload the contacts. While the same contacts carry
  force that energy only falls, so that its value at the end of a stretch tells, and bisection finds the
  instant.

Units as in `references.taylor`; g per |v0| sqrt(k1/m1). Heights enter through q2 = p2 - m2 g/k2,
the compression of contact 2 beyond what carries B2: with it the weight of B2 never has to cancel against
its support.
"""

from __future__ import annotations

from math import inf, sqrt

from numba import njit

from impact_xval.compliant_baselines.contract.trajectory import (
    FREE,
    GOING,
    REST,
    STUCK,
)
from impact_xval.compliant_baselines.references.taylor import evaluate

#: Mode of a contact that carries no force because its bodies are apart, in every kernel.
OPEN = 0

#: How a kernel ended, beside FREE, REST and STUCK: not at all, within the stretches it may take or can certify.
TOO_LONG = 9

#: Columns of a log row, one row a stretch: the state at its start, its length, and the event at its end.
#: The phases are the modes of the contacts in the kernel that wrote them; k1, k2 the present stiffnesses,
#: in use or not; g what gravity there is.
LOG_COLUMNS = ("time", "p1", "d1", "q2", "v2", "duration", "k1", "k2", "phase1", "phase2", "event", "g")
LOG_WIDTH = len(LOG_COLUMNS)

# Events, as written to the log times 10, plus the contact.
END_OF_COMPRESSION, RESTART_OF_COMPRESSION, END_OF_RESTITUTION, RETURN, LIMIT = 1, 2, 3, 4, 5


@njit(cache=True, error_model="numpy")
def state_of(loaded1, loaded2):
    """Tell the number of the state, 1 to 4, from which contacts carry force."""
    if loaded1:
        return 1 if loaded2 else 3
    return 2 if loaded2 else 4


@njit(cache=True, error_model="numpy")
def flight_time(p1, d1, p2, v2, g):
    """Bound the time until, while no contact carries force, a gap closes or a penetration is gone.

    Half as long again as that time, so that the event itself lies well inside; `inf` if there is none.
    """
    first = -p1 / d1 if p1 * d1 < 0 else inf
    height, second = -p2, inf
    if g > 0:
        square = v2 * v2 + 2 * g * height
        if height < 0 and v2 > 0:
            # Out of the table: at the surface, or at the top of a flight that never gets there.
            second = -2 * height / (v2 + sqrt(square)) if square > 0 else v2 / g
        elif height >= 0:
            root = sqrt(square)
            second = (v2 + root) / g if v2 > 0 else 2 * height / (root - v2) if height > 0 else 0.0
    elif height * v2 < 0:
        second = -height / v2
    return 1.5 * min(first, second)


@njit(cache=True, error_model="numpy")
def excess1(mu, q2, v2, k2, g):
    """Energy of B2 about its rest on the table beyond what unloads contact 2, times 2; at rest if <= 0."""
    return mu * v2 * v2 + k2 * q2 * q2 - (mu * g) * (mu * g) / k2


@njit(cache=True, error_model="numpy")
def excess2(mu, p1, d1, q2, v2, k1, k2, g):
    """Energy of both balls about their common rest beyond what unloads a contact, times 2; stuck if <= 0."""
    u1, u2 = p1 - g / k1, q2 - g / k2
    v1 = v2 - d1
    energy = v1 * v1 + mu * v2 * v2 + k1 * u1 * u1 + k2 * u2 * u2
    return energy - g * g * min(1 / k1, (1 + mu) * (1 + mu) / k2)


@njit(cache=True, error_model="numpy")
def how_over(loaded1, loaded2, mu, p1, d1, q2, v2, k1, k2, g):
    """`FREE`, `REST` or `STUCK` if the collision is over in this state, else `GOING`.

    Parameters
    ----------
    loaded1, loaded2 : bool
        Which contacts carry force.
    mu, p1, d1, q2, v2, k1, k2, g : float
        The column; k1 and k2 the stiffnesses whether or not they carry force.
    """
    if not loaded1 and d1 <= 0 and (g == 0 or p1 <= 0):
        if not loaded2 and v2 >= 0 and (g == 0 or q2 + mu * g / k2 <= 0):
            return FREE
        if g > 0 and v2 - d1 >= 0 and excess1(mu, q2, v2, k2, g) <= 0:
            return REST
    elif g > 0 and loaded1 and loaded2 and excess2(mu, p1, d1, q2, v2, k1, k2, g) <= 0:
        return STUCK
    return GOING


@njit(cache=True, error_model="numpy")
def over_within(table, degree, x, loaded1, loaded2, mu, k1, k2, g):
    """When in a stretch that ends at x in (0, 1] energy falls to what ends the collision; x if it does not.

    The instant returned is one at which it has fallen.
    """
    if loaded1:
        start = excess2(mu, table[0, 0], table[1, 0], table[2, 0], table[3, 0], k1, k2, g)
        watched = loaded2
    else:
        # B1 clear of B2, and not approaching: neither changes within a stretch. Its own velocity only falls.
        start = excess1(mu, table[2, 0], table[3, 0], k2, g)
        watched = table[0, 0] <= 0 and (table[1, 0] < 0 or (table[1, 0] == 0 and table[1, 1] <= 0))
    at = evaluate(table, degree, x)
    end = excess2(mu, *at, k1, k2, g) if loaded1 else excess1(mu, *at[2:], k2, g)
    if not watched or start <= 0 or end > 0:
        return x
    low, high = 0.0, x
    for _ in range(60):
        middle = 0.5 * (low + high)
        at = evaluate(table, degree, middle)
        excess = excess2(mu, *at, k1, k2, g) if loaded1 else excess1(mu, *at[2:], k2, g)
        if excess > 0:
            low = middle
        else:
            high = middle
        if high - low <= 2.0**-52 * high:
            break
    at = evaluate(table, degree, high)
    return high if how_over(loaded1, loaded2, mu, *at, k1, k2, g) != GOING else x


@njit(cache=True, error_model="numpy")
def write_row(log, n, time, state, duration, k1, k2, phase1, phase2, g):
    """Write row n of a log, all but its event, if it has one."""
    if n < log.shape[0]:
        log[n, 0], log[n, 1], log[n, 2], log[n, 3], log[n, 4] = time, state[0], state[1], state[2], state[3]
        log[n, 5], log[n, 6], log[n, 7], log[n, 8], log[n, 9] = duration, k1, k2, phase1, phase2
        log[n, 10], log[n, 11] = 0.0, g
