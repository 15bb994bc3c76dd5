"""For how many steps nothing can happen: how an engine may be left alone without missing anything.

An engine that is read after every step is read far more often than there is anything to see: between two
events the same contacts carry force, and the collision is not over. `_quiet_time` gives a time within which,
by bounds on forces and rates, no contact begins or ends to carry force, no gap closes or opens, and the
collision is not over. An adapter whose steps are cheaper than its reads takes the steps of that time in one
call and loses nothing: states, ends and velocities are those of a run that was read after every step, to the
bit.

The bounds hold for the law an adapter was asked for, F_i = max(0, -k_i g_i - c_i g_i') while the gap g_i is
negative, with k_i and c_i as the engine has them. In what follows Phi_i = -k_i g_i - c_i g_i' is that force
before it is cut off at zero.

1. Let A bound |g_1''| and |g_2''|, which are at most F1/M1 + F2/m2 + g. Within s = 0.7/Omega, Omega =
   sqrt(k1/M1 + k2/m2) + c1/M1 + c2/m2, a force grows by at most (k_i s + c_i)|g_i'| + (k_i s^2/2 + c_i s) A.
   The second term feeds the share phi = (k1/M1 + k2/m2) s^2/2 + (c1/M1 + c2/m2) s <= 0.7 of A back into it: A is
   at most what the rest makes over 1 - phi.
2. Phi_i keeps its sign as long as k_i (|g_i'| t + A t^2/2) + c_i A t < |Phi_i|, and g_i its own as long as
   |g_i'| t + A t^2/2 < |g_i|; a rate that leads away from zero counts as none.
3. While neither contact carries force the collision cannot become over (its velocities only fall together).
   While B2 alone is carried, only by coming to rest, and while both are, only by being stuck: both take an
   energy (`engines.trajectory`) that within s does not fall to a sixteenth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from impact_xval.compliant_baselines.engines.trajectory import ScanParameters


class EngineContacts(NamedTuple):
    """Contacts 1 and 2 as the engine has them: k in N/m, c in N s/m, M the reduced mass of contact 1 in kg."""

    k1: float
    c1: float
    k2: float
    c2: float
    M1: float


@numba.njit(cache=True, error_model="numpy")
def _time_to(distance, rate, acceleration):  # pragma: no cover (compiled)
    """Time in which `rate t + acceleration t^2/2` grows to a distance; all three >= 0."""
    root = math.sqrt(rate * rate + 2 * acceleration * distance)
    return 2 * distance / (rate + root) if root > 0 else math.inf


@numba.njit(cache=True, error_model="numpy")
def _contact(loaded, k, c, gap, rate, acceleration):  # pragma: no cover (compiled)
    """Time within which a contact neither begins nor ends to carry force, nor its gap changes sign.

    0 where what it does is not what the law says, as it is within a step or two of an event.
    """
    force = -k * gap - c * rate
    if loaded:
        if force <= 0 or gap >= 0:
            return 0.0
        return _time_to(force, k * max(rate, 0.0) + c * acceleration, k * acceleration)
    if gap >= 0:
        return _time_to(gap, max(-rate, 0.0), acceleration)
    if force >= 0:
        return 0.0
    loads = _time_to(-force, k * max(-rate, 0.0) + c * acceleration, k * acceleration)
    return min(loads, _time_to(-gap, max(rate, 0.0), acceleration))


@numba.njit(cache=True, error_model="numpy")
def _quiet_time(code, v1, v2, x1, x2, p, pair):  # pragma: no cover (compiled)
    """Bound the time in which nothing happens, in s, after a step in this state; see the module."""
    loaded1, loaded2 = code == 1 or code == 3, code == 1 or code == 2
    gap1, rate1 = x1 - x2, v1 - v2
    stiff = pair.k1 / pair.M1 + pair.k2 / p.m2
    damp = pair.c1 / pair.M1 + pair.c2 / p.m2
    s = 0.7 / (math.sqrt(stiff) + damp)
    if p.g > 0:
        if loaded1 and loaded2:
            away1, away2 = x2 - x1 - p.m1 * p.g / p.k1, x2 - p.x2_rest + p.m1 * p.g / p.k2
            energy = p.m1 * v1 * v1 + p.m2 * v2 * v2 + p.k1 * away1 * away1 + p.k2 * away2 * away2
            stuck_below = p.g * p.g * min(p.m1**2 / p.k1, (p.m1 + p.m2) ** 2 / p.k2)
            if energy <= 16 * stuck_below:
                return 0.0
        elif not loaded1:
            away = x2 - p.x2_rest
            if p.m2 * v2 * v2 + p.k2 * away * away <= 16 * (p.m2 * p.g) ** 2 / p.k2:
                return 0.0
    force1 = max(0.0, -pair.k1 * gap1 - pair.c1 * rate1) if gap1 < 0 else 0.0
    force2 = max(0.0, -pair.k2 * x2 - pair.c2 * v2) if x2 < 0 else 0.0
    if loaded1 or loaded2 or gap1 < 0 or x2 < 0:
        force1 += (pair.k1 * s + pair.c1) * abs(rate1)
        force2 += (pair.k2 * s + pair.c2) * abs(v2)
        feedback = 0.5 * stiff * s * s + damp * s
        acceleration = (force1 / pair.M1 + force2 / p.m2 + p.g) / (1 - feedback)
    else:
        # Both in flight: the gaps alone bound the time.
        s, acceleration = math.inf, p.g
    s = min(s, _contact(loaded1, pair.k1, pair.c1, gap1, rate1, acceleration))
    return min(s, _contact(loaded2, pair.k2, pair.c2, x2, v2, acceleration))


@numba.njit(cache=True, error_model="numpy")
def _unpacked(packed):  # pragma: no cover (compiled)
    p = ScanParameters(packed[0], packed[1], packed[2], packed[3], packed[4], packed[5], packed[6])
    return p, EngineContacts(packed[7], packed[8], packed[9], packed[10], packed[11])


@numba.njit(cache=True, error_model="numpy")
def quiet_steps(code, v, x, packed):  # pragma: no cover (compiled)
    """Count the steps in which nothing happens: two less than their time has, at most a million.

    One, because the step after the time may begin within it; another, because an engine may look at a force
    at the end of the step and at a gap at its beginning.

    Parameters
    ----------
    code : int
        State of the last step, 1 to 4; 0 if there was none, and then nothing is known and the count is 0.
    v, x : ndarray, shape (2,)
        Velocities in m/s and heights in m of B1 and B2 after it.
    packed : ndarray, shape (12,)
        The fields of `ScanParameters` and of `EngineContacts`: an array is handed to compiled code faster than tuples.
    """
    if code == 0:
        return 0
    p, pair = _unpacked(packed)
    return max(0, int(min(_quiet_time(code, v[0], v[1], x[0], x[1], p, pair) / p.h, 1e6)) - 2)


@numba.njit(cache=True, error_model="numpy")
def _accelerations(code, v1, v2, x1, x2, p, pair):  # pragma: no cover (compiled)
    """Accelerations of B1 and B2 in m/s^2 by the law of the contacts that carry force."""
    force1 = -pair.k1 * (x1 - x2) - pair.c1 * (v1 - v2) if code == 1 or code == 3 else 0.0
    force2 = -pair.k2 * x2 - pair.c2 * v2 if code == 1 or code == 2 else 0.0
    return force1 / p.m1 - p.g, (force2 - force1) / p.m2 - p.g


@numba.njit(cache=True, error_model="numpy")
def between(code, v, x, v_end, x_end, first, n, stride, packed):  # pragma: no cover (compiled)
    """Interpolate the velocities within n quiet steps: cubics through velocities and accelerations at both ends.

    Parameters
    ----------
    code, packed
        State of these steps, and the column, as of `quiet_steps`.
    v, x, v_end, x_end : ndarray, shape (2,)
        Velocities and heights before the first and after the last of them.
    first, n : int
        Number of the step they begin with, from 0, and how many they are.
    stride : int
        Points are wanted whose number is a multiple of it; the last one is always among them.

    Returns
    -------
    ndarray, shape (points, 3)
        Number of the point, v1, v2.
    """
    p, pair = _unpacked(packed)
    a = _accelerations(code, v[0], v[1], x[0], x[1], p, pair)
    b = _accelerations(code, v_end[0], v_end[1], x_end[0], x_end[1], p, pair)
    start = (first // stride + 1) * stride
    inner = max(0, -(-(first + n - start) // stride))
    points, span = np.empty((inner + 1, 3)), n * p.h
    for k in range(inner + 1):  # a slice of an array takes five times as long to compile
        number = start + k * stride if k < inner else first + n
        t = (number - first) / n
        rest = 1 - t
        left, right = (1 + 2 * t) * rest * rest, t * t * (3 - 2 * t)
        slope, end_slope = t * rest * rest * span, -t * t * rest * span
        points[k, 0] = number
        for i in range(2):
            points[k, 1 + i] = left * v[i] + right * v_end[i] + slope * a[i] + end_slope * b[i]
    return points
