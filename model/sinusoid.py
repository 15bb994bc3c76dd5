"""Cosine and sine of one angle, together and without a branch.

The library's pair tells cases apart that do not occur here, and a branch that cannot be foretold costs more than the
sum it saves. This is the textbook's method: the angle reduced to the nearest multiple of pi in two parts (Cody and
Waite), and Taylor's series, which needs no coefficients from elsewhere.
"""

from __future__ import annotations

from math import cos, factorial, pi, sin

import numpy as np

from impact_xval.model.compiled import inlined

#: pi in two parts; the first has 33 bits, so that its product with the multiples in use is exact.
PI = (float.fromhex("0x1.921fb544p+1"), float.fromhex("0x1.0b4611a626331p-33"))
INVERSE_PI = 1 / pi

#: 1/n!
T = tuple(1 / factorial(n) for n in range(24))

#: Beyond this the library's functions are called.
LARGEST_ANGLE = 1e5


@inlined
def cos_sin(x):
    """Cosine and sine of an angle x >= 0, to within 4e-16."""
    if x > LARGEST_ANGLE:
        return cos(x), sin(x)
    n = np.rint(x * INVERSE_PI)
    r = (x - n * PI[0]) - n * PI[1]
    sign = 1.0 - 2.0 * (n - 2.0 * np.floor(0.5 * n))
    # The alternating series to r^23, in pairs of pairs of pairs (Estrin) so that few operations wait for one another;
    # as abs(r) <= pi/2, what is left out is below 1e-19.
    z = r * r
    z2 = z * z
    z4 = z2 * z2
    c = (
        (T[0] - z * T[2])
        + z2 * (T[4] - z * T[6])
        + z4
        * (
            (T[8] - z * T[10])
            + z2 * (T[12] - z * T[14])
            + z4 * ((T[16] - z * T[18]) + z2 * (T[20] - z * T[22]))
        )
    )
    s = (
        (T[3] - z * T[5])
        + z2 * (T[7] - z * T[9])
        + z4 * ((T[11] - z * T[13]) + z2 * (T[15] - z * T[17]) + z4 * ((T[19] - z * T[21]) + z2 * T[23]))
    )
    return sign * c, sign * (r - r * z * s)
