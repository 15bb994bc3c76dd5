"""One collision of the column under the model's impact law in real time, event by event.

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

**Frozen positions.** With `frozen` an OPEN contact does not move: it keeps p = 0 and returns at p' = 0, where its
bodies begin to approach, whatever gap or rest of a penetration they have by then. Without gravity that is the
state-transition model, in time.

**When a contact becomes rigid.** Under the steady push F_s of the other contact, a contact with e < 1
bounces or vibrates without end: each end of compression stiffens it by 1/e^2 and shortens the cycle by e at
an unchanged peak force F, so that infinitely many events fit in a finite time, after which its bodies move
as one (supplement, 3.4). From k_i F_s^2 > cutoff k_j F^2 on they are taken as one. At an end of compression
they have the same velocity, and what the remaining cycles could still do to the slow motion is of the order
of their travel, F/k_i against F_s/k_j.

Units and unknowns as in `references.taylor` and `references.piecewise`, q2 = p2 - m2 g/k2
with the present k2.
"""

from __future__ import annotations

from math import asin, atan2, pi, sqrt

import numpy as np
from numba import njit

from impact_xval.compliant_baselines.contract.trajectory import (
    FREE,
    GOING,
    REST,
    STUCK,
)
from impact_xval.compliant_baselines.references.first_root import first_root
from impact_xval.compliant_baselines.references.piecewise import (
    END_OF_COMPRESSION,
    END_OF_RESTITUTION,
    LIMIT,
    OPEN,
    RESTART_OF_COMPRESSION,
    RETURN,
    TOO_LONG,
    flight_time,
    how_over,
    state_of,
    write_row,
)
from impact_xval.compliant_baselines.references.taylor import (
    D1,
    ORDER,
    P1,
    Q2,
    V2,
    evaluate,
    expand,
    longest_step,
)

COMPRESSION, RESTITUTION = 1, 2

#: Energy, per m1 v0^2/2, that is nothing: velocities of 1e-12 of the first.
STILL = 1e-24


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
def as_one(rigid, mu, p1, d1, q2, v2, k1, k2, e1, e2, phase1, phase2, g):
    """Finish a collision of which contact `rigid` has become rigid.

    Returns
    -------
    d1, v2, time : float
        Rate and velocity at the end, and how long it took.
    end : int
        `FREE`, `REST` or `STUCK`.
    """
    if rigid == 1:
        v, time = last_bounce(1 + mu, v2, k2 * q2 + mu * g, k2, e2, phase2 == COMPRESSION, g)
        return 0.0, v, time, FREE if v > 0 or g == 0 else STUCK
    v1, wait, F1, compressing = v2 - d1, 0.0, k1 * p1, phase1 == COMPRESSION
    if phase1 == OPEN:
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


@njit(cache=True, error_model="numpy")
def collide(kappa, mu, e1, e2, g, cutoff, frozen, max_steps, log):
    """Follow one collision to its end.

    Parameters
    ----------
    kappa, mu : float
        k2/k1 and m2/m1, positive and finite.
    e1, e2 : float
        Coefficients of restitution, greater than 0.
    g : float
        Gravity; 0 is the scenario `impact`, anything else `drop`.
    cutoff : float
        Where a contact is taken for rigid, see the module.
    frozen : bool
        Whether an open contact returns as soon as its bodies approach.
    max_steps : int
        Stretches after which the collision is given up.
    log : ndarray, shape (n, LOG_WIDTH)
        Filled with one row a stretch (`piecewise.LOG_COLUMNS`) and one for the end, as far as it goes.

    Returns
    -------
    v1, v2 : float
        Velocities at the end.
    end : int
        `FREE`, `REST`, `STUCK` or `TOO_LONG`.
    sequence, n_states : int
        States two bits each, the last one lowest (S1 is 0), and how many; the sequence holds the last 32.
    n_events, n_steps : int
        Events and stretches.
    time, fall : float
        Duration, and for how long of it gravity acted (`piecewise`).
    limited : bool
        Whether a contact became rigid.
    """
    table = np.empty((4, ORDER + 1))
    k1, k2 = 1.0, kappa
    p1, d1, q2, v2 = 0.0, 1.0, 0.0, 0.0
    phase1, phase2 = COMPRESSION, COMPRESSION
    time, fall, limited = 0.0, np.inf, False
    state, sequence, n_states, n_events, n = 1, np.uint64(0), 1, 0, 0
    end, rigid = GOING, 0
    while True:
        now = state_of(phase1 != OPEN, phase2 != OPEN)
        if now != state:
            state, sequence, n_states = now, (sequence << np.uint64(2)) | np.uint64(now - 1), n_states + 1
        if rigid == 0 and end == GOING:
            end = how_over(phase1 != OPEN, phase2 != OPEN, mu, p1, d1, q2, v2, k1, k2, g)
        if end == GOING and n >= max_steps:
            end = TOO_LONG
        if end != GOING:
            break
        if g > 0 and phase1 == OPEN and phase2 == OPEN:
            q2, g, fall = q2 + mu * g / k2, 0.0, time  # in flight: from here on the bodies no longer fall

        r2 = mu * g / k2
        a1, a2 = (k1 if phase1 != OPEN else 0.0), (k2 if phase2 != OPEN else 0.0)
        h, degree = longest_step(mu, a1, a2, 0.0, 0.0), ORDER
        if phase1 == OPEN and phase2 == OPEN:
            h, degree = flight_time(p1, d1, q2 + r2, v2, g), 2
        table[P1, 0], table[D1, 0], table[Q2, 0], table[V2, 0] = p1, d1, q2, v2
        carried = g if phase2 != OPEN else 0.0  # a loaded contact 2 carries m2 g at q2 = 0
        expand(table, degree, h, mu, a1, a2, 0.0, 0.0, carried, carried - g)

        # Watched, each positive until its event: the penetration of a contact in restitution, the gap of an
        # open one, or, frozen, its negative rate; the rate of one in compression, its negative in restitution.
        x, fired = 1.0, -1
        for i in range(5):
            row, phase = (P1, phase1) if i < 2 else (Q2, phase2)
            if i == 0 or i == 2:
                if phase == COMPRESSION or (frozen and phase == OPEN):
                    continue
                sign = 1.0 if phase == RESTITUTION else -1.0
            elif i == 4:
                # B2 at rest counts once B1 no longer approaches: a border of stretches too.
                if frozen or not (g > 0 and phase1 == OPEN and phase2 != OPEN):
                    continue
                row, sign = D1, (1.0 if d1 > 0 or (d1 == 0 and table[D1, 1] > 0) else -1.0)
            else:
                if phase == OPEN and not frozen:
                    continue
                row = D1 if i == 1 else V2
                sign = (1.0 if phase == COMPRESSION else -1.0) * (1.0 if i == 1 else -1.0)
            start = sign * (q2 + r2) if i == 2 else sign * table[row, 0]
            root = first_root(table, row, sign, start, degree, x)
            if root <= x:
                x, fired = root, i

        if x < 0:
            end = TOO_LONG  # numbers beyond what can be certified
            break
        write_row(log, n, time, (p1, d1, q2, v2), x * h, k1, k2, phase1, phase2, g)
        p1, d1, q2, v2 = evaluate(table, degree, x)
        time += x * h
        event = 0
        if frozen and phase1 == OPEN:
            p1, d1 = 0.0, min(d1, 0.0)
        if frozen and phase2 == OPEN:
            q2, v2 = -r2, max(v2, 0.0)
        if fired == 0:
            p1 = 0.0
            phase1, event = (COMPRESSION, RETURN) if phase1 == OPEN else (OPEN, END_OF_RESTITUTION)
        elif fired == 1:
            d1 = 0.0
            if phase1 == COMPRESSION:
                phase1, event = RESTITUTION, END_OF_COMPRESSION
                k1, p1 = k1 / (e1 * e1), p1 * (e1 * e1)
                push, F = (k2 * q2 + mu * g) / (1 + mu) if phase2 != OPEN else 0.0, k1 * p1
                rigid = 1 if k1 * push * push > cutoff * k2 * F * F else 0
            else:
                event = RETURN if phase1 == OPEN else RESTART_OF_COMPRESSION
                phase1 = COMPRESSION
        elif fired == 2:
            q2 = -r2
            phase2, event = (COMPRESSION, RETURN) if phase2 == OPEN else (OPEN, END_OF_RESTITUTION)
        elif fired == 3:
            v2 = 0.0
            if phase2 == COMPRESSION:
                phase2, event = RESTITUTION, END_OF_COMPRESSION
                k2, q2 = k2 / (e2 * e2), q2 * (e2 * e2)
                push, F = (k1 * p1 if phase1 != OPEN else 0.0) + mu * g, k2 * q2 + mu * g
                rigid = 2 if k2 * push * push > cutoff * k1 * F * F else 0
            else:
                event = RETURN if phase2 == OPEN else RESTART_OF_COMPRESSION
                phase2 = COMPRESSION
        elif fired == 4:
            d1 = 0.0
        if n < log.shape[0] and event > 0:
            log[n, 10] = event * 10 + (1 if fired < 2 else 2)
        n_events += 1 if event > 0 else 0
        n += 1
        if rigid > 0 and how_over(phase1 != OPEN, phase2 != OPEN, mu, p1, d1, q2, v2, k1, k2, g) == GOING:
            entry = p1, d1, q2, v2
            d1, v2, wait, end = as_one(rigid, mu, p1, d1, q2, v2, k1, k2, e1, e2, phase1, phase2, g)
            write_row(log, n, time, entry, wait, k1, k2, phase1, phase2, g)
            if n < log.shape[0]:
                log[n, 10] = LIMIT * 10
            time, limited, phase1, phase2, p1, q2, n = time + wait, True, OPEN, OPEN, 0.0, -mu * g / k2, n + 1
        else:
            rigid = 0
        hard = k1 > cutoff and k2 > cutoff * kappa
        if hard and stands_still(mu, p1, d1, q2 + mu * g / k2, v2, k1, k2, g):
            d1, v2, limited = 0.0, 0.0, True
            end = STUCK if g > 0 else FREE

    write_row(log, n, time, (p1, d1, q2, v2), 0.0, k1, k2, phase1, phase2, g)
    if state != 4:
        sequence, n_states = (sequence << np.uint64(2)) | np.uint64(3), n_states + 1
    return v2 - d1, v2, end, sequence, n_states, n_events, n, time, min(fall, time), limited
