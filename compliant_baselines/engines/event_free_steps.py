"""Bounds on the number of steps in which nothing happens, so that an engine need not be read after each of them.

Reading an engine can take longer than a step. Such an engine takes many steps in one call while no event can happen. An
event is that a contact begins or ends to carry force, that a gap closes or opens, or that the collision ends. States,
ends and velocities are then the same to the bit as if every step had been read.

The bounds are for contacts with the force F_i = max(0, Phi_i), Phi_i = -k_i g_i - c_i g_i', while the gap g_i is
negative. k_i and c_i are the stiffness and damping that the engine uses, and M_i is the reduced mass of the two bodies.
F_j/M_j, k_j/M_j and c_j/M_j below are summed over the active contacts j.

1. The time of the first event is bounded from below. Until then only the active contacts act. Let A be a bound on all
   |g_i''|; these are at most sum_j F_j/M_j + g with gravity g. Within the time s = 0.7/Omega, Omega = sqrt(sum_j
   k_j/M_j) + sum_j c_j/M_j, the force F_j grows by at most (k_j s + c_j)|g_j'| + (k_j s^2/2 + c_j s) A. With these
   bounds on the forces, the sum over j gives A <= B + phi A, where B contains all terms without A, and phi = sum_j (k_j
   s^2/2 + c_j s)/M_j <= 0.7. So A <= B/(1 - phi).
2. Phi_i keeps its sign as long as k_i (|g_i'| t + A t^2/2) + c_i A t < |Phi_i|, and g_i keeps its sign as long as
   |g_i'| t + A t^2/2 < |g_i|. A rate g_i' that leads away from zero may be replaced by 0.
3. Without gravity a collision is not over while a contact is active or bodies approach. With gravity there are three
   cases. While no contact is active, the collision cannot end, because all velocities change by the same amount. While
   only contact 2 is active, the collision can end only when B2 settles. While both contacts are active, it can end only
   when both balls settle. Balls settle when their energy has fallen far enough (`b2_has_settled`,
   `both_balls_have_settled`). Within the time s this energy does not fall to a sixteenth of its value. So a ball with
   more than 16 times the energy of a settled ball (`SAFE_ENERGY`) cannot settle within this time.
"""

from __future__ import annotations

import math

import numpy as np

from impact_xval.model.compiled import kernel_decorator

#: Options for compiling the functions of this module. Operations are rounded as they are written. Reference counts are
#: switched off, because they would take longer than the work itself. Helpers are called by compiled code only.
strict_kernel = kernel_decorator(fastmath=False, _nrt=False)
strict_helper = kernel_decorator(
    fastmath=False, _nrt=False, cache=False, no_cpython_wrapper=True, no_cfunc_wrapper=True
)

#: The contacts of two balls on a table, as bits of a set of contacts.
BALL_BALL, BALL_TABLE = 1, 2

#: In place of a set of active contacts, before the first step of a run.
NOT_STARTED = -1

#: Multiple of the largest energy of a settled ball. A ball with more energy cannot settle within the time s of rule 1
#: in the module's docstring.
SAFE_ENERGY = 16.0


#: Parameters of a scene that compiled functions need, in SI units; an array of one record.
#:
#: * ``contacts``: number of contacts, N with a table, N - 1 without
#: * ``step``: length of a step in s
#: * ``rounding``: largest impulse in a step, over the momenta, that rounding alone can cause (`World.rounding`)
#: * ``pulls``: 1 if contacts may pull, else 0
#: * ``gravity``: gravity in m/s^2; 0 without gravity, and in a drop from the first flight on
#:
#: The following fields are only for drops, and otherwise 0:
#:
#: * ``k1``, ``k2``: stiffness in N/m of the contact between the balls and of the support of B2
#: * ``depth_of_b2``: depth in m at which B2 alone rests in the table
#: * ``depth_of_b1_in_b2``: depth in m at which B1 rests in B2
#: * ``depth_of_b2_loaded``: depth in m at which B2 rests in the table with B1 on it
SCENE_NUMBERS = np.dtype(
    (
        np.record,
        [
            ("contacts", "i8"),
            ("step", "f8"),
            ("rounding", "f8"),
            ("pulls", "i8"),
            ("gravity", "f8"),
            ("k1", "f8"),
            ("k2", "f8"),
            ("depth_of_b2", "f8"),
            ("depth_of_b1_in_b2", "f8"),
            ("depth_of_b2_loaded", "f8"),
        ],
    )
)

#: Parameters of a contact as the engine uses them: stiffness in N/m, damping in N s/m, and the reduced mass in kg.
CONTACT_LAW = np.dtype((np.record, [("stiffness", "f8"), ("damping", "f8"), ("mass", "f8")]))


@strict_helper
def _above_next(values, i):  # pragma: no cover (compiled)
    """Return a height or velocity of ball i relative to the next ball, or to the table if ball i is the last one."""
    return values[i] - values[i + 1] if i + 1 < values.size else values[i]


@strict_helper
def _time_to(distance, rate, acceleration):  # pragma: no cover (compiled)
    """Return the time t at which `rate t + acceleration t^2/2` equals a distance; all three are >= 0."""
    root = math.sqrt(rate * rate + 2 * acceleration * distance)
    return 2 * distance / (rate + root) if root > 0 else math.inf


@strict_helper
def _time_to_event(carries, k, c, gap, rate, acceleration):  # pragma: no cover (compiled)
    """Return a time in which a contact neither begins nor ends to carry force, and its gap keeps its sign.

    The time is 0 if the contact does not obey the law at present, which happens within a step or two of an event.
    """
    force = -k * gap - c * rate
    if carries:
        if force <= 0 or gap >= 0:
            return 0.0
        return _time_to(force, k * max(rate, 0.0) + c * acceleration, k * acceleration)
    if gap >= 0:
        return _time_to(gap, max(-rate, 0.0), acceleration)
    if force >= 0:
        return 0.0
    until_force = _time_to(-force, k * max(-rate, 0.0) + c * acceleration, k * acceleration)
    return min(until_force, _time_to(-gap, max(rate, 0.0), acceleration))


@strict_helper
def b2_has_settled(v2, x2, masses, numbers, multiple):  # pragma: no cover (compiled)
    """Return True if B2's energy about equilibrium is at most `multiple` times its energy of settling.

    The energy of settling is the energy with which B2 can just unload its support. `v2` in m/s and `x2` in m are its
    velocity and height; `numbers` is a record of `SCENE_NUMBERS`.
    """
    m2, k2, displacement = masses[1], numbers.k2, x2 + numbers.depth_of_b2
    energy = m2 * v2 * v2 + k2 * displacement**2
    return energy <= multiple * (m2 * numbers.gravity) ** 2 / k2


@strict_helper
def both_balls_have_settled(v1, v2, x1, x2, masses, numbers, multiple):  # pragma: no cover (compiled)
    """Return True if the balls' energy about equilibrium is at most `multiple` times their energy of settling.

    The energy of settling is the energy with which the balls can just unload one of their contacts.
    """
    m1, m2, g, k1, k2 = masses[0], masses[1], numbers.gravity, numbers.k1, numbers.k2
    energy = m1 * v1 * v1 + m2 * v2 * v2
    energy += k1 * (x2 - x1 - numbers.depth_of_b1_in_b2) ** 2 + k2 * (x2 + numbers.depth_of_b2_loaded) ** 2
    return energy <= multiple * g * g * min(m1**2 / k1, (m1 + m2) ** 2 / k2)


@strict_helper
def _may_settle_soon(active, v, x, masses, numbers):  # pragma: no cover (compiled)
    """Return True if a drop may end by settling balls within the time s of the module's docstring (rule 3)."""
    if active == BALL_BALL | BALL_TABLE:
        return both_balls_have_settled(v[0], v[1], x[0], x[1], masses, numbers, SAFE_ENERGY)
    if not active & BALL_BALL:
        return b2_has_settled(v[1], x[1], masses, numbers, SAFE_ENERGY)
    return False


@strict_kernel
def count_event_free_steps(active, v, x, masses, law, scene_numbers):  # pragma: no cover (compiled)
    """Return the number of next steps in which no event happens, at most a million.

    It is two less than the number of steps in the bound on the time, for two reasons. The step with the event may begin
    before the bound. And an engine may compute a force at the end of a step but a gap at its beginning.

    Parameters
    ----------
    active
        The contacts that carried force in the last step, as bits, or `NOT_STARTED`.
    v, x
        Velocities in m/s and heights in m after the last step, shape (N,).
    masses
        Masses in kg, shape (N,).
    law
        Records of `CONTACT_LAW`, shape (C,).
    scene_numbers
        One record of `SCENE_NUMBERS`, shape (1,).
    """
    numbers = scene_numbers[0]
    if active < 0:
        return 0
    g = numbers.gravity
    if g > 0 and _may_settle_soon(active, v, x, masses, numbers):
        return 0
    # Sums of rule 1 over the active contacts: of k/M, of c/M, of the forces over M, and of the growth of these forces
    # in a unit of time over M.
    stiff = damp = force = growth = 0.0
    for i in range(law.size):
        if active >> i & 1:
            k, c, M = law[i].stiffness, law[i].damping, law[i].mass
            gap, rate = _above_next(x, i), _above_next(v, i)
            stiff, damp, growth = stiff + k / M, damp + c / M, growth + k * abs(rate) / M
            force += (max(0.0, -k * gap - c * rate) + c * abs(rate)) / M
    # If no contact is active, only the gaps bound the time.
    s, acceleration = math.inf, g
    if active > 0:
        s = 0.7 / (math.sqrt(stiff) + damp)
        acceleration = (force + growth * s + g) / (1 - 0.5 * stiff * s * s - damp * s)
    for i in range(law.size):
        gap, rate = _above_next(x, i), _above_next(v, i)
        carries = active >> i & 1 == 1
        s = min(s, _time_to_event(carries, law[i].stiffness, law[i].damping, gap, rate, acceleration))
    return max(0, int(min(s / numbers.step, 1e6)) - 2)


@strict_helper
def _fill_accelerations(out, active, v, x, masses, law, g):  # pragma: no cover (compiled)
    """Fill `out` with the accelerations in m/s^2, shape (N,), that the active contacts and gravity cause."""
    from_above = 0.0
    for i in range(masses.size):
        force = 0.0
        if active >> i & 1:
            force = -law[i].stiffness * _above_next(x, i) - law[i].damping * _above_next(v, i)
        out[i] = (force - from_above) / masses[i] - g
        from_above = force


@strict_kernel
def hermite_interpolate(
    out, active, v, x, v_end, x_end, times, span, masses, law, g, accelerations
):  # pragma: no cover (compiled)
    """Interpolate velocities in m/s within event-free steps, by Hermite's cubic polynomials.

    The polynomials have the same velocities and accelerations as the balls before the first step and after the last.
    scipy's CubicHermiteSpline returns the same velocities to 1e-15. But a spline object for every call makes PyBullet's
    paths three times as slow.

    Parameters
    ----------
    out
        Filled with the velocities; shape (n, N).
    active, masses, law
        The same arguments as in `count_event_free_steps`.
    v, x, v_end, x_end
        Velocities in m/s and heights in m before the first step and after the last, shape (N,).
    times
        Times as fractions of the time of all steps, shape (n,).
    span
        Time of all steps, in s.
    g
        Gravity in m/s^2.
    accelerations
        Working memory, shape (2, N).
    """
    begin, end = accelerations[0], accelerations[1]
    _fill_accelerations(begin, active, v, x, masses, law, g)
    _fill_accelerations(end, active, v_end, x_end, masses, law, g)
    for n in range(times.size):
        t = times[n]
        rest = 1 - t
        left, right = (1 + 2 * t) * rest * rest, t * t * (3 - 2 * t)
        slope, end_slope = t * rest * rest * span, -t * t * rest * span
        for i in range(v.size):
            out[n, i] = left * v[i] + right * v_end[i] + slope * begin[i] + end_slope * end[i]
