"""Two balls that settle on each other and on the table: when it is certain that neither contact lets go any more.

With both contacts loaded the column is linear, and about its equilibrium y' = A y. In the eigenvectors of A, y is a sum
of terms a_j v_j exp(lambda_j t), none of which grows; so neither does what they add to a force, and

    abs(f) <= sum_j abs(a_j) abs(row . v_j)        for ever,

f the force beyond the weight that the contact carries, and row its stiffness and damping. While these bounds stay
below m1 g and (m1 + m2) g no contact lets go, and how slowly the energy falls no longer matters: a column whose damped
contact is far stiffer than its elastic one rings on for millions of periods.

Where eigenvectors are nearly parallel, next to critical damping, the bounds are large and nothing is certified until
the motion has died down.

Units as in `references.taylor`; k1 = 1.
"""

from __future__ import annotations

import numpy as np
from numba import njit

#: What rounding leaves of a bound.
_ROUNDING = 1e-9

#: Determinant of the eigenvectors, each of length 1, below which they are taken for parallel.
_PARALLEL = 1e-12


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
    A[3, 0], A[3, 1], A[3, 2], A[3, 3] = -1 / mu, -c1 / mu, k2 / mu, -c2 / mu
    A[1] = A[3]
    A[1, 0], A[1, 1] = -(1 + 1 / mu), -c1 * (1 + 1 / mu)
    _, vectors = np.linalg.eig(A)
    if not abs(np.linalg.det(vectors)) > _PARALLEL:
        return False
    a = np.linalg.solve(vectors, np.array([p1 - g, d1, q2 - g / k2, v2], np.complex128))
    bound1 = bound2 = 0.0
    for j in range(4):
        bound1 += abs(a[j] * (vectors[0, j] + c1 * vectors[1, j]))
        bound2 += abs(a[j] * (k2 * vectors[2, j] - c2 * vectors[3, j]))
    return bound1 < (1 - _ROUNDING) * g and bound2 < (1 - _ROUNDING) * (1 + mu) * g
