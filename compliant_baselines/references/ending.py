"""When a collision is over.

That is the rule of `contract.trajectory`, read in continuous time: at the first instant at which it holds, not at the
end of the step in which it began to. The three ways to be over become true

* where a contact opens or B1 and B2 reach the same velocity, which are borders of segments (so is the first flight,
  from which on the driver goes on with g = 0), or
* where energy about equilibrium falls to what it takes to unload the contacts. While the same contacts carry
  force that energy only falls, so that its value at the end of a segment tells, and bisection finds the
  instant.

**Settling.** With both contacts loaded the column is linear, and about its equilibrium y' = A y. In the eigenvectors of
A, y is a sum of terms a_j v_j exp(lambda_j t), none of which grows; so neither does what they add to a force, and

    abs(f) <= sum_j abs(a_j) abs(row . v_j)        for ever,

f the force beyond the weight that the contact carries, and row its stiffness and damping. While these bounds stay
below m1 g and (m1 + m2) g no contact lets go, and how slowly the energy falls no longer matters: a column whose damped
contact is far stiffer than its elastic one rings on for millions of periods. Where eigenvectors are nearly parallel,
next to critical damping, the bounds are large and nothing is certified until the motion has died down.

Units as in `references.taylor`; g per |v0| sqrt(k1/m1). Heights enter through q2 = p2 - m2 g/k2,
the compression of contact 2 beyond what carries B2: with it the weight of B2 never has to cancel against
its support.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from impact_xval.compliant_baselines.contract.trajectory import FREE, GOING, REST, STUCK
from impact_xval.compliant_baselines.references.taylor import evaluate

#: How the driver ended, beside FREE, REST and STUCK: not at all, within the segments it may take or can certify.
TOO_LONG = 9

#: What rounding leaves of a bound.
_ROUNDING = 1e-9

#: Determinant of the eigenvectors, each of length 1, below which they are taken for parallel.
_PARALLEL = 1e-12


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
    """When in a segment that ends at x in (0, 1] energy falls to what ends the collision; x if it does not.

    The instant returned is one at which it has fallen.
    """
    if loaded1:
        start = excess2(mu, table[0, 0], table[1, 0], table[2, 0], table[3, 0], k1, k2, g)
        watched = loaded2
    else:
        # B1 clear of B2, and not approaching: neither changes within a segment. Its own velocity only falls.
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


@njit(cache=True, error_model="numpy")
def settled(mu, k2, c1, c2, g, p1, d1, q2, v2):
    """Whether neither contact will ever let go.

    Parameters
    ----------
    mu, k2, c1, c2, g : float
        The column, both of whose contacts are loaded.
    p1, d1, q2, v2 : float
        Its state.
    """
    fastest = (1 + k2 + c1 + c2) * (1 + 1 / mu)
    if not (fastest < np.inf and abs(p1 - g + c1 * d1) < g and abs(k2 * q2 - g - c2 * v2) < (1 + mu) * g):
        return False
    A = np.zeros((4, 4), np.complex128)  # of u1, d1, u2, v2, the compressions counted from equilibrium
    A[0, 1], A[2, 3] = 1, -1
    A[1, 0], A[1, 1], A[1, 2], A[1, 3] = -(1 + 1 / mu), -c1 * (1 + 1 / mu), k2 / mu, -c2 / mu
    A[3, 0], A[3, 1], A[3, 2], A[3, 3] = -1 / mu, -c1 / mu, k2 / mu, -c2 / mu
    _, vectors = np.linalg.eig(A)
    a = np.zeros(4, np.complex128)
    a[0], a[1], a[2], a[3] = p1 - g, d1, q2 - g / k2, v2
    if not eliminate(vectors.copy(), a) > _PARALLEL:
        return False
    bound1 = bound2 = 0.0
    for j in range(4):
        bound1 += abs(a[j] * (vectors[0, j] + c1 * vectors[1, j]))
        bound2 += abs(a[j] * (k2 * vectors[2, j] - c2 * vectors[3, j]))
    return bound1 < (1 - _ROUNDING) * g and bound2 < (1 - _ROUNDING) * (1 + mu) * g
