"""Conversion of coefficients of restitution to dampings and back (docs/theory.md, section 7).

p is the depth of a contact, u0 the speed of approach, M the reduced mass, omega = sqrt(k/M).

**Kelvin and Voigt.** The contact F = k p + c p' may push but not pull: it ends when its force is zero. The textbook's
formula, which the naive mapping uses, is for a contact that ends at p = 0.

**A dashpot in compression only.** The spring returns the energy that it holds at the end of compression. So u0 e =
omega p_max. Compression ends at the greatest depth of the Kelvin-Voigt contact, p_max = (u0/omega) exp(-zeta T/2), with
T = `contact_time`. So e = exp(-zeta T/2). This is the square root of the restitution that the same zeta gives to a
dashpot that acts in both directions.

**Hunt and Crossley, exactly.** The contact is F = k p (1 + a p'). Let two bodies meet at the speed u0, and let u = p'
be a function of p. Then M u du/dp = -k p (1 + a u), so that u du/(1 + a u) = -(k/M) p dp. At both ends p is zero, where
u is u0 and -e u0. So the integral of u/(1 + a u) from -e u0 to u0 vanishes. With A = a u0 this is

    A (1 + e) = ln((1 + A)/(1 - e A)),    0 < A < 1/e,                                    (*)

for any mass, stiffness and exponent of the spring. Hunt and Crossley (J. Applied Mechanics 42:440, 1975) give A = 3 (1
- e)/2, the first term as e goes to 1. A third body that touches does not change the restitution of this contact. The
speed u0 does change it, because a is fixed. Both contacts of two balls on a table take u0 = |v0|, the only speed that a
collision states.
"""

from __future__ import annotations

from math import asinh, atan2, exp, inf, log, log1p, pi, sqrt

import numpy as np

from impact_xval.model.arrays import Floats
from impact_xval.model.compiled import strict_float, strict_float_helper


@strict_float
def contact_time(zeta: float) -> float:
    """Return the duration of a Kelvin-Voigt contact that ends at zero force, times omega = sqrt(k/M).

    The damping ratio zeta is >= 0. docs/theory.md has the formulas atan2(2 zeta w, 2 zeta^2 - 1)/w and ln((zeta +
    w)/(zeta - w))/w with w = sqrt(abs(1 - zeta^2)). Here half the angle is computed, so that no digits are lost near
    zeta = 1.
    """
    # 1 - zeta^2 is computed as (1 - zeta) (1 + zeta), so that no digits are lost near zeta = 1. The roots are taken
    # separately, so that a huge zeta does not overflow.
    w = sqrt(abs(1 - zeta)) * sqrt(1 + zeta)
    if w == 0:
        return 2.0
    return 2 * (atan2(w, zeta) if zeta < 1 else asinh(w)) / w


def restitution(zeta: float) -> float:
    """Return the restitution of a Kelvin-Voigt contact that ends at zero force, for a damping ratio zeta >= 0."""
    return exp(-zeta * contact_time(zeta))


def damping_ratio(e: float) -> float:
    """Return the damping ratio that gives a contact that only pushes the restitution e, exact to rounding.

    A ValueError says that e is outside (0, 1].
    """
    return _damping_ratio(_require_legal(e))


def textbook_damping_ratio(e: float) -> float:
    """Return the damping ratio that gives a contact that may pull the restitution e.

    A ValueError says that e is outside (0, 1].
    """
    return float(textbook_damping_ratios(np.array(_require_legal(e))))


def textbook_restitution(zeta: float) -> float:
    """Return the restitution of a contact that may pull, for a damping ratio 0 <= zeta <= 1.

    It is exp(-pi zeta/sqrt(1 - zeta^2)), the inverse of `textbook_damping_ratio`.
    """
    return exp(-pi * zeta / (sqrt(1 - zeta) * sqrt(1 + zeta))) if zeta < 1 else 0.0


def _require_legal(e: float) -> float:
    """Return e unchanged if a dashpot can have this restitution; else a ValueError names the legal range."""
    if not 0 < e <= 1:
        raise ValueError(f"e = {e!r}; legal: greater than 0, at most 1 (no finite damping gives e = 0)")
    return e


@strict_float
def _damping_ratio(e: float) -> float:
    """Solve zeta T(zeta) = -ln e for the damping ratio zeta, with T = `contact_time`; NaN for e outside (0, 1]."""
    loss = -log(e)
    if not 0 < loss < inf:
        return 0.0 if loss == 0 else np.nan
    # As a function of ln zeta, ln(zeta T/loss) rises with a slope that falls from 1 to 0. So Newton's method never
    # passes the solution if it starts below it. It starts at loss/pi, which is below, because T <= pi. After at most
    # nine steps only rounding is left.
    zeta = loss / pi
    for _ in range(50):
        duration = contact_time(zeta)
        excess = log(zeta * duration / loss)
        slope = 2 / 3  # the limit of the slope at zeta = 1
        if abs(1 - zeta) > 1e-6:
            slope = 1 + zeta / (1 + zeta) * (zeta - 2 / duration) / (1 - zeta)
        zeta *= exp(-excess / slope)
        if excess > -1e-15:
            break
    return zeta


@strict_float_helper
def _tail(x: float) -> float:
    """Return (x - ln(1 + x) - x^2/2)/x^3, without loss of digits at small x."""
    if abs(x) > 0.25:
        return (x - log1p(x) - 0.5 * x * x) / (x * x * x)
    total, power = 0.0, -1.0
    for n in range(3, 40):
        total += power / n
        power *= -x
    return total


@strict_float_helper
def _hunt_crossley(e: float) -> float:
    """Solve equation (*) of the module's docstring for A, with e in (0, 1]; NaN for other e."""
    if not 0 < e < 1:
        return 0.0 if e == 1 else np.nan
    # Divided by A^2, equation (*) reads (1 - e^2)/2 + A (t(A) + e^3 t(-e A)) = 0 with t = `_tail`. In this form no
    # digits are lost as e goes to 1. The left side decreases with A, so bisection finds its zero.
    low, high = 0.0, 1 / e
    for _ in range(100):
        A = 0.5 * (low + high)
        if 0.5 * (1 - e) * (1 + e) + A * (_tail(A) + e**3 * _tail(-e * A)) > 0:
            low = A
        else:
            high = A
        if high - low <= 2.0**-53 * high:
            break
    return 0.5 * (low + high)


@strict_float
def damping_ratios(e: Floats) -> Floats:
    """Return the damping ratios, shape (n,), with which contacts that only push have the restitutions e.

    The result is NaN for e outside (0, 1].
    """
    out = np.empty(e.size)
    for i in range(e.size):
        out[i] = _damping_ratio(e[i])
    return out


def textbook_damping_ratios(e: Floats) -> Floats:
    """Return the damping ratios -ln e/sqrt(pi^2 + ln^2 e), with which contacts that may pull have the restitutions e.

    `e` has any shape, with numbers in (0, 1].
    """
    return -np.log(e) / np.hypot(np.pi, np.log(e))


@strict_float
def hunt_crossley_coefficients(e: Floats) -> Floats:
    """Return A = a |v0| for which the contact F = k p (1 + a p') has restitution e at the speed |v0|.

    `e` has the shape (n,), with numbers in (0, 1].
    """
    out = np.empty(e.size)
    for i in range(e.size):
        out[i] = _hunt_crossley(e[i])
    return out
