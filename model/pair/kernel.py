"""The state transition diagram: which contacts act, what ends that, and what comes next.

    S1  both contacts act        -> S2 when contact 1 ends restitution, S3 when contact 2 does, S4 when both do at once
    S2  ball-table contact only  -> S1 when v1 - v2 turns negative, S4 when contact 2 ends restitution first
    S3  ball-ball contact only   -> S1 when v2 turns negative, S4 when contact 1 ends restitution first
    S4  none                        the end: v1 >= v2 >= 0

`collide` is the whole model for one collision in the scaled units of `pair.motion` (m1 = 1, v0 = -1, k1 = 1): segment
by segment, each ended by one or more events. What an event does to its contact is in `pair.law`, the motion in
between in `pair.motion`, which event ends a segment of S1 in `pair.events`. Contact 1 is ball-ball, contact 2
ball-table.
"""

from __future__ import annotations

from math import inf, isnan, sqrt

from impact_xval.model.collision import Status
from impact_xval.model.compiled import compiled, inlined
from impact_xval.model.pair.events import MOST_WINDOWS, first_event, next_turn
from impact_xval.model.pair.law import (
    COMPRESSION,
    INACTIVE,
    RESTITUTION,
    Contact,
    after_event,
    end_of_compression,
    restart,
    returned,
    spent,
    with_energy,
    with_force,
)
from impact_xval.model.pair.limits import (
    complete_ball_ball,
    complete_ball_table,
    one_body,
    part_of_table,
    runaway,
    static_energy1,
    static_energy2,
)
from impact_xval.model.pair.motion import Modes, amplitudes, modes_of, single_contact

S1, S2, S3, S4 = 1, 2, 3, 4

# What ended a segment, as bits: the rate of a contact was zero, its restitution ended, it returned.
RATE1, RATE2, SPENT1, SPENT2, RETURN1, RETURN2 = 1, 2, 4, 8, 16, 32

# How a collision ended.
DONE, LIMIT, PRECISION_LIMIT, TOO_MANY_EVENTS, COLLAPSE, BEYOND_PRECISION = 0, 1, 2, 3, 4, 5

#: Status of an outcome that ended so, by its code.
STATUS_OF: tuple[Status, ...] = ("ok", "limit", "limit", "unconverged", "limit", "unrepresentable")

#: Columns of a log row, one row a segment: the state at its start, then its duration (of S1; those of S2 and S3 follow
#: from their closed forms), what ended it, and whether a closed-form limit governs it.
LOG_COLUMNS = ("state", "phase1", "phase2", "d1", "v2", "E1", "E2", "k1", "k2", "duration", "cause", "limit")
LOG_WIDTH = len(LOG_COLUMNS)

#: Under a law that does not stiffen some collisions repeat one cycle of states for ever, on a fixed share of the
#: energy each time. With this share of the first left, the bodies are taken to be at rest.
COLLAPSED = 1e-30

#: A running stiffness ratio beyond this, or below its inverse, cannot be told from infinity in double precision.
PRECISION_RATIO = 1e30

#: In the place of a cut-off: no ratio, but the closed form as soon as it changes less than `pair.limits.BOUND`.
EXACT = 0.0

#: Running ratio from which on that is looked at.
RUNAWAY_RATIO = 1e3


@inlined
def both_contacts(mu, modes, d1, v2, one, two, law, exact, loss, margin):
    """Follow S1 to its first event, and apply the impact law there."""
    a, b = amplitudes(d1, v2, one.F / one.k, two.F / two.k, modes)
    signs = (1.0 if one.phase == COMPRESSION else -1.0, -1.0 if two.phase == COMPRESSION else 1.0)
    now = (d1, v2, one.F, two.F)
    duration, windows, fired, at_event = 0.0, 1, (False, False, False, False), now
    if exact:
        duration, fired, at_event = next_turn(modes, now, signs, a, b)
    if duration == 0:
        watched = (one.phase == RESTITUTION, two.phase == RESTITUTION)
        losses = (1 - one.e * one.e, 1 - two.e * two.e)
        duration, fired, at_event, margin, windows = first_event(
            mu, modes, now, signs, watched, losses, a, b, margin
        )
    d1, v2, F1, F2 = at_event
    rate1, rate2, force1, force2 = fired
    one, two = with_force(one, F1), with_force(two, F2)
    one, loss = after_event(law, one, rate1, force1, loss)
    two, loss = after_event(law, two, rate2, force2, loss)
    cause = (
        RATE1 * rate1 | RATE2 * rate2 | SPENT1 * (one.phase == INACTIVE) | SPENT2 * (two.phase == INACTIVE)
    )
    d1, v2 = (0.0 if rate1 else d1), (0.0 if rate2 else v2)
    return d1, v2, one, two, cause, loss, duration, margin, windows


@inlined
def ball_on_table(mu, d1, v2, one, two, law, loss):
    """Follow S2 to its end."""
    returns, ended, _, d2, two, loss = alone(two, mu, -v2, max(0.0, -mu * d1), loss)
    cause = RATE2 * ended | (RETURN1 if returns else SPENT2)
    if returns:
        return 0.0, v2 - d1, returned(law, one), two, cause, loss
    return d1 - (v2 + d2), -d2, one, two, cause, loss


@inlined
def ball_on_ball(mu, M, d1, v2, one, two, law, loss):
    """Follow S3 to its end."""
    returns, ended, impulse, d1, one, loss = alone(one, M, d1, max(0.0, mu * v2), loss)
    cause = RATE1 * ended | (RETURN2 if returns else SPENT1)
    if returns:
        return d1, 0.0, one, returned(law, two), cause, loss
    return d1, max(0.0, v2 - impulse / mu), one, two, cause, loss


@inlined
def alone(c, mass, rate, impulse_to_return, loss):
    """Follow the one contact that acts, against one mass, until it is spent or the other one returns.

    Returns
    -------
    returns, ended : bool
        Whether the other contact returned, and whether compression ended on the way.
    impulse, rate : float
        Accumulated on the way, and at the end.
    c, loss
        The contact, and the energy lost, at the end.
    """
    returns, ended, impulse, rate_after, E = single_contact(
        mass, rate, c.E, c.e, c.phase == COMPRESSION, impulse_to_return
    )
    if ended:
        c, loss = end_of_compression(with_energy(c, c.E + 0.5 * mass * rate * rate), loss)
    c = Contact(c.phase, c.k, E, sqrt(2 * c.k * E), c.e, c.original) if returns else spent(c)
    return returns, ended, impulse, rate_after, c, loss


@inlined
def taken_for_rigid(mu, M, d1, v2, one, two, law, highest, cutoff, loss):
    """Tell which contact is rigid from here on in S1, 0 if none is; how that ends; both contacts, and the loss."""
    rigid1, rigid2 = two.k < one.k / highest, one.k < two.k / highest
    if rigid1 or rigid2:
        return (1 if rigid1 else 2), (LIMIT if highest == cutoff else PRECISION_LIMIT), one, two, loss
    if cutoff == EXACT and law.stiffens:
        if d1 == 0 and one.phase == RESTITUTION and one.k > RUNAWAY_RATIO * two.k:
            gain = runaway(1 + mu, M, 1 / (1 + mu), -v2, two.F, two.k, one.F, one.k, one.e)
            if not isnan(gain):
                return 1, LIMIT, with_energy(one, 0.0), with_energy(two, two.E + gain), loss + one.E - gain
        elif v2 == 0 and two.phase == RESTITUTION and two.k > RUNAWAY_RATIO * one.k:
            gain = runaway(1.0, mu, 1.0, d1, one.F, one.k, two.F, two.k, two.e)
            if not isnan(gain):
                return 2, LIMIT, with_energy(one, one.E + gain), with_energy(two, 0.0), loss + two.E - gain
    return 0, DONE, one, two, loss


@inlined
def rigid_contact(mu, M, first, d1, v2, one, two, law, highest, loss):
    """Take the first contact, or the second, for rigid: it completes its impact, or its bodies go on as one to the end.

    The former where it holds energy that can part them (`pair.limits`).
    """
    stiff, soft = (one, two) if first else (two, one)
    mass, rate = (M, d1) if first else (mu, -v2)
    static = (
        static_energy1(mu, one.E, two.E, one.k, two.k)
        if first
        else static_energy2(one.E, two.E, one.k, two.k)
    )
    stiff = with_energy(stiff, stiff.E - static)
    if rate * rate + 2 * stiff.E / mass > 1 / highest:
        compressing = stiff.phase == COMPRESSION
        loss = loss_ahead(stiff, mass, rate, loss)
        if first:
            d1, v2 = complete_ball_ball(mu, d1, v2, stiff.E, stiff.e, compressing)
        else:
            d1, v2 = complete_ball_table(mu, d1, v2, stiff.E, stiff.e, compressing)
        if soft.phase == RESTITUTION and (-v2 if first else d1) > 0:
            soft, loss = restart(law, soft, loss)
        cause = SPENT1 if first else SPENT2
    else:
        cause = SPENT1 * (one.phase != INACTIVE) | SPENT2 * (two.phase != INACTIVE)
        compressing = soft.phase == COMPRESSION
        if first:
            loss = loss_ahead(soft, 1 + mu, v2, loss)
            d1, v2 = one_body(mu, d1, v2, soft.E, soft.e, compressing)
        else:
            loss = loss_ahead(soft, 1.0, d1, loss)
            d1, v2 = part_of_table(d1, v2, soft.E, soft.e, compressing)
        soft = spent(soft)
    stiff = spent(stiff)
    one, two = (stiff, soft) if first else (soft, stiff)
    return d1, v2, one, two, cause, loss


@inlined
def loss_ahead(c, mass, rate, loss):
    """Add to the loss what a contact will lose that works against one mass from here on."""
    if c.phase == COMPRESSION:
        _, loss = end_of_compression(with_energy(c, c.E + 0.5 * mass * rate * rate), loss)
    return loss


@inlined
def state_of(one, two):
    """Return the state in which contacts are: it says which of them act."""
    return S1 + (one.phase == INACTIVE) + 2 * (two.phase == INACTIVE)


@inlined
def number_of_events(cause):
    """Count the bits of what ended a segment."""
    n = 0
    for i in range(6):
        n += (cause >> i) & 1
    return n


@inlined
def write_start(log, n, state, d1, v2, one, two):
    """Write the columns of the log that are known as a segment begins."""
    log[n, 0], log[n, 1], log[n, 2] = state, one.phase, two.phase
    log[n, 3], log[n, 4], log[n, 5], log[n, 6] = d1, v2, one.E, two.E
    log[n, 7], log[n, 8] = one.k, two.k


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
    law : ImpactLaw
    log : ndarray, shape (n, LOG_WIDTH)
        Filled with one row a segment (`LOG_COLUMNS`) and one for the end, as far as it goes; may have no rows.

    Returns
    -------
    v1, v2 : float
        Final velocities.
    code : int
        `DONE`, `LIMIT`, `PRECISION_LIMIT`, `TOO_MANY_EVENTS` or `COLLAPSE`.
    n_states, n_events, n_segments : int
        The states count S4.
    margin : float
        Grazing margin: the smallest magnitude of a local extremum of a compression rate in S1, relative to that rate's
        amplitude, where an end of compression counts (`pair.grazing.STAKE`); infinity if there was none.
    loss : float
        Energy lost, so that 1/2 - loss - (v1^2 + mu v2^2)/2 is the residual of the energy balance.
    steps : int
        Windows tried in the searches for first events.
    """
    state, d1, v2 = S1, 1.0, 0.0
    one = Contact(COMPRESSION, 1.0, 0.0, 0.0, e1, 1.0)
    two = Contact(COMPRESSION, kappa, 0.0, 0.0, e2, kappa)
    rigid, united = 0, False  # the contact taken for rigid, and whether its bodies are one for good
    code = DONE
    n_states, n_events, n, steps = 1, 0, 0, 0
    margin, loss = inf, 0.0
    M = mu / (1 + mu)
    exact = cutoff == EXACT
    highest = PRECISION_RATIO if exact else min(cutoff, PRECISION_RATIO)
    # Apart: carried along as one tuple, the compiler fuses other products and sums, and last bits of outcomes change.
    modes_k1 = modes_k2 = -1.0
    omega = phi1 = phi2 = delta = sigma = force1 = force2 = (0.0, 0.0)

    while state != S4:
        if n_events > max_events or steps >= MOST_WINDOWS:
            code = TOO_MANY_EVENTS
            break
        if not law.stiffens and 2 * (one.E + two.E) + (v2 - d1) * (v2 - d1) + mu * v2 * v2 < COLLAPSED:
            d1, v2, state, code, loss = 0.0, 0.0, S4, COLLAPSE, 0.5
            break
        if n < log.shape[0]:
            write_start(log, n, state, d1, v2, one, two)
        if state == S1 and rigid == 0:
            rigid, code, one, two, loss = taken_for_rigid(mu, M, d1, v2, one, two, law, highest, cutoff, loss)
        governed, duration = rigid != 0, 0.0
        if rigid == 1 and (state == S1 or united):
            d1, v2, one, two, cause, loss = rigid_contact(mu, M, True, d1, v2, one, two, law, highest, loss)
        elif rigid == 2 and (state == S1 or united):
            d1, v2, one, two, cause, loss = rigid_contact(mu, M, False, d1, v2, one, two, law, highest, loss)
        else:
            if state == S1:
                if one.k != modes_k1 or two.k != modes_k2:
                    modes_k1, modes_k2, omega, phi1, phi2, delta, sigma, force1, force2 = modes_of(
                        mu, one.k, two.k
                    )
                modes = Modes(modes_k1, modes_k2, omega, phi1, phi2, delta, sigma, force1, force2)
                d1, v2, one, two, cause, loss, duration, margin, windows = both_contacts(
                    mu, modes, d1, v2, one, two, law, exact, loss, margin
                )
                steps += windows
            elif state == S2:
                d1, v2, one, two, cause, loss = ball_on_table(mu, d1, v2, one, two, law, loss)
            else:
                d1, v2, one, two, cause, loss = ball_on_ball(mu, M, d1, v2, one, two, law, loss)
            n_events += number_of_events(cause)
            plastic1, plastic2 = e1 == 0 and cause & RATE1 != 0, e2 == 0 and cause & RATE2 != 0
            if plastic1 or plastic2:
                rigid, united, code = (1 if plastic1 else 2), True, LIMIT
        if n < log.shape[0]:
            log[n, 9], log[n, 10], log[n, 11] = duration, cause, 1.0 if governed else 0.0
        n += 1
        before, state = state, state_of(one, two)
        if state != before:
            n_states += 1

    if n < log.shape[0]:
        log[n, 0], log[n, 3], log[n, 4], log[n, 7], log[n, 8] = state, d1, v2, one.k, two.k
    return v2 - d1, v2, code, n_states, n_events, n, margin, loss, steps
