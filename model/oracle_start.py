"""How the oracle leaves first touch, where (15) is 0/0: off the expansion, or by the paper's finite first step.

Units: m1 = 1, k1 = 1, v0 = -1, with kappa = k2/k1 and mu = m2/m1; impulses per m1 |v0|, energies per m1 v0^2.
"""

from __future__ import annotations

import math


def series(kappa: float, mu: float, I1: float) -> tuple[float, float, float]:
    """I2, E1, E2 at a small first impulse I1, from the expansion of (13)-(15) about first touch.

    With I2 = c2 I1^2 + c3 I1^3 + c4 I1^4 and E1 = I1 + a2 I1^2 + a3 I1^3, the coefficients follow from
    E1 (dI2/dI1)^2 = (k2/k1) E2, which is (15) squared, in the orders 3, 4, 5.
    """
    a2 = -0.5 * (1 + 1 / mu)
    c2 = kappa / (6 * mu)
    a3 = c2 / (3 * mu)
    c3 = -(4 * a2 * c2 + 3 * c2 * c2) / 7.5
    c4 = -(9 * c3 * c3 + 12 * a2 * c2 * c3 + 4 * a3 * c2 * c2 + 6 * c2 * c2 * c3) / (11.2 * c2)
    I2 = I1 * I1 * (c2 + I1 * (c3 + I1 * c4))
    E1 = I1 * (1 + I1 * (a2 + I1 * (a3 + I1 * c3 / (4 * mu))))
    # (14) integrated: the integral of I1 dI2, less I2^2/2, over m2
    E2 = (I1**3 * (2 / 3 * c2 + I1 * (3 / 4 * c3 + I1 * 4 / 5 * c4)) - 0.5 * I2 * I2) / mu
    return I2, E1, E2


def straight_first_step(kappa: float, mu: float, I1: float) -> tuple[float, float, float]:
    """I2, E1, E2 after the paper's finite first step of I1, along which dI2/dI1 = y is constant.

    (13) and (14) give E1 = I1 - (1 + 1/m2) I1^2/2 + y I1^2/(2 m2) and E2 = y (1 - y) I1^2/(2 m2), and y is the one for
    which (15) holds at the end of the step. The main paper's (27) is not at hand: this is the rule that has the limit
    the supplement (3.1) quotes of it, y -> 1 as k2/k1 -> infinity. I2 comes out three times too large.
    """
    a = I1 / (2 * mu)
    b = 1 - 0.5 * (1 + 1 / mu) * I1
    q = b + kappa * a  # y (b + a y) = kappa a (1 - y)
    y = 2 * kappa * a / (q + math.sqrt(q * q + 4 * kappa * a * a))
    return y * I1, I1 * (b + a * y), y * (1 - y) * a * I1
