"""First events of the oracle: where one of several polynomials on a step falls through zero.

The dense output of DOP853 is a polynomial of degree 7 on each step. Where the Bernstein coefficients of one are
positive it has no root in the step; otherwise all its roots are computed, so that a pair of roots inside one step,
which a look at the signs would pass over, is found.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Polynomial, chebyshev
from numpy.typing import NDArray

_DEGREE = 7

#: Fractions of a step at which a polynomial is sampled; the ends are among them.
NODES = 0.5 * (1 + chebyshev.chebpts2(_DEGREE + 1))

# Values at the nodes to coefficients in powers of the fraction u, and to Bernstein coefficients.
_TO_POWERS = np.linalg.inv(np.vander(NODES, increasing=True))
_BERNSTEIN = [
    [math.comb(_DEGREE, j) * u**j * (1 - u) ** (_DEGREE - j) for j in range(_DEGREE + 1)] for u in NODES
]
_TO_BERNSTEIN = np.linalg.inv(np.array(_BERNSTEIN))

#: Rounding of a root: imaginary parts below this are taken for zero (a double root splits into a complex pair), and so
#: is a root this little before the step.
_REAL = 1e-9


def first_fall(values: NDArray[np.float64], fresh: bool) -> tuple[float, int]:
    """First root, as a fraction of the step, at which one of the watched polynomials falls through zero.

    Parameters
    ----------
    values : ndarray, shape (n, 8)
        Of the polynomials at `NODES`.
    fresh : bool
        Whether this is the first step after an event: whatever triggered that one starts at zero and rises.

    Returns
    -------
    fraction : float
    which : int
        Row of `values`, or -1 if none falls.
    """
    first, which = math.inf, -1
    for row, coefficients in enumerate(values @ _TO_BERNSTEIN.T):
        if coefficients.min() > 0:
            continue
        polynomial = Polynomial(_TO_POWERS @ values[row])
        slope = polynomial.deriv()
        if values[row, 0] < 0 and (not fresh or slope(0.0) < 0):
            # By rounding its root fell into the step before, or ties with the event that was there.
            fall = 0.0
        else:
            roots = polynomial.roots()
            real = roots.real[(np.abs(roots.imag) < _REAL) & (roots.real > -_REAL) & (roots.real <= 1)]
            fall = min((max(u, 0.0) for u in real.tolist() if slope(u) < 0), default=math.inf)
        if fall < first:
            first, which = fall, row
    return first, which
