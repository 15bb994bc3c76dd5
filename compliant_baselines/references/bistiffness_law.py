"""The model's impact law in real time, with positions: what it watches of a contact, and what it applies.

Contact i pushes with F_i = k_i p_i, p_i counted from its present surface:

    OPEN          p <= 0, no force -> COMPRESSION where the gap has closed, p = 0 rising
    COMPRESSION   p rising         -> RESTITUTION at p' = 0: p <- e^2 p, k <- k/e^2, same force
    RESTITUTION   p falling        -> COMPRESSION at p' = 0 (stiffness kept), or OPEN at p = 0

**Where the surface is.** An end of compression moves the point of zero force by (1 - e^2) p into the
contact, and there it stays: the permanent indentation of a loading along k and an unloading along k/e^2. A
contact that ends restitution therefore opens with a gap of exactly zero, and returns when the bodies meet
again where they parted. The alternative, a surface that springs back to where the first touch was, would
leave the two bodies overlapping at the end of restitution, by that same (1 - e^2) p: the next gap would
first have to grow by the overlap before it could close, or else the contact would return at once, in the
midst of separating. It would also give back in position what the law has booked as lost in energy.

**When a contact becomes rigid.** Under the steady push F_s of the other contact, a contact with e < 1
bounces or vibrates without end: each end of compression stiffens it by 1/e^2 and shortens the cycle by e at
an unchanged peak force F, so that infinitely many events fit in a finite time, after which its bodies move
as one (supplement, 3.4). From k_i F_s^2 > cutoff k_j F^2 on they are taken as one. At an end of compression
they have the same velocity, and what the remaining cycles could still do to the slow motion is of the order
of their travel, F/k_i against F_s/k_j.

Units and unknowns as in `references.taylor` and `references.ending`, q2 = p2 - m2 g/k2
with the present k2.
"""

from __future__ import annotations

from math import asin, atan2, pi, sqrt

import numpy as np
from numba import njit

from impact_xval.compliant_baselines.contract.trajectory import FREE, GOING, REST, STUCK
from impact_xval.compliant_baselines.references.contact_law import (
    COMPRESSION,
    GAP,
    HELD,
    N_MODES,
    OPEN,
    RATE,
    RESTITUTION,
    part,
)
from impact_xval.compliant_baselines.references.ending import how_over

WATCHED = np.zeros((N_MODES, 3))
WATCHED[OPEN, GAP] = WATCHED[HELD, RATE] = -1
WATCHED[COMPRESSION, RATE] = 1
WATCHED[RESTITUTION, GAP], WATCHED[RESTITUTION, RATE] = 1, -1

#: Energy, per m1 v0^2/2, that is nothing: velocities of 1e-12 of the first.
STILL = 1e-24


@part
def change(mode, what, k, q, e):
    """Mode, stiffness and compression (p1 or q2) of a contact after an event; e is its restitution."""
    if mode == COMPRESSION:
        return RESTITUTION, k / (e * e), q * (e * e)
    return (OPEN if mode == RESTITUTION and what == GAP else COMPRESSION), k, q


@part
def becomes_rigid(contact, mode1, mode2, mu, p1, d1, q2, v2, k1, k2, cutoff, g):
    """Whether contact 1 or 2, which has just ended compression, has become rigid, and the collision is not over."""
    on1, on2 = mode1 != OPEN, mode2 != OPEN
    F1, F2 = k1 * p1, k2 * q2 + mu * g
    if contact == 1:
        push = F2 / (1 + mu) if on2 else 0.0
        rigid = k1 * push * push > cutoff * k2 * F1 * F1
    else:
        push = (F1 if on1 else 0.0) + mu * g
        rigid = k2 * push * push > cutoff * k1 * F2 * F2
    return rigid and how_over(on1, on2, mu, p1, d1, q2, v2, k1, k2, g) == GOING


@njit(cache=True, error_model="numpy")
def last_bounce(m, v, F, k, e, compressing, g):
    """Finish one body on one spring: velocity with which it leaves, and when; 0 if its weight holds it.

    The motion is harmonic about F = W = m g; an end of compression at the peak of F keeps the amplitude A
    of the force.

    Parameters
    ----------
    m, v, F : float
        Mass, velocity (up positive), force of the contact.
    k, e : float
        Stiffness of the contact at present, coefficient of restitution.
    compressing : bool
        Whether an end of compression is still to come.
    g : float
        Gravity.
    """
    W = m * g
    A = sqrt(m * k * v * v + (F - W) * (F - W))
    if A <= W or A == 0:
        return 0.0, 0.0
    phase, time = atan2(F - W, -v * sqrt(m * k)), 0.0
    if compressing:
        time = (0.5 * pi - phase) * sqrt(m / k)
        phase, k = 0.5 * pi, k / (e * e)
    time += (pi + asin(W / A) - phase) * sqrt(m / k)
    return sqrt((A - W) * (A + W) / (m * k)), time


@njit(cache=True, error_model="numpy")
def as_one(rigid, mu, p1, d1, q2, v2, k1, k2, e1, e2, mode1, mode2, g):
    """Finish a collision of which contact `rigid` has become rigid.

    Returns
    -------
    d1, v2, time : float
        Rate and velocity at the end, and how long it took.
    end : int
        `FREE`, `REST` or `STUCK`.
    """
    if rigid == 1:
        v, time = last_bounce(1 + mu, v2, k2 * q2 + mu * g, k2, e2, mode2 == COMPRESSION, g)
        return 0.0, v, time, FREE if v > 0 or g == 0 else STUCK
    v1, wait, F1, compressing = v2 - d1, 0.0, k1 * p1, mode1 == COMPRESSION
    if mode1 == OPEN:
        # B1 still has to land on a B2 that rests (only with gravity).
        down = -sqrt(v1 * v1 - 2 * g * p1)
        wait, v1, F1, compressing = (v1 - down) / g, down, 0.0, True
    v, time = last_bounce(1.0, v1, F1, k1, e1, compressing, g)
    return -v, 0.0, wait + time, FREE if g == 0 else REST if v > 0 else STUCK


@njit(cache=True, error_model="numpy")
def stands_still(mu, p1, d1, p2, v2, k1, k2, g):
    """Whether the energy left, above that of both balls at rest on rigid contacts, is lost in rounding.

    Both contacts can bounce themselves rigid together: under the weight of both balls, or, B2 hammered between
    B1 and the table, without it.
    """
    v1, gap1, gap2 = v2 - d1, max(0.0, -p1), max(0.0, -p2)
    springs = k1 * max(0.0, p1) ** 2 + k2 * max(0.0, p2) ** 2
    return v1 * v1 + mu * v2 * v2 + springs + 2 * g * (gap1 + (1 + mu) * gap2) < STILL
