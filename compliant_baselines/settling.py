"""Two balls that settle on each other and on the table: the long last stretch of a drop, in one leap.

With both contacts loaded the column is linear, and about its equilibrium y' = A y. Its energy

    E = v1^2 + mu v2^2 + k1 u1^2 + k2 u2^2        (u_i: compression beyond what carries the weight)

never grows; nor does that of the rates, E(y'), since y' obeys the same equations. The forces beyond the weight are
f1 = m1 v1' and f2 = m1 v1' + m2 v2', so abs(f1) <= sqrt(E(y')) and abs(f2) <= sqrt((1 + mu) E(y')) from here on. While
these stay below m1 g and (m1 + m2) g no contact lets go, ever: with m1 = 1,

    E(y') < g^2

is enough for both. What is left is the end of the collision, where E falls to the energy that cannot unload a contact
(`compliant_baselines.piecewise`). E falls monotonically, so that the number of steps of a length h until then is found
by doubling: y is taken over 2^j steps by exp(A h)^(2^j), one multiplication of matrices each.

Units as in `compliant_baselines.taylor`; k1 = 1.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from compliant_baselines.piecewise import excess2
from compliant_baselines.taylor import ORDER, evaluate, expand, longest_step

#: Doublings; more steps than 2^50 lose their count in rounding.
_DOUBLINGS = 50


@njit(cache=True, error_model="numpy")
def quiet(mu, k2, c1, c2, g, p1, d1, q2, v2):
    """Whether neither contact will ever let go: E(y') < g^2."""
    f1 = p1 - g + c1 * d1
    f2 = k2 * q2 - g - c2 * v2
    return f1 * f1 + (f2 - f1) * (f2 - f1) / mu + d1 * d1 + k2 * v2 * v2 < g * g


@njit(cache=True, error_model="numpy")
def settle(mu, k2, c1, c2, g, p1, d1, q2, v2):
    """Advance a quiet column to less than one step before its collision is over.

    Parameters
    ----------
    mu, k2, c1, c2, g : float
        The column.
    p1, d1, q2, v2 : float
        Its state, which is `quiet`.

    Returns
    -------
    p1, d1, q2, v2 : float
        The state there.
    time : float
        How long it took; 0 if the collision is over within a step, infinite if the energy never falls so far.
    """
    h = longest_step(mu, 1.0, k2, c1, c2)
    table = np.zeros((4, ORDER + 1))
    powers = np.empty((_DOUBLINGS, 4, 4))
    for j in range(4):
        table[:, 0] = 0.0
        table[j, 0] = 1.0
        expand(table, ORDER, h, mu, 1.0, k2, c1, c2, 0.0, 0.0)
        powers[0, 0, j], powers[0, 1, j], powers[0, 2, j], powers[0, 3, j] = evaluate(table, ORDER, 1.0)
    y, z = np.array([p1 - g, d1, q2 - g / k2, v2]), np.empty(4)
    steps, rising, j = 0.0, True, 0
    while j >= 0:
        for r in range(4):
            z[r] = 0.0
            for c in range(4):
                z[r] += powers[j, r, c] * y[c]
        if excess2(mu, z[0] + g, z[1], z[2] + g / k2, z[3], 1.0, k2, g) > 0:
            y[:] = z
            steps += 2.0**j
            if rising:
                if j + 1 == _DOUBLINGS:
                    return p1, d1, q2, v2, np.inf
                for r in range(4):
                    for c in range(4):
                        powers[j + 1, r, c] = 0.0
                        for i in range(4):
                            powers[j + 1, r, c] += powers[j, r, i] * powers[j, i, c]
                j += 1
                continue
        rising = False
        j -= 1
    return y[0] + g, y[1], y[2] + g / k2, y[3], steps * h
