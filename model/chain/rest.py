"""When a drop is over, and when it is in flight: two balls on a table, the lower one settled, with gravity.

A collision with gravity is over at the first instant at which the balls are apart, the lower one is off the table or at
rest on it, and v1 >= v2 >= 0. *At rest* is a ball that cannot lift off any more: its energy about equilibrium does not
exceed what it takes to unload its contact. From the first instant at which no contact is closed the bodies no longer
fall. The three ways to be over become true

* where a contact opens or B1 and B2 reach the same velocity, which are borders of pieces, or
* where energy about equilibrium falls to what it takes to unload the contacts. While the same contacts carry force that
  energy only falls, so that its value at the end of a piece tells, and bisection finds the instant.

**Settling.** With both contacts loaded the motion is linear, and about its equilibrium y' = A y. In the eigenvectors of
A, y is a sum of terms a_j v_j exp(lambda_j t), none of which grows; so neither does what they add to a force, and

    abs(f) <= sum_j abs(a_j) abs(row . v_j)        for ever,

f the force beyond the weight that the contact carries, and row its stiffness and damping. While these bounds stay below
m1 g and (m1 + m2) g no contact lets go, and how slowly the energy falls no longer matters: two balls whose damped
contact is far stiffer than the elastic one ring on for millions of periods. Where eigenvectors are nearly parallel,
next to critical damping, the bounds are large and nothing is certified until the motion has died down.

Units: m1 = 1, and 1/a[1] is m2.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from impact_xval.model.chain.laws import KELVIN_VOIGT, carries, rest
from impact_xval.model.chain.series import ORDER
from impact_xval.model.compiled import compiled, uncounted
from impact_xval.model.pair.law import INACTIVE

#: How a collision ended: the balls left the table, B1 left B2 at rest on it, B1 came to rest on B2; or it goes on.
GOING, FREE, REST, STUCK = 0, 1, 2, 3

#: Pieces without an event after which it is examined whether the balls of a drop only settle any more.
QUIET = 6

#: What rounding leaves of a bound.
_ROUNDING = 1e-9

#: Determinant of the eigenvectors, each of length 1, below which they are taken for parallel.
_PARALLEL = 1e-12


@uncounted
def on_table(c, n):
    """Energy of the last body about its rest on the table beyond what unloads its contact, times 2; at rest if <= 0."""
    i, weight = n - 1, c.g[0] / c.a[n - 1]
    return c.w[i] * c.w[i] / c.a[i] + c.k[i] * c.delta[i] * c.delta[i] - weight * weight / c.k[i]


@uncounted
def on_each_other(c):
    """Energy of both balls about their common rest beyond what unloads a contact, times 2; stuck if <= 0."""
    g, mass = c.g[0], 1 / c.a[1]
    u1, u2 = c.delta[0] - g / (c.a[0] * c.k[0]), c.delta[1] - g / (c.a[0] * c.k[1])
    v2 = -c.w[1]
    v1 = v2 - c.w[0]
    energy = v1 * v1 / c.a[0] + mass * v2 * v2 + c.k[0] * u1 * u1 + c.k[1] * u2 * u2
    whole = 1 / c.a[0] + mass
    return energy - g * g * min(1 / (c.a[0] * c.a[0] * c.k[0]), whole * whole / c.k[1])


@uncounted
def how_over(c, n):
    """`FREE`, `REST` or `STUCK` if a collision with gravity is over in this state, else `GOING`."""
    if n == 0:
        return STUCK
    if n == 1:
        if carries(c.phase[0]):
            return STUCK if on_table(c, n) <= 0 else GOING
        falls = c.w[0] > 0
        return GOING if falls else REST if c.body[-1] == n else FREE
    loaded1, loaded2 = carries(c.phase[0]), carries(c.phase[1])
    if not loaded1 and c.w[0] <= 0 and c.delta[0] <= 0:
        v2 = -c.w[1]
        if not loaded2 and v2 >= 0 and c.delta[1] + rest(c, n, 1) <= 0:
            return FREE
        if v2 - c.w[0] >= 0 and on_table(c, n) <= 0:
            return REST
    elif loaded1 and loaded2 and on_each_other(c) <= 0:
        return STUCK
    return GOING


@uncounted
def in_flight(c, n):
    """Whether no contact of two balls on a table is closed, and none of them is part of the table."""
    for i in range(n):
        if c.phase[i] != INACTIVE:
            return False
    return c.body[-1] < n


@uncounted
def fall_time(c, n):
    """Bound the time until, while no contact carries force, a gap closes or a penetration is gone.

    Half as long again as that time, so that the event itself lies well inside; infinite if there is none.
    """
    first, g, last = inf, c.g[0], n - 1
    if n > 1 and c.delta[0] * c.w[0] < 0:
        first = -c.delta[0] / c.w[0]
    height, v = -c.delta[last] - rest(c, n, last), -c.w[last]
    square, second = v * v + 2 * g * height, inf
    if height < 0 and v > 0:
        # Out of the table: at the surface, or at the top of a flight that never gets there.
        second = -2 * height / (v + sqrt(square)) if square > 0 else v / g
    elif height >= 0:
        root = sqrt(square)
        second = (v + root) / g if v > 0 else 2 * height / (root - v) if height > 0 else 0.0
    return 1.5 * min(first, second)


@uncounted
def _place(c, n, work, x):
    """Carry the state at x of a piece into `c`."""
    for i in range(n):
        w, delta = work.rates[i, ORDER], work.deltas[i, ORDER]
        for j in range(ORDER - 1, -1, -1):
            w = w * x + work.rates[i, j]
            delta = delta * x + work.deltas[i, j]
        c.w[i], c.delta[i] = w, delta


@uncounted
def over_within(c, n, x, work):
    """When in a piece that ends at x in (0, 1] energy falls to what ends the collision; x if it does not.

    The instant returned is one at which it has fallen.
    """
    loaded1, loaded2 = carries(c.phase[0]), carries(c.phase[1])
    rates, deltas = work.rates, work.deltas
    watched = loaded2
    if not loaded1:
        # B1 clear of B2, and not approaching: neither changes within a piece. Its own velocity only falls.
        watched = deltas[0, 0] <= 0 and (rates[0, 0] < 0 or (rates[0, 0] == 0 and rates[0, 1] <= 0))
    _place(c, n, work, 0.0)
    start = on_each_other(c) if loaded1 else on_table(c, n)
    _place(c, n, work, x)
    end = on_each_other(c) if loaded1 else on_table(c, n)
    if not watched or start <= 0 or end > 0:
        return x
    low, high = 0.0, x
    for _ in range(60):
        middle = 0.5 * (low + high)
        _place(c, n, work, middle)
        excess = on_each_other(c) if loaded1 else on_table(c, n)
        if excess > 0:
            low = middle
        else:
            high = middle
        if high - low <= 2.0**-52 * high:
            break
    _place(c, n, work, high)
    return high if how_over(c, n) != GOING else x


@compiled
def eliminate(A, b):
    """Solve A x = b into b, A is used up, and give the magnitude of A's determinant; where it is 0, b is left undone.

    Gauss-Jordan with pivots. To compile `solve` and `det` of numpy took a tenth of the time of all references.
    """
    n, determinant = b.size, 1.0
    for j in range(n):
        pivot = j
        for i in range(j + 1, n):
            if abs(A[i, j]) > abs(A[pivot, j]):
                pivot = i
        determinant *= abs(A[pivot, j])
        if determinant == 0:
            return determinant
        for i in range(n):
            A[j, i], A[pivot, i] = A[pivot, i], A[j, i]
        b[j], b[pivot] = b[pivot], b[j]
        for i in range(n):
            if i != j:
                share = A[i, j] / A[j, j]
                b[i] -= share * b[j]
                for k in range(j, n):
                    A[i, k] -= share * A[j, k]
    for j in range(n):
        b[j] /= A[j, j]
    return determinant


@compiled
def settled(mu, k1, k2, c1, c2, g, p1, d1, q2, v2):
    """Whether neither contact will ever let go.

    Parameters
    ----------
    mu, k1, k2, c1, c2, g : float
        m2/m1, stiffness and damping of the contacts, both of which are loaded; gravity.
    p1, d1, q2, v2 : float
        Compression of contact 1 and its rate, compression of contact 2 beyond the weight of B2, velocity of B2.
    """
    fastest = (k1 + k2 + c1 + c2) * (1 + 1 / mu)
    loads = abs(k1 * p1 - g + c1 * d1) < g and abs(k2 * q2 - g - c2 * v2) < (1 + mu) * g
    if not (fastest < np.inf and loads):
        return False
    A = np.zeros((4, 4), np.complex128)  # of u1, d1, u2, v2, the compressions counted from equilibrium
    A[0, 1], A[2, 3] = 1, -1
    A[1, 0], A[1, 1], A[1, 2], A[1, 3] = -k1 * (1 + 1 / mu), -c1 * (1 + 1 / mu), k2 / mu, -c2 / mu
    A[3, 0], A[3, 1], A[3, 2], A[3, 3] = -k1 / mu, -c1 / mu, k2 / mu, -c2 / mu
    _, vectors = np.linalg.eig(A)
    a = np.zeros(4, np.complex128)
    a[0], a[1], a[2], a[3] = p1 - g / k1, d1, q2 - g / k2, v2
    if not eliminate(vectors.copy(), a) > _PARALLEL:
        return False
    bound1 = bound2 = 0.0
    for j in range(4):
        bound1 += abs(a[j] * (k1 * vectors[0, j] + c1 * vectors[1, j]))
        bound2 += abs(a[j] * (k2 * vectors[2, j] - c2 * vectors[3, j]))
    return bound1 < (1 - _ROUNDING) * g and bound2 < (1 - _ROUNDING) * (1 + mu) * g


@uncounted
def may_settle(c, n, quiet):
    """Whether it is worth examining if both balls only settle any more (`settled`)."""
    due = c.law == KELVIN_VOIGT and quiet > 0 and quiet % QUIET == 0
    return due and n == 2 and carries(c.phase[0]) and carries(c.phase[1])
