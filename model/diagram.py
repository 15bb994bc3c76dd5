"""The state transition diagram: states S1-S4, phases, guards, and the impact law.

    S1  both contacts act        -> S2 when contact 1 ends restitution, S3 when contact 2 does, S4 when both do at once
    S2  ball-table contact only  -> S1 when v1 - v2 turns negative, S4 when contact 2 ends restitution first
    S3  ball-ball contact only   -> S1 when v2 turns negative, S4 when contact 1 ends restitution first
    S4  none                        the end: v1 >= v2 >= 0

The impact law is energetic restitution with stiffening. At an end of compression E_i <- e_i^2 E_i and
k_i <- k_i/e_i^2, so that the force F_i = sqrt(2 k_i E_i) is continuous; a restart of compression keeps the stiffness;
a contact that ends restitution keeps it for its return, which begins in compression with E_i = 0.

Another law differs in repeated compressions only, and is kept beside it for comparison: that of Liu, Zhao and
Brogliato (Proc. R. Soc. A 464:3193, 2008), under which every compression runs at the original stiffness. Their
F = sqrt(2 k E) holds at all times, with dE = V dP in compression and V dP/e^2 in restitution; in the terms used here a
restart of compression takes back what the end of compression did, E_i <- E_i/e_i^2 and k_i <- e_i^2 k_i, and a return
begins at the original k_i.

`collide` is the whole model for one collision in the scaled units of `model.motion` (m1 = 1, v0 = -1, k1 = 1). It is
compiled once and called by `model.solve` and `model.solve_batch` alike.
"""

from __future__ import annotations

from math import inf, isnan, sqrt

from impact_xval.model.collision import Status
from impact_xval.model.compiled import compiled
from impact_xval.model.events import first_event, next_turn
from impact_xval.model.limits import (
    complete_ball_ball,
    complete_ball_table,
    one_body,
    part_of_table,
    runaway,
    static_energy1,
    static_energy2,
)
from impact_xval.model.motion import amplitudes, modes, single_contact

INACTIVE, COMPRESSION, RESTITUTION = 0, 1, 2
S1, S2, S3, S4 = 1, 2, 3, 4

# What ended a stretch, as bits.
RATE1, RATE2, SPENT1, SPENT2, RETURN1, RETURN2 = 1, 2, 4, 8, 16, 32

# What a repeated compression runs at: the stiffness that the ends of compression left (Jia, Mason and Erdmann), or the
# original one (Liu, Zhao and Brogliato).
STIFFENING, ORIGINAL = 0, 1

# How a collision ended.
DONE, LIMIT, PRECISION_LIMIT, TOO_MANY_EVENTS, COLLAPSE, BEYOND_PRECISION = 0, 1, 2, 3, 4, 5

#: Status of an outcome that ended so, by its code.
STATUS_OF: tuple[Status, ...] = ("ok", "limit", "limit", "unconverged", "limit", "unrepresentable")

#: m2/m1 from which on, and below the inverse of which, squares of velocities leave double precision: not solved.
MASS_PRECISION = 1e150

#: Columns of a log row, one row a stretch: the state at its start, then its duration (of S1; those of S2 and S3 follow
#: from their closed forms), what ended it, and whether a closed-form limit governs it.
LOG_COLUMNS = ("state", "phase1", "phase2", "d1", "v2", "E1", "E2", "k1", "k2", "duration", "cause", "limit")
LOG_WIDTH = len(LOG_COLUMNS)

#: Under the law of the original stiffness some collisions repeat one cycle of states for ever, on a fixed share of the
#: energy each time. With this share of the first left, the bodies are taken to be at rest.
COLLAPSED = 1e-30

#: A running stiffness ratio beyond this, or below its inverse, cannot be told from infinity in double precision.
PRECISION_RATIO = 1e30

#: In the place of a cut-off: no ratio, but the closed form as soon as it changes less than `model.limits.BOUND`.
EXACT = 0.0

#: Running ratio from which on that is looked at.
RUNAWAY_RATIO = 1e3


@compiled
def restarted(k, E, e, loss):
    """Stiffness, energy and loss when compression restarts at the original stiffness k; the force is continuous."""
    return k, E / (e * e), loss - (1 / (e * e) - 1) * E


@compiled
def collide(kappa, mu, e1, e2, cutoff, max_events, law, log):
    """Follow one collision through the diagram.

    Parameters
    ----------
    kappa, mu : float
        k2/k1 in [0, inf] and m2/m1.
    e1, e2 : float
        Coefficients of restitution.
    cutoff : float
        The running stiffness ratio is taken for infinite above it and for zero below its inverse; `EXACT` for the
        outcome without a cut-off, sooner.
    max_events : int
        Events after which the collision is given up.
    law : int
        `STIFFENING` or `ORIGINAL`.
    log : ndarray, shape (n, LOG_WIDTH)
        Filled with one row a stretch (`LOG_COLUMNS`) and one for the end, as far as it goes; may have no rows.

    Returns
    -------
    v1, v2 : float
        Final velocities.
    code : int
        `DONE`, `LIMIT`, `PRECISION_LIMIT`, `TOO_MANY_EVENTS` or `COLLAPSE`.
    n_states, n_events, n_stretches : int
        The states count S4.
    margin : float
        Grazing margin: the smallest magnitude of a local extremum of a compression rate in S1, relative to that rate's
        amplitude, where an end of compression counts (`model.events.STAKE`); infinity if there was none.
    loss : float
        Energy lost, so that 1/2 - loss - (v1^2 + mu v2^2)/2 is the residual of the energy balance.
    steps : int
        Windows tried in the searches for first events.
    """
    M = mu / (1 + mu)
    state, phase1, phase2 = S1, COMPRESSION, COMPRESSION
    d1, v2, E1, E2 = 1.0, 0.0, 0.0, 0.0
    k1, k2 = 1.0, kappa
    F1 = F2 = 0.0  # sqrt(2 k E), kept in S1
    rigid1, rigid2, stuck = False, False, False
    code = DONE
    n_states, n_events, n, steps = 1, 0, 0, 0
    margin, loss = inf, 0.0
    exact = cutoff == EXACT
    highest = PRECISION_RATIO if exact else min(cutoff, PRECISION_RATIO)
    modes_k1 = modes_k2 = -1.0
    omega = phi1 = sigma = delta = phi2 = force1 = force2 = (0.0, 0.0)

    while state != S4:
        if n_events > max_events:
            code = TOO_MANY_EVENTS
            break
        if law == ORIGINAL and 2 * (E1 + E2) + (v2 - d1) * (v2 - d1) + mu * v2 * v2 < COLLAPSED:
            d1, v2, state, code, loss = 0.0, 0.0, S4, COLLAPSE, 0.5
            break
        row, before = n, state
        n += 1
        if row < log.shape[0]:
            log[row, 0], log[row, 1], log[row, 2] = state, phase1, phase2
            log[row, 3], log[row, 4], log[row, 5], log[row, 6] = d1, v2, E1, E2
            log[row, 7], log[row, 8] = k1, k2
        duration, cause = 0.0, 0
        if state == S1 and not (rigid1 or rigid2):
            rigid1, rigid2 = k2 < k1 / highest, k1 < k2 / highest
            if rigid1 or rigid2:
                code = LIMIT if highest == cutoff else PRECISION_LIMIT
        if exact and law == STIFFENING and state == S1 and not (rigid1 or rigid2):
            if d1 == 0 and phase1 == RESTITUTION and k1 > RUNAWAY_RATIO * k2:
                gain = runaway(1 + mu, M, 1 / (1 + mu), -v2, F2, k2, F1, k1, e1)
                if not isnan(gain):
                    rigid1, code, loss, E1, E2 = True, LIMIT, loss + E1 - gain, 0.0, E2 + gain
            elif v2 == 0 and phase2 == RESTITUTION and k2 > RUNAWAY_RATIO * k1:
                gain = runaway(1.0, mu, 1.0, d1, F1, k1, F2, k2, e2)
                if not isnan(gain):
                    rigid2, code, loss, E1, E2 = True, LIMIT, loss + E2 - gain, E1 + gain, 0.0
        governed = rigid1 or rigid2

        if state == S1 and rigid1:
            E1 -= static_energy1(mu, E1, E2, k1, k2)
            if d1 * d1 + 2 * E1 / M > 1 / highest:
                if phase1 == COMPRESSION:
                    loss += (1 - e1 * e1) * (E1 + 0.5 * M * d1 * d1)
                d1, v2 = complete_ball_ball(mu, d1, v2, E1, e1, phase1 == COMPRESSION)
                if v2 < 0:
                    if phase2 == RESTITUTION and law == ORIGINAL:
                        k2, E2, loss = restarted(kappa, E2, e2, loss)
                    phase2 = COMPRESSION
                state, phase1, E1, cause = S2, INACTIVE, 0.0, SPENT1
            else:
                if phase2 == COMPRESSION:
                    loss += (1 - e2 * e2) * (E2 + 0.5 * (1 + mu) * v2 * v2)
                v2, d1 = one_body(mu, v2 - d1 / (1 + mu), E2, e2, phase2 == COMPRESSION), 0.0
                state, E1, E2, cause = S4, 0.0, 0.0, SPENT1 | SPENT2

        elif state == S1 and rigid2:
            E2 -= static_energy2(E1, E2, k1, k2)
            if v2 * v2 + 2 * E2 / mu > 1 / highest:
                if phase2 == COMPRESSION:
                    loss += (1 - e2 * e2) * (E2 + 0.5 * mu * v2 * v2)
                d1 -= v2
                v2 = complete_ball_table(mu, v2, E2, e2, phase2 == COMPRESSION)
                d1 += v2
                if d1 > 0:
                    if phase1 == RESTITUTION and law == ORIGINAL:
                        k1, E1, loss = restarted(1.0, E1, e1, loss)
                    phase1 = COMPRESSION
                state, phase2, E2, cause = S3, INACTIVE, 0.0, SPENT2
            else:
                if phase1 == COMPRESSION:
                    loss += (1 - e1 * e1) * (E1 + 0.5 * d1 * d1)
                d1, v2 = -part_of_table(v2 - d1, E1, e1, phase1 == COMPRESSION), 0.0
                state, E1, E2, cause = S4, 0.0, 0.0, SPENT1 | SPENT2

        elif state == S1:
            if k1 != modes_k1 or k2 != modes_k2:
                omega, phi1, sigma, delta, phi2, force1, force2 = modes(mu, k1, k2)
                modes_k1, modes_k2 = k1, k2
            a, b = amplitudes(d1, v2, F1 / k1, F2 / k2, phi1, sigma, force1, force2)
            signs = (1.0 if phase1 == COMPRESSION else -1.0, -1.0 if phase2 == COMPRESSION else 1.0)
            now, shape = (d1, v2, F1, F2), (delta, phi2, force1, force2)
            duration, windows, fired, at_event = 0.0, 1, (False, False, False, False), now
            if exact:
                duration, fired, at_event = next_turn(k1, k2, now, signs, shape, omega, a, b)
            if duration == 0:
                duration, fired, at_event, margin, windows = first_event(
                    mu,
                    k1,
                    k2,
                    now,
                    signs,
                    (phase1 == RESTITUTION, phase2 == RESTITUTION),
                    (1 - e1 * e1, 1 - e2 * e2),
                    shape,
                    omega,
                    a,
                    b,
                    margin,
                )
            d1, v2, F1, F2 = at_event
            steps += windows
            E1, E2 = 0.5 * F1 * F1 / k1, 0.5 * F2 * F2 / k2
            if fired[0]:
                d1, cause, n_events = 0.0, cause | RATE1, n_events + 1
                if phase1 == COMPRESSION:
                    phase1, loss, E1, k1 = (
                        RESTITUTION,
                        loss + (1 - e1 * e1) * E1,
                        e1 * e1 * E1,
                        k1 / (e1 * e1),
                    )
                else:
                    phase1 = COMPRESSION
                    if law == ORIGINAL:
                        k1, E1, loss = restarted(1.0, E1, e1, loss)
            if fired[1]:
                v2, cause, n_events = 0.0, cause | RATE2, n_events + 1
                if phase2 == COMPRESSION:
                    phase2, loss, E2, k2 = (
                        RESTITUTION,
                        loss + (1 - e2 * e2) * E2,
                        e2 * e2 * E2,
                        k2 / (e2 * e2),
                    )
                else:
                    phase2 = COMPRESSION
                    if law == ORIGINAL:
                        k2, E2, loss = restarted(kappa, E2, e2, loss)
            plastic1 = fired[0] and phase1 == RESTITUTION and e1 == 0
            plastic2 = fired[1] and phase2 == RESTITUTION and e2 == 0
            if fired[2] or plastic1:
                phase1, E1, F1, cause, n_events = INACTIVE, 0.0, 0.0, cause | SPENT1, n_events + 1
            if fired[3] or plastic2:
                phase2, E2, F2, cause, n_events = INACTIVE, 0.0, 0.0, cause | SPENT2, n_events + 1
            if plastic1 or plastic2:
                stuck, code = True, LIMIT
                rigid1, rigid2 = plastic1, plastic2 and not plastic1
            if phase1 == INACTIVE:
                state = S2 if phase2 != INACTIVE else S4
            elif phase2 == INACTIVE:
                state = S3

        elif state == S2 and stuck and rigid1:
            if phase2 == COMPRESSION:
                loss += (1 - e2 * e2) * (E2 + 0.5 * (1 + mu) * v2 * v2)
            v2 = one_body(mu, v2, E2, e2, phase2 == COMPRESSION)
            state, E2, cause = S4, 0.0, SPENT2

        elif state == S3 and stuck and rigid2:
            if phase1 == COMPRESSION:
                loss += (1 - e1 * e1) * (E1 + 0.5 * d1 * d1)
            d1 = -part_of_table(-d1, E1, e1, phase1 == COMPRESSION)
            state, E1, cause = S4, 0.0, SPENT1

        elif state == S2:
            compressing = phase2 == COMPRESSION
            returns, ended, _, d2, E = single_contact(mu, -v2, E2, e2, compressing, max(0.0, -mu * d1))
            if ended:
                loss += (1 - e2 * e2) * (E2 + 0.5 * mu * v2 * v2)
                phase2, k2, n_events, cause = RESTITUTION, k2 / (e2 * e2), n_events + 1, RATE2
                code = code if e2 > 0 else LIMIT
            n_events += 1
            if returns:
                v2 -= d1
                d1, E2 = 0.0, E
                state, phase1, cause = S1, COMPRESSION, cause | RETURN1
                k1 = 1.0 if law == ORIGINAL else k1
                F1, F2 = 0.0, sqrt(2 * k2 * E2)
            else:
                d1 -= v2 + d2
                v2, E2 = -d2, 0.0
                state, phase2, cause = S4, INACTIVE, cause | SPENT2

        else:
            compressing = phase1 == COMPRESSION
            returns, ended, impulse, d, E = single_contact(M, d1, E1, e1, compressing, max(0.0, mu * v2))
            if ended:
                loss += (1 - e1 * e1) * (E1 + 0.5 * M * d1 * d1)
                phase1, k1, n_events, cause = RESTITUTION, k1 / (e1 * e1), n_events + 1, RATE1
                code = code if e1 > 0 else LIMIT
            n_events += 1
            d1, E1 = d, E
            if returns:
                v2 = 0.0
                state, phase2, cause = S1, COMPRESSION, cause | RETURN2
                k2 = kappa if law == ORIGINAL else k2
                F1, F2 = sqrt(2 * k1 * E1), 0.0
            else:
                v2 = max(0.0, v2 - impulse / mu)
                state, phase1, cause = S4, INACTIVE, cause | SPENT1

        if row < log.shape[0]:
            log[row, 9], log[row, 10], log[row, 11] = duration, cause, 1.0 if governed else 0.0
        if state != before:
            n_states += 1

    if n < log.shape[0]:
        log[n, 0], log[n, 3], log[n, 4], log[n, 7], log[n, 8] = state, d1, v2, k1, k2
    return v2 - d1, v2, code, n_states, n_events, n, margin, loss, steps
