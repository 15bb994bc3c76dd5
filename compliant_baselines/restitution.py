"""From a coefficient of restitution to a damping and back: the contact that may push but not pull, and alternatives.

One number at a time, refusing what is illegal, and over arrays for the batches of the references: `damping_ratios` is
`damping_ratio` compiled; the test suite holds the two against each other. `hunt_crossley_coefficients` is the same
for the product law F = k p (1 + a p').

**Hunt and Crossley, exactly.** For a pair of reduced mass M that meets with u0, with u = p' as a function
of p,

    M u du/dp = -k p (1 + a u),    so    u du/(1 + a u) = -(k/M) p dp.

p is zero at both ends, where u is u0 and -e u0: the integral of u/(1 + a u) from -e u0 to u0 vanishes. With
A = a u0 that is

    A (1 + e) = ln((1 + A)/(1 - e A)),                                                    (*)

whatever the mass, the stiffness or the exponent of the spring (Hunt and Crossley, J. Applied Mechanics
42:440, 1975, give A = 3 (1 - e)/2, the first term as e goes to 1; (*) is exact, with 0 < A < 1/e). So a
third body on the contact does not change what its restitution is, but the speed u0 does: a is fixed, e
depends on the speed of approach. Both contacts take u0 = |v0|, the only speed a collision names.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import asinh, atan2, exp, hypot, inf, log, log1p, pi, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def root_between(function: Callable[[float], float], low: float, high: float) -> float:
    """Find the root of a function between two values of opposite sign, to rounding."""
    from scipy.optimize import root_scalar  # takes half a second, which a main process does without

    return float(root_scalar(function, bracket=(low, high), method="brentq", xtol=1e-300, rtol=1e-15).root)


def contact_time(zeta: float) -> float:
    """Duration of a Kelvin-Voigt contact that ends at zero force, times omega = sqrt(k/M); dimensionless.

    With w = sqrt(abs(1 - zeta^2)): 2 atan2(w, zeta)/w below zeta = 1, 2 there, and 2 asinh(w)/w above. These
    are theory's atan2(2 zeta w, 2 zeta^2 - 1)/w and ln((zeta + w)/(zeta - w))/w by the double-angle formulas;
    written so, nothing cancels near zeta = 1.

    Parameters
    ----------
    zeta : float
        Damping ratio, >= 0.

    Raises
    ------
    ValueError
        For a negative zeta.
    """
    if zeta < 0:
        raise ValueError(f"zeta = {zeta!r}; legal: a number >= 0")
    # Factored, 1 - zeta^2 keeps its digits near zeta = 1; two roots, so that a huge zeta does not overflow.
    w = sqrt(abs(1 - zeta)) * sqrt(1 + zeta)
    if w == 0:
        return 2.0
    return 2 * (atan2(w, zeta) if zeta < 1 else asinh(w)) / w


def restitution(zeta: float) -> float:
    """Coefficient of restitution of a Kelvin-Voigt contact that ends at zero force: exp(-zeta omega t).

    Raises
    ------
    ValueError
        For a negative zeta.
    """
    return exp(-zeta * contact_time(zeta))


@lru_cache(maxsize=4096)
def damping_ratio(e: float) -> float:
    """Damping ratio that gives the restitution e at zero force: `restitution` inverted, to rounding.

    Parameters
    ----------
    e : float
        Coefficient of restitution in (0, 1].

    Raises
    ------
    ValueError
        For e outside (0, 1]: no finite damping makes a contact perfectly plastic.
    """
    if not 0 < e <= 1:
        raise ValueError(f"e = {e!r}; legal: greater than 0, at most 1 (no finite damping gives e = 0)")
    loss = -log(e)
    if loss == 0:
        return 0.0
    # zeta contact_time(zeta) grows with zeta, contact_time <= pi, and zeta contact_time >= 2 ln zeta: the
    # root lies in [loss/pi, exp(loss/2)]. In ln zeta the function is tame at both ends and the error is
    # relative.
    low, high = log(loss / pi), loss / 2

    def excess(log_zeta: float) -> float:
        zeta = exp(log_zeta)
        return zeta * contact_time(zeta) - loss

    # Rounding may put the true root an ulp outside the bracket for e next to 1.
    return exp(root_between(excess, low - 1e-9, high + 1e-9))


def textbook_damping_ratio(e: float) -> float:
    """Give the damping ratio -ln e/sqrt(pi^2 + ln^2 e) of a contact that may pull (the naive mapping's).

    Raises
    ------
    ValueError
        For e outside (0, 1].
    """
    if not 0 < e <= 1:
        raise ValueError(f"e = {e!r}; legal: greater than 0, at most 1 (no finite damping gives e = 0)")
    return -log(e) / hypot(pi, log(e))


@njit(cache=True, error_model="numpy")
def _damping_ratio(e):
    """Damping ratio zeta with exp(-zeta T(zeta)) = e (docs/theory.md, section 7), T the duration of the contact."""
    loss = -log(e)
    if not 0 < loss < inf:
        return 0.0 if loss == 0 else np.nan
    # ln(zeta T) - ln(loss) in x = ln zeta rises with a slope between 0 and 1; see `damping_ratio`
    # for the bracket. Regula falsi, the end that stays halved (Illinois).
    low, high = log(loss / pi) - 1e-9, 0.5 * loss + 1e-9
    f_low, f_high, x, kept = 1.0, 1.0, low, 0
    for i in range(200):
        x = low if i == 0 else high if i == 1 else (low * f_high - high * f_low) / (f_high - f_low)
        zeta = exp(x)
        w = sqrt(abs(1 - zeta)) * sqrt(1 + zeta)
        # T = 2 atan2(w, zeta)/w, 2, 2 asinh(w)/w below, at and above zeta = 1
        duration = 2.0
        if w > 0:
            duration = 2 * (atan2(w, zeta) if zeta < 1 else asinh(w)) / w
        f = log(zeta * duration / loss)
        if f == 0:
            break
        if i == 0:
            f_low = f
        elif i == 1:
            f_high = f
        elif f > 0:
            if abs(high - x) <= 4e-16 * abs(x):
                break
            high, f_high, f_low, kept = x, f, (0.5 * f_low if kept == 1 else f_low), 1
        else:
            if abs(low - x) <= 4e-16 * abs(x):
                break
            low, f_low, f_high, kept = x, f, (0.5 * f_high if kept == -1 else f_high), -1
        if i > 0 and high - low <= 2e-16 * abs(x):
            break
    return exp(x)


@njit(cache=True, error_model="numpy")
def _tail(x):
    """(x - ln(1 + x) - x^2/2)/x^3, without cancellation."""
    if abs(x) > 0.25:
        return (x - log1p(x) - 0.5 * x * x) / (x * x * x)
    total, power = 0.0, -1.0
    for n in range(3, 40):
        total += power / n
        power *= -x
    return total


@njit(cache=True, error_model="numpy")
def _hunt_crossley(e):
    """Solve equation (*) for A, e in (0, 1]."""
    if not 0 < e < 1:
        return 0.0 if e == 1 else np.nan
    # Divided by A^2, (*) reads (1 - e^2)/2 + A (t(A) + e^3 t(-e A)) = 0 with t = `_tail`: no digits are
    # lost as e goes to 1. The left side falls with A.
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


@njit(cache=True, error_model="numpy")
def damping_ratios(e: Floats) -> Floats:
    """Damping ratio of a contact that may push but not pull; e of shape (n,) in (0, 1], NaN elsewhere."""
    out = np.empty(e.size)
    for i in range(e.size):
        out[i] = _damping_ratio(e[i])
    return out


@njit(cache=True, error_model="numpy")
def textbook_damping_ratios(e: Floats) -> Floats:
    """Damping ratio -ln e/sqrt(pi^2 + ln^2 e) of a contact that may pull; e of shape (n,) in (0, 1]."""
    out = np.empty(e.size)
    for i in range(e.size):
        out[i] = -log(e[i]) / sqrt(pi * pi + log(e[i]) ** 2)
    return out


@njit(cache=True, error_model="numpy")
def hunt_crossley_coefficients(e: Floats) -> Floats:
    """Solve for A = a |v0| of F = k p (1 + a p'), e at the speed |v0|; e of shape (n,) in (0, 1]."""
    out = np.empty(e.size)
    for i in range(e.size):
        out[i] = _hunt_crossley(e[i])
    return out
