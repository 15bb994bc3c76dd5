"""Exact motion of two balls on a table inside a state.

`Modes` and `modes_of` are the natural modes of S1. `amplitudes` turns a state into modal coordinates,
`modal_coordinates` moves these in time, and `motion_of` turns them back. `follow_single_contact` is the motion in S2
and S3.

Written in time, equations (13)-(15) are the equations of two linear springs, F_i = dI_i/dt = sqrt(2 k_i E_i):

    d1' = F2/m2 - F1/M      v2' = (F2 - F1)/m2      F1' = k1 d1      F2' = -k2 v2

Here d1 = v2 - v1 is the compression rate of the ball-ball contact, -v2 the compression rate of the ball-table contact,
and 1/M = 1/m1 + 1/m2. Between events the equations are solved in closed form. In S1 the solution consists of the two
modes of a 2x2 stiffness matrix. In S2 and S3 it is one sinusoid; the supplement's section 1 gives its impulses, which
suffice.

The unknowns are d1, v2, F1, F2 instead of v1, v2, E1, E2 for two reasons. All four are continuous through every event,
because an end of compression changes stiffnesses only. And where one contact is far stiffer than the other, none of the
four is a small difference of large numbers. The coefficients below are free of cancellation too.

Units: m1 = 1, v0 = -1, k1 = 1 initially (Theorem 5). Hence mu = m2/m1, and velocities are per |v0|.

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

#: 1/n!
T = tuple(1 / factorial(n) for n in range(22))

#: Angle in radians above which the library's functions are called.
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
    # The alternating series to r^21, in Estrin's order, so that few operations wait for one another. As
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
    """Natural modes of the two springs of S1; each pair of numbers is (slow mode, fast mode).

    With w = (v1, v2), the equations of motion are diag(1, mu) w'' = -K w, K = [[k1, -k1], [-k1, k1 + k2]]. Mode j has
    the frequency omega_j and the shape (phi1, phi2) of unit modal mass, phi1^2 + mu phi2^2 = 1.
    """

    k1: float
    k2: float
    omega: tuple[float, float]
    phi1: tuple[float, float]
    phi2: tuple[float, float]
    #: phi2 - phi1 and phi1 + mu phi2. The two rows of the eigenvalue equation give them as -omega^2 phi1/k1 and
    #: k2 phi2/omega^2, which lose no digits where a mode is nearly rigid or nearly massless.
    delta: tuple[float, float]
    sigma: tuple[float, float]
    #: omega phi1 and omega sigma.
    force1: tuple[float, float]
    force2: tuple[float, float]


@force_inlined
def modes_of(mu, k1, k2):
    """Return the modes at mass ratio mu and stiffnesses k1 and k2, which solve the eigenvalue problem of `Modes`."""
    inverse_mu = 1 / mu
    s12 = -k1 * sqrt(inverse_mu)
    difference = k1 - (k1 + k2) * inverse_mu
    spread = sqrt(difference * difference + 4 * s12 * s12)
    fast2 = 0.5 * (k1 + (k1 + k2) * inverse_mu + spread)
    per_fast2, per_k1 = 1 / fast2, 1 / k1
    slow2 = k1 * per_fast2 * (k2 * inverse_mu)  # the product of the eigenvalues is k1 k2/mu
    # The eigenvector of the fast mode is (y, s12) or (s12, -y); its squared length is y spread.
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
    """Compression rates and forces of both contacts at one instant."""

    #: v2 - v1 and v2: the compression rate of the ball-ball contact, and minus the compression rate of the ball-table
    #: contact.
    d1: float
    v2: float
    F1: float
    F2: float


@force_inlined
def amplitudes(d1, v2, u1, u2, modes):
    """Return the pairs a and b of the motion q_j(t) = a_j cos(omega_j t) + b_j sin(omega_j t) from a state on.

    The modal coordinates are q_j = phi1 v1 + mu phi2 v2 and r_j = q_j'/omega_j; at t = 0, q = a and r = b. The state is
    given by the rates d1 and v2 and by the compressions u1 = F1/k1 and u2 = F2/k2 of linear springs.
    """
    phi1, sigma, force1, force2 = modes.phi1, modes.sigma, modes.force1, modes.force2
    return (
        (sigma[0] * v2 - phi1[0] * d1, sigma[1] * v2 - phi1[1] * d1),
        (force2[0] * u2 + force1[0] * u1, force2[1] * u2 + force1[1] * u1),
    )


@force_inlined
def modal_coordinates(t, omega, a, b):
    """Return (q_slow, q_fast) and (r_slow, r_fast) at time t."""
    (cos_slow, sin_slow), (cos_fast, sin_fast) = cos_sin(omega[0] * t), cos_sin(omega[1] * t)
    return rotate(cos_slow, sin_slow, cos_fast, sin_fast, a, b)


@force_inlined
def rotate(cos_slow, sin_slow, cos_fast, sin_fast, q, r):
    """Return q and r after both modes have turned by the angles with these cosines and sines."""
    return (
        (q[0] * cos_slow + r[0] * sin_slow, q[1] * cos_fast + r[1] * sin_fast),
        (r[0] * cos_slow - q[0] * sin_slow, r[1] * cos_fast - q[1] * sin_fast),
    )


@force_inlined
def rotate_briefly(h, omega, q, r):
    """Return q and r a short time h later, by series of sine and cosine, to rounding if abs(omega_j h) <= 0.1."""
    x, y = omega[0] * h, omega[1] * h
    x2, y2 = x * x, y * y
    cos_slow = 1 - x2 * (0.5 - x2 * (1 / 24 - x2 * (1 / 720 - x2 * (1 / 40320))))
    cos_fast = 1 - y2 * (0.5 - y2 * (1 / 24 - y2 * (1 / 720 - y2 * (1 / 40320))))
    sin_slow = x * (1 - x2 * (1 / 6 - x2 * (1 / 120 - x2 * (1 / 5040 - x2 * (1 / 362880)))))
    sin_fast = y * (1 - y2 * (1 / 6 - y2 * (1 / 120 - y2 * (1 / 5040 - y2 * (1 / 362880)))))
    return rotate(cos_slow, sin_slow, cos_fast, sin_fast, q, r)


@force_inlined
def motion_of(q, r, modes):
    """Return the motion with modal coordinates q and r; the inverse of `amplitudes`.

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

    #: True if the inactive contact returns (exit to S1), False if the active contact ended restitution (exit to S4).
    returns: bool
    #: Whether compression ended in the segment, or at the very instant of the return.
    compression_ended: bool
    #: Impulse of the active contact during the segment; its compression rate and strain energy at the end.
    impulse: float
    rate: float
    energy: float


@force_inlined
def follow_single_contact(mass, d, E, e, compressing, impulse_to_return):
    """Follow S2 or S3, in which one contact is active, from entry to exit.

    This is the supplement's section 1, applied to either contact. In its equation (1) M is the mass that the contact
    works against: m1 m2/(m1 + m2) in S3, m2 in S2. d and E are the compression rate and the strain energy at entry. The
    inactive contact returns at the impulse `impulse_to_return`: m2 v2 in S3, m2 (v1 - v2) in S2.
    """
    # The rate at E = 0 that has the same energy as d and E together.
    w = sqrt(d * d + 2 * E / mass)
    if compressing:
        w *= e
    maximum = mass * (d + w)  # Delta I_max of the supplement, in both of its cases
    if not impulse_to_return < maximum:
        return Exit(False, compressing, maximum, -w, 0.0)
    d_exit = d - impulse_to_return / mass
    if compressing and d_exit > 0:
        # The contact is still in compression: equation (2), as a sum of positive terms.
        return Exit(True, False, impulse_to_return, d_exit, E + 0.5 * impulse_to_return * (d + d_exit))
    # The contact is in restitution: equation (4), factored so that a small remaining energy keeps its digits.
    return Exit(
        True, compressing, impulse_to_return, d_exit, 0.5 * (maximum - impulse_to_return) * (w - d_exit)
    )
