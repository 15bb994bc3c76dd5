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

from math import atan2, inf, isnan, nan, pi, sqrt

import numpy as np

from impact_xval.model.compiled import compiled_with, inlined
from impact_xval.model.inputs import MASS_PRECISION
from impact_xval.model.pair import law
from impact_xval.model.pair.events import MOST_WINDOWS, first_event, next_turn
from impact_xval.model.pair.law import COMPRESSION, INACTIVE, RESTITUTION, Contact
from impact_xval.model.pair.limits import runaway
from impact_xval.model.pair.motion import amplitudes, modes_of, single_contact
from impact_xval.model.pair.path import write, write_both, write_one

S1, S2, S3, S4 = 1, 2, 3, 4

#: What `collide_all` says of a collision: how it ended, by the codes below; numbers of its states, of its events and of
#: rows of its path; its grazing margin (`pair.grazing`), and the residual of its energy balance: 1/2 less what was lost
#: and what is left.
RESULT = np.dtype(
    [
        ("code", "i8"),
        ("n_states", "i8"),
        ("n_events", "i8"),
        ("rows", "i8"),
        ("margin", "f8"),
        ("residual", "f8"),
    ]
)

# How a collision ended.
DONE, LIMIT, PRECISION_LIMIT, TOO_MANY_EVENTS, COLLAPSE, BEYOND_PRECISION = 0, 1, 2, 3, 4, 5

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
def both_contacts(mu, modes, a, b, d1, v2, one, two, stiffens, exact, loss, margin):
    """Follow S1 to its first event, and apply the impact law there."""
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
    d1, v2 = (0.0 if rate1 else d1), (0.0 if rate2 else v2)
    one, loss = law.after_event(stiffens, one, F1, rate1, force1, loss)
    two, loss = law.after_event(stiffens, two, F2, rate2, force2, loss)
    return d1, v2, one, two, rate1, rate2, loss, duration, margin, windows


@inlined
def seen_from(mu, M, first, d1, v2, one, two):
    """Name what is there as seen from a stiff contact, the first one or the second.

    Gives the stiff contact and the soft one; the mass that the stiff one works against, and its compression rate; the
    mass that the soft one works against if the stiff one's bodies are one, and its compression rate; and the share of
    the soft one's force that the stiff one passes on.
    """
    if first:
        return one, two, M, d1, 1 + mu, -v2, 1 / (1 + mu)
    return two, one, mu, -v2, 1.0, d1, 1.0


@inlined
def taken_for_rigid(mu, M, d1, v2, one, two, stiffens, highest, cutoff, loss):
    """Tell which contact is rigid from here on in S1, 0 if none is; how that ends; both contacts, and the loss."""
    first = one.k > two.k
    stiff, soft, mass, rate, united, soft_rate, share = seen_from(mu, M, first, d1, v2, one, two)
    if soft.k < stiff.k / highest:
        return (1 if first else 2), (LIMIT if highest == cutoff else PRECISION_LIMIT), one, two, loss
    if cutoff != EXACT or not stiffens or rate != 0 or stiff.phase != RESTITUTION:
        return 0, DONE, one, two, loss
    gain = nan
    if stiff.k > RUNAWAY_RATIO * soft.k:
        gain = runaway(united, mass, share, soft_rate, soft.F, soft.k, stiff.F, stiff.k, stiff.e)
    if isnan(gain):
        return 0, DONE, one, two, loss
    loss += stiff.E - gain
    stiff, soft = law.with_energy(stiff, 0.0), law.with_energy(soft, soft.E + gain)
    return (1 if first else 2), LIMIT, (stiff if first else soft), (soft if first else stiff), loss


@inlined
def at_work(mu, M, state, d1, v2, one, two, rigid, highest):
    """Tell which contact works alone, against what, in S2, in S3, or where a contact is rigid (1 or 2; 0: none).

    A rigid contact completes its impact where it holds energy that can part its bodies; else these are one, and the
    other contact works against them to the end (`pair.limits`).

    Gives whether it is the ball-ball contact that works, and whether the bodies of the other one are one; the contact
    that works, the mass it works against, and its compression rate; and the impulse at which the other one returns.
    """
    if rigid == 0:
        if state == S3:
            return True, False, one, M, d1, max(0.0, mu * v2)
        return False, False, two, mu, -v2, max(0.0, -mu * d1)
    first = rigid == 1
    stiff, soft, mass, rate, united, soft_rate, share = seen_from(mu, M, first, d1, v2, one, two)
    # Of its energy, F F_s/k is held by merely passing on the force F_s.
    E = stiff.E - 2 * sqrt(one.E * two.E * (soft.k / stiff.k)) * share
    if rate * rate + 2 * E / mass > 1 / highest:
        return first, False, law.with_energy(stiff, E), mass, rate, inf
    return not first, True, soft, united, soft_rate + rate * share, inf


@inlined
def after_one_contact(mu, state, d1, v2, one, two, stiffens, rigid, first, united, c, mass, rate, exit, loss):
    """Apply what a contact did that worked alone: d1, v2, both contacts, and the loss, after it."""
    returns, ended, impulse, after, E = exit
    other = two if first else one
    if ended:
        c, loss = law.end_of_compression(law.with_energy(c, c.E + 0.5 * mass * rate * rate), loss)
    c = Contact(c.phase, c.k, E, sqrt(2 * c.k * E), c.e, c.original) if returns else law.spent(c)
    if first:
        d1, v2 = after, (0.0 if returns or united else v2 - impulse / mu)
        v2 = max(0.0, v2) if state == S3 else v2
    else:
        d1, v2 = (0.0 if returns or united else d1 - (v2 + after)), (v2 - d1 if returns else -after)
    if returns:
        other = law.returned(stiffens, other)
    elif united:
        other = law.spent(other)
    elif rigid != 0 and other.phase == RESTITUTION and (-v2 if first else d1) > 0:
        other, loss = law.restart(stiffens, other, loss)
    return d1, v2, (c if first else other), (other if first else c), loss


@compiled_with(inline="always")
def collide(kappa, mu, e1, e2, cutoff, max_events, stiffens, points, log, at, place, sets):
    """Follow one collision through the diagram as `collide_all` says, and as a part of that.

    Its first row is `at` in the log, `place` in `sets`. Gives v1, v2, code, numbers of states, of events and of rows,
    the grazing margin, and the energy lost.
    """
    # Whole numbers that are literals are of types of their own, for which functions would be compiled once more.
    state, phase, rows = np.int64(S1), np.int64(COMPRESSION), at
    before, d1, v2 = 0, 1.0, 0.0
    one, two = Contact(phase, 1.0, 0.0, 0.0, e1, 1.0), Contact(phase, kappa, 0.0, 0.0, e2, kappa)  # pyright: ignore
    rigid, plastic = 0, False  # the contact taken for rigid, and whether its bodies are one for good
    code, states, events, windows = DONE, 0, 0, 0
    margin, loss, time = inf, 0.0, 0.0
    M = mu / (1 + mu)
    exact = cutoff == EXACT
    highest = PRECISION_RATIO if exact else min(cutoff, PRECISION_RATIO)
    recorded = log.shape[0] > 0
    modes = modes_of(mu, one.k, two.k)
    while True:
        if state != before:
            if place + states < sets.shape[0]:
                sets[place + states, 0] = S4 - state
            before, states = state, states + 1
        if state == S4:
            break
        if events > max_events or windows >= MOST_WINDOWS:
            code = TOO_MANY_EVENTS
            break
        if not stiffens and 2 * (one.E + two.E) + (v2 - d1) * (v2 - d1) + mu * v2 * v2 < COLLAPSED:
            d1, v2, state, code, loss = 0.0, 0.0, S4, COLLAPSE, 0.5
            continue
        if state == S1 and rigid == 0:
            rigid, code, one, two, loss = taken_for_rigid(
                mu, M, d1, v2, one, two, stiffens, highest, cutoff, loss
            )
        if state == S1 and rigid == 0:
            if one.k != modes.k1 or two.k != modes.k2:
                modes = modes_of(mu, one.k, two.k)
            a, b = amplitudes(d1, v2, one.F / one.k, two.F / two.k, modes)
            d1, v2, one, two, rate1, rate2, loss, duration, margin, tried = both_contacts(
                mu, modes, a, b, d1, v2, one, two, stiffens, exact, loss, margin
            )
            windows += tried
            if recorded:
                time, rows = write_both(log, rows, points, time, state, duration, modes, a, b)
            events += rate1 + rate2 + (one.phase == INACTIVE) + (two.phase == INACTIVE)
            ended1, ended2 = rate1 and e1 == 0, rate2 and e2 == 0
        else:
            alone = rigid if state == S1 or plastic else 0
            first, united, c, mass, rate, to_return = at_work(mu, M, state, d1, v2, one, two, alone, highest)
            exit = single_contact(mass, rate, c.E, c.e, c.phase == COMPRESSION, to_return)
            _, ended, _, after, E = exit
            if recorded:
                until = atan2(sqrt(2 * E / mass), after) if E > 0 or after > 0 else pi
                time, rows = write_one(
                    log, rows, points, time, state, v2 - d1, v2, first, united, mu, c,
                    two.F if first else one.F, mass, rate, until,
                )  # fmt: skip
            d1, v2, one, two, loss = after_one_contact(
                mu, state, d1, v2, one, two, stiffens, alone, first, united, c, mass, rate, exit, loss
            )
            events += 0 if alone else 1 + ended
            ended = ended and not alone
            ended1, ended2 = ended and first and e1 == 0, ended and not first and e2 == 0
        if ended1 or ended2:
            rigid, plastic, code = (1 if ended1 else 2), True, LIMIT
        state = S1 + (one.phase == INACTIVE) + 2 * (two.phase == INACTIVE)
    rows = write(log, rows, state, time, v2 - d1, v2, 0.0, 0.0)
    return v2 - d1, v2, code, states, events, rows - at, margin, loss


@compiled_with(nogil=True)
def collide_all(kappa, mu, e1, e2, cutoff, max_events, stiffens, points, log, sets, velocities, results):
    """Follow collisions through the diagram, in units of m1, k1 and abs(v0); the only kernel that Python calls.

    It holds no lock, so that threads can be given parts of arrays. Given are, the first four of shape (n,),

        kappa, mu, e1, e2   k2/k1 from 0 to inf, m2/m1, and coefficients of restitution
        cutoff              running stiffness ratio above which, and below the inverse of which, a contact is taken for
                            rigid; `EXACT` for the outcome without a cut-off, sooner
        max_events          events after which a collision is given up
        stiffens            whether a repeated compression runs at the stiffness that the ends of compression left, else
                            at the original one (`pair.law`)
        points              points of the path per half period of the fastest oscillation of a segment

    Filled are, the first two for all collisions one after another as far as they fit,

        log                 rows of paths (`pair.path.LOG_COLUMNS`); may have none
        sets                the contacts that act, of shape (entries, 1): contact 1 is the lowest bit, 0 is the end
        velocities          v1, v2; NaN where a collision was given up, or m2/m1 is beyond `MASS_PRECISION`
        results             records of `RESULT`
    """
    at, place = np.int64(0), 0
    for i in range(kappa.size):
        v1 = v2 = margin = loss = nan
        code, states, events, rows = BEYOND_PRECISION, 0, 0, 0
        if 1 / MASS_PRECISION <= mu[i] <= MASS_PRECISION:
            v1, v2, code, states, events, rows, margin, loss = collide(
                kappa[i], mu[i], e1[i], e2[i], cutoff, max_events, stiffens, points,
                log, at, place, sets,
            )  # fmt: skip
        if code == TOO_MANY_EVENTS:
            v1 = v2 = nan
        at, place = at + rows, place + states
        velocities[i, 0], velocities[i, 1] = v1, v2
        result = results[i]
        result.code, result.n_states, result.n_events, result.rows = code, states, events, rows
        result.margin = margin
        result.residual = 0.5 - loss - 0.5 * (v1 * v1 + mu[i] * v2 * v2)
