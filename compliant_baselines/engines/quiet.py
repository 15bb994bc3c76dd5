"""For how many steps nothing can happen: how an engine may be left alone without missing anything.

Where no contact begins or ends to carry force, no gap closes or opens, and the collision cannot be over, an engine
whose steps are cheaper than its reads takes many in one call: the same states, ends and velocities, to the bit.

The bounds hold for F_i = max(0, Phi_i), Phi_i = -k_i g_i - c_i g_i', while the gap g_i is negative, with k_i and c_i as
the engine has them and M_i the reduced mass of the two bodies.

1. Up to the first change only the contacts that carry force act, and the bound is on the time of that change: sums are
   over them alone. Let A bound all |g_i''|; they are at most sum_j F_j/M_j + g. Within s = 0.7/Omega, Omega =
   sqrt(sum_j k_j/M_j) + sum_j c_j/M_j, a force grows by at most (k_i s + c_i)|g_i'| + (k_i s^2/2 + c_i s) A. The second
   term feeds the share phi = sum_j (k_j s^2/2 + c_j s)/M_j <= 0.7 of A back into it: A is at most what the rest makes
   over 1 - phi.
2. Phi_i keeps its sign as long as k_i (|g_i'| t + A t^2/2) + c_i A t < |Phi_i|, and g_i its own as long as
   |g_i'| t + A t^2/2 < |g_i|; a rate that leads away from zero counts as none.
3. While a contact carries force, or bodies approach, a collision without gravity is not over. With gravity, while no
   contact carries force it cannot become over (velocities only fall together); while B2 alone is carried, only by
   coming to rest, and while both are, only by being stuck: both take an energy (`engines.stepping`) that within s does
   not fall to a sixteenth.
"""

from __future__ import annotations

import math

import numpy as np

from impact_xval.model.compiled import strict_float, strict_float_helper


@strict_float_helper
def _above_next(values, i):  # pragma: no cover (compiled)
    """Height or velocity of ball i relative to the next one, or to the table."""
    return values[i] - values[i + 1] if i + 1 < values.size else values[i]


@strict_float_helper
def _time_to(distance, rate, acceleration):  # pragma: no cover (compiled)
    """Time in which `rate t + acceleration t^2/2` grows to a distance; all three >= 0."""
    root = math.sqrt(rate * rate + 2 * acceleration * distance)
    return 2 * distance / (rate + root) if root > 0 else math.inf


@strict_float_helper
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


@strict_float_helper
def rests(v, x, masses, weight, times):  # pragma: no cover (compiled)
    """Whether B2's energy about equilibrium is at most so many times what it takes to unload its support."""
    m2, g, k2, rest = masses[1], weight[0], weight[2], weight[3]
    return m2 * v[1] * v[1] + k2 * (x[1] + rest) ** 2 <= times * (m2 * g) ** 2 / k2


@strict_float_helper
def sticks(v, x, masses, weight, times):  # pragma: no cover (compiled)
    """Whether the energy of both balls about equilibrium is at most so many times what it takes to unload a contact."""
    m1, m2 = masses[0], masses[1]
    g, k1, k2 = weight[0], weight[1], weight[2]
    rest1, rest12 = weight[4], weight[5]
    energy = m1 * v[0] * v[0] + m2 * v[1] * v[1]
    energy += k1 * (x[1] - x[0] - rest1) ** 2 + k2 * (x[1] + rest12) ** 2
    return energy <= times * g * g * min(m1**2 / k1, (m1 + m2) ** 2 / k2)


@strict_float
def quiet_steps(code, v, x, masses, law, weight, h):  # pragma: no cover (compiled)
    """Count the steps in which nothing happens: two less than their time has, at most a million.

    One, because the step after the time may begin within it; another, because an engine may look at a force
    at the end of the step and at a gap at its beginning. The state after the last step is `v` in m/s and `x` in m;
    `code` are the contacts that carried force in it, as bits, negative if there was none. `law`, shape (3, C), holds k
    and c as the engine has them, and the reduced masses; `weight` is as of `stepping.scan`.
    """
    if code < 0:
        return 0
    contacts, g = law.shape[1], weight[0]
    if g > 0:  # 3 of the module: a drop of two balls that may soon be stuck, or over by rest
        if code == 3 and sticks(v, x, masses, weight, 16.0):
            return 0
        if not code & 1 and rests(v, x, masses, weight, 16.0):
            return 0
    stiff = damp = force = pull = 0.0
    for i in range(contacts):
        if code >> i & 1:
            k, c, M = law[0, i], law[1, i], law[2, i]
            gap, rate = _above_next(x, i), _above_next(v, i)
            stiff, damp, pull = stiff + k / M, damp + c / M, pull + k * abs(rate) / M
            force += (max(0.0, -k * gap - c * rate) + c * abs(rate)) / M
    # In flight the gaps alone bound the time.
    s, acceleration = math.inf, g
    if code > 0:
        s = 0.7 / (math.sqrt(stiff) + damp)
        acceleration = (force + pull * s + g) / (1 - 0.5 * stiff * s * s - damp * s)
    for i in range(contacts):
        gap, rate = _above_next(x, i), _above_next(v, i)
        s = min(s, _contact(code >> i & 1 == 1, law[0, i], law[1, i], gap, rate, acceleration))
    return max(0, int(min(s / h, 1e6)) - 2)


@strict_float_helper
def _accelerate(code, v, x, masses, law, g):  # pragma: no cover (compiled)
    """Accelerations in m/s^2, shape (N,), by the law of the contacts that carry force."""
    found, above = np.empty(masses.size), 0.0
    for i in range(masses.size):
        force = 0.0
        if code >> i & 1:
            force = -law[0, i] * _above_next(x, i) - law[1, i] * _above_next(v, i)
        found[i] = (force - above) / masses[i] - g
        above = force
    return found


@strict_float
def between(code, v, x, v_end, x_end, times, span, masses, law, g):  # pragma: no cover (compiled)
    """Interpolate velocities in m/s, shape (n, N), within quiet steps that take the time `span` in s.

    They lie on the cubics through velocities and accelerations at both ends: velocities and heights before the first
    step and after the last, shape (N,). Times, shape (n,), are shares of the span; g is the gravity in m/s^2.
    """
    a, b = _accelerate(code, v, x, masses, law, g), _accelerate(code, v_end, x_end, masses, law, g)
    found = np.empty((times.size, v.size))
    for n in range(times.size):
        t = times[n]
        rest = 1 - t
        left, right = (1 + 2 * t) * rest * rest, t * t * (3 - 2 * t)
        slope, end_slope = t * rest * rest * span, -t * t * rest * span
        for i in range(v.size):
            found[n, i] = left * v[i] + right * v_end[i] + slope * a[i] + end_slope * b[i]
    return found
