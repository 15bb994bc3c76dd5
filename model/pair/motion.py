"""Exact motion of two balls on a table inside a state.

In S1 both contacts are active. `Modes` holds the natural modes of this motion, and `modes_of` computes them.
`amplitudes` converts rates and forces into modal coordinates, `modal_coordinates` moves these in time, and `motion_of`
converts them back. In S2 and S3 a single contact is active, and `follow_single_contact` computes the motion.

Written in time, equations (13)-(15) of docs/theory.md are the equations of two linear springs with the forces
F_i = dI_i/dt = sqrt(2 k_i E_i):

    d1' = F2/m2 - F1/M      v2' = (F2 - F1)/m2      F1' = k1 d1      F2' = -k2 v2

Here d1 = v2 - v1 is the rate of compression of the contact between the balls, -v2 is the rate of compression of the
contact with the table, and 1/M = 1/m1 + 1/m2. Between events the equations are solved in closed form. In S1 the
solution consists of the two modes of a 2x2 stiffness matrix. In S2 and S3 the solution is one sinusoid, of which only
the impulses are needed (section 1 of the supplement).

The unknowns are d1, v2, F1, F2 instead of v1, v2, E1, E2 for two reasons. First, all four are continuous at every
event, because an end of compression changes only a stiffness. Second, none of them is a small difference of large
numbers if one contact is far stiffer than the other. The coefficients below are free of cancellation, too.

Units: m1 = 1, v0 = -1, k1 = 1 initially (Theorem 5). Hence mu = m2/m1, and velocities are divided by |v0|.

Used by `pair.kernel`, `pair.events`, `pair.ringing`, `pair.grazing`, `pair.roots` and `pair.path`.
"""

from __future__ import annotations

from math import cos, factorial, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from impact_xval.model.compiled import force_inlined

#: pi in two parts. The first part has 33 bits, so that its product with any multiple in use is exact.
PI = (float.fromhex("0x1.921fb544p+1"), float.fromhex("0x1.0b4611a626331p-33"))
INVERSE_PI = 1 / pi

#: Coefficients 1/n! of Taylor's series, by n.
T = tuple(1 / factorial(n) for n in range(22))

#: Angle in radians above which `cos_sin` calls the functions of the library.
LARGEST_ANGLE = 1e5


@force_inlined
def cos_sin(x):
    """Return cosine and sine of an angle x >= 0 in radians, each to within 4e-16.

    The function is faster than the two functions of the library, because it has a single branch; further branches would
    be unpredictable. The nearest multiple of pi, in two parts, is subtracted from the angle (Cody and Waite). Then
    Taylor's series is summed.
    """
    if x > LARGEST_ANGLE:
        return cos(x), sin(x)
    n = np.rint(x * INVERSE_PI)
    r = (x - n * PI[0]) - n * PI[1]
    sign = 1.0 - 2.0 * (n - 2.0 * np.floor(0.5 * n))
    # The series up to r^21 are summed in Estrin's order, so that few operations wait for one another. Because
    # abs(r) <= pi/2, the remainder is below 2e-17.
    z = r * r
    z2 = z * z
    z4 = z2 * z2
    c = (
        (T[0] - z * T[2])
        + z2 * (T[4] - z * T[6])
        + z4 * ((T[8] - z * T[10]) + z2 * (T[12] - z * T[14]) + z4 * ((T[16] - z * T[18]) + z2 * T[20]))
    )
    s = (
        (T[3] - z * T[5])
        + z2 * (T[7] - z * T[9])
        + z4 * ((T[11] - z * T[13]) + z2 * (T[15] - z * T[17]) + z4 * (T[19] - z * T[21]))
    )
    return sign * c, sign * (r - r * z * s)


class Modes(NamedTuple):
    """Natural modes of the two springs of S1. Each pair of numbers belongs to the slow and the fast mode.

    With w = (v1, v2), the equations of motion are diag(1, mu) w'' = -K w, K = [[k1, -k1], [-k1, k1 + k2]]. Mode j has
    the frequency omega_j and the shape (phi1, phi2) of unit modal mass, phi1^2 + mu phi2^2 = 1.
    """

    k1: float
    k2: float
    omega: tuple[float, float]
    phi1: tuple[float, float]
    phi2: tuple[float, float]
    #: delta = phi2 - phi1 and sigma = phi1 + mu phi2. They are computed as -omega^2 phi1/k1 and k2 phi2/omega^2, by the
    #: two rows of the eigenvalue equation. So no digits are lost if a mode is nearly rigid or nearly massless.
    delta: tuple[float, float]
    sigma: tuple[float, float]
    #: Forces of both contacts per unit of r_j: omega phi1 and omega sigma.
    force1: tuple[float, float]
    force2: tuple[float, float]


@force_inlined
def modes_of(mu, k1, k2):
    """Return the natural modes for the mass ratio mu = m2/m1 and the stiffnesses k1 and k2."""
    inverse_mu = 1 / mu
    s12 = -k1 * sqrt(inverse_mu)
    difference = k1 - (k1 + k2) * inverse_mu
    spread = sqrt(difference * difference + 4 * s12 * s12)
    fast2 = 0.5 * (k1 + (k1 + k2) * inverse_mu + spread)
    per_fast2, per_k1 = 1 / fast2, 1 / k1
    slow2 = k1 * per_fast2 * (k2 * inverse_mu)  # the product of the eigenvalues is k1 k2/mu
    # The eigenvector of the fast mode is (y, s12) or (s12, -y). The square of its length is y times spread.
    y = 0.5 * (spread + abs(difference))
    scale = 1 / sqrt(y * spread)
    y1, y2 = (y * scale, s12 * scale) if difference >= 0 else (s12 * scale, y * scale)
    root = sqrt(inverse_mu)
    slow1, slow_2, fast1, fast_2 = -y2, y1 * root, y1, y2 * root
    slow, fast = sqrt(slow2), sqrt(fast2)
    sigma = (slow_2 * mu * fast2 * per_k1, k2 * fast_2 * per_fast2)
    return Modes(
        k1,
        k2,
        omega=(slow, fast),
        phi1=(slow1, fast1),
        phi2=(slow_2, fast_2),
        delta=(-slow2 * slow1 * per_k1, -fast2 * fast1 * per_k1),
        sigma=sigma,
        force1=(slow * slow1, fast * fast1),
        force2=(slow * sigma[0], fast * sigma[1]),
    )


class Motion(NamedTuple):
    """Rates of compression and forces of both contacts at one time."""

    #: Rate of compression v2 - v1 of the contact between the balls.
    d1: float
    #: Velocity of ball 2, which is minus the rate of compression of its contact with the table.
    v2: float
    F1: float
    F2: float


@force_inlined
def amplitudes(d1, v2, u1, u2, modes):
    """Return the pairs a and b of the motion q_j(t) = a_j cos(omega_j t) + b_j sin(omega_j t) that starts in a state.

    The modal coordinates are q_j = phi1 v1 + mu phi2 v2 and r_j = q_j'/omega_j. At t = 0, q = a and r = b. The state
    consists of the rates d1 and v2 and the compressions u1 = F1/k1 and u2 = F2/k2 of linear springs.
    """
    phi1, sigma, force1, force2 = modes.phi1, modes.sigma, modes.force1, modes.force2
    return (
        (sigma[0] * v2 - phi1[0] * d1, sigma[1] * v2 - phi1[1] * d1),
        (force2[0] * u2 + force1[0] * u1, force2[1] * u2 + force1[1] * u1),
    )


@force_inlined
def modal_coordinates(t, omega, a, b):
    """Return the modal coordinates (q_slow, q_fast) and (r_slow, r_fast) at time t, which are a and b at time 0."""
    (cos_slow, sin_slow), (cos_fast, sin_fast) = cos_sin(omega[0] * t), cos_sin(omega[1] * t)
    return rotate(cos_slow, sin_slow, cos_fast, sin_fast, a, b)


@force_inlined
def rotate(cos_slow, sin_slow, cos_fast, sin_fast, q, r):
    """Return the modal coordinates q and r after both modes have turned by angles with the given cosines and sines."""
    return (
        (q[0] * cos_slow + r[0] * sin_slow, q[1] * cos_fast + r[1] * sin_fast),
        (r[0] * cos_slow - q[0] * sin_slow, r[1] * cos_fast - q[1] * sin_fast),
    )


@force_inlined
def rotate_briefly(h, omega, q, r):
    """Return the modal coordinates q and r a short time h later, by short series of sine and cosine.

    They are exact to rounding if abs(omega_j h) <= 0.1.
    """
    x, y = omega[0] * h, omega[1] * h
    x2, y2 = x * x, y * y
    cos_slow = 1 - x2 * (0.5 - x2 * (1 / 24 - x2 * (1 / 720 - x2 * (1 / 40320))))
    cos_fast = 1 - y2 * (0.5 - y2 * (1 / 24 - y2 * (1 / 720 - y2 * (1 / 40320))))
    sin_slow = x * (1 - x2 * (1 / 6 - x2 * (1 / 120 - x2 * (1 / 5040 - x2 * (1 / 362880)))))
    sin_fast = y * (1 - y2 * (1 / 6 - y2 * (1 / 120 - y2 * (1 / 5040 - y2 * (1 / 362880)))))
    return rotate(cos_slow, sin_slow, cos_fast, sin_fast, q, r)


@force_inlined
def motion_of(q, r, modes):
    """Return the rates and forces that belong to modal coordinates q and r; this is the inverse of `amplitudes`.

    F1 = m1 v1' and F2 = F1 + m2 v2', which are equations (11) and (12) differentiated.
    """
    delta, phi2, force1, force2 = modes.delta, modes.phi2, modes.force1, modes.force2
    return Motion(
        delta[0] * q[0] + delta[1] * q[1],
        phi2[0] * q[0] + phi2[1] * q[1],
        force1[0] * r[0] + force1[1] * r[1],
        force2[0] * r[0] + force2[1] * r[1],
    )


class Exit(NamedTuple):
    """End of a segment in which a single contact was active."""

    #: True if the inactive contact becomes active again (S1 follows); False if the active contact ended restitution (S4
    #: follows).
    returns: bool
    #: Whether compression of the active contact ended in the segment, or at its end.
    compression_ended: bool
    #: Impulse of the active contact during the segment.
    impulse: float
    #: Rate of compression of the active contact at the end of the segment.
    rate: float
    #: Strain energy of the active contact at the end of the segment.
    energy: float


@force_inlined
def follow_single_contact(mass, d, E, e, compressing, impulse_to_return):
    """Follow state S2 or S3, in which a single contact is active, from its start to its end.

    This is section 1 of the supplement, applied to both states. `mass` is M in its equation (1), the mass that the
    contact works against: m1 m2/(m1 + m2) in S3, and m2 in S2. d and E are the rate of compression and the strain
    energy at the start. The inactive contact becomes active again when the active contact has given the impulse
    `impulse_to_return`, which is m2 v2 in S3 and m2 (v1 - v2) in S2.
    """
    # Rate of compression that alone has the energy of d and E together.
    w = sqrt(d * d + 2 * E / mass)
    if compressing:
        w *= e
    maximum = mass * (d + w)  # Delta I_max of the supplement, in both of its cases
    if not impulse_to_return < maximum:
        return Exit(False, compressing, maximum, -w, 0.0)
    d_exit = d - impulse_to_return / mass
    if compressing and d_exit > 0:
        # The contact is still in compression. Its energy is equation (2) of the supplement, as a sum of positive terms.
        return Exit(True, False, impulse_to_return, d_exit, E + 0.5 * impulse_to_return * (d + d_exit))
    # The contact is in restitution. Its energy is equation (4), factored so that a small energy keeps its digits.
    return Exit(
        True, compressing, impulse_to_return, d_exit, 0.5 * (maximum - impulse_to_return) * (w - d_exit)
    )
