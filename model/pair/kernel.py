"""The compiled kernel of two balls on a table: it follows collisions through the states of the model.

    S1  both contacts active     -> S2 when contact 1 ends restitution, S3 when contact 2 does, S4 when both end at once
    S2  ball-table contact only  -> S1 when v1 - v2 turns negative, S4 when contact 2 ends restitution first
    S3  ball-ball contact only   -> S1 when v2 turns negative, S4 when contact 1 ends restitution first
    S4  no contact active           the end: v1 >= v2 >= 0

Contact 1 is between the balls, and contact 2 is between ball 2 and the table. Python calls `collide_all`, which follows
many collisions. `collide` follows one collision, segment by segment, in the scaled units of `pair.motion` (m1 = 1,
v0 = -1, k1 = 1). Each segment ends with one event, or with several simultaneous events.

Needs `pair.events` for the first event of a segment of S1, `pair.lone` for segments with a single active contact,
`pair.law` for the effect of an event, `pair.path` to log points. Used by `pair.following`. The sweeps of experiments
compile this kernel before they start.
"""

from __future__ import annotations

from math import inf, nan

import numpy as np

from impact_xval.model.compiled import force_inlined, inlined_helper, kernel_entry
from impact_xval.model.inputs import MASS_PRECISION
from impact_xval.model.pair.events import MOST_WINDOWS, Segment, first_event
from impact_xval.model.pair.law import Contact, Pair, Phase, after_event
from impact_xval.model.pair.limits import EXACT, Rigid, rigid_contact
from impact_xval.model.pair.lone import after_lone_contact, lone_contact
from impact_xval.model.pair.motion import Motion, amplitudes, follow_single_contact, modes_of
from impact_xval.model.pair.path import write_both, write_lone, write_point
from impact_xval.model.pair.record import PairEnding, State
from impact_xval.model.pair.ringing import next_zero_of_rate

#: Share of the energy of impact below which bodies are taken to be at rest. By the law of Liu, Zhao and Brogliato some
#: collisions repeat one cycle of states for ever, and each cycle leaves a fixed share of the energy.
COLLAPSED = 1e-30

#: Ratios of running stiffnesses above this number are taken as infinite, and ratios below its inverse are taken as
#: zero.
PRECISION_RATIO = 1e30


@force_inlined
def segment_of(pair, mu, modes):
    """Return the segment of S1 that begins in the present state of the pair."""
    contact1, contact2 = pair.contact1, pair.contact2
    a, b = amplitudes(pair.d1, pair.v2, contact1.F / contact1.k, contact2.F / contact2.k, modes)
    return Segment(
        mu=mu,
        modes=modes,
        signs=(
            1.0 if contact1.phase == Phase.COMPRESSION else -1.0,
            -1.0 if contact2.phase == Phase.COMPRESSION else 1.0,
        ),
        watches_force=(contact1.phase == Phase.RESTITUTION, contact2.phase == Phase.RESTITUTION),
        losses=(1 - contact1.e * contact1.e, 1 - contact2.e * contact2.e),
        a=a,
        b=b,
    )


@force_inlined
def follow_both_contacts(segment, pair, options, margin):
    """Follow a segment of the state S1 to its first event, and apply the impact law to the event.

    The function returns the pair after the event, whether rate 1 was zero at the event, whether rate 2 was zero, the
    duration of the segment, the grazing margin so far, and the number of windows that the search has tried.
    """
    start = Motion(pair.d1, pair.v2, pair.contact1.F, pair.contact2.F)
    duration, windows, at_event = 0.0, 1, start
    rate1, rate2, force1, force2 = False, False, False, False
    if options.cutoff == EXACT:
        duration, rate1, at_event = next_zero_of_rate(segment, start)
        rate2 = not rate1
    if duration == 0:
        event = first_event(segment, start, margin)
        duration, at_event, margin, windows = event.time, event.motion, event.margin, event.windows
        rate1, rate2 = event.fired.rate1, event.fired.rate2
        force1, force2 = event.fired.force1, event.fired.force2
    d1, v2 = (0.0 if rate1 else at_event.d1), (0.0 if rate2 else at_event.v2)
    contact1, loss = after_event(options.stiffens, pair.contact1, at_event.F1, rate1, force1, pair.loss)
    contact2, loss = after_event(options.stiffens, pair.contact2, at_event.F2, rate2, force2, loss)
    return Pair(d1, v2, contact1, contact2, loss), rate1, rate2, duration, margin, windows


@force_inlined
def state_of(pair):
    """Return the state S1 to S4 that belongs to the set of active contacts."""
    if pair.contact1.phase == Phase.INACTIVE:
        return State.S4 if pair.contact2.phase == Phase.INACTIVE else State.S2
    return State.S3 if pair.contact2.phase == Phase.INACTIVE else State.S1


@force_inlined
def has_collapsed(pair, mu):
    """Return whether the remaining energy is below the share `COLLAPSED` of the energy of impact."""
    v1, v2 = pair.v2 - pair.d1, pair.v2
    return 2 * (pair.contact1.E + pair.contact2.E) + v1 * v1 + mu * v2 * v2 < COLLAPSED


@inlined_helper
def collide(kappa, mu, e1, e2, options, logs, first_point, first_set, result):
    """Follow one collision through its states to its end, and return the final velocities v1 and v2.

    All fields of `result`, a record of `pair.record.RESULT`, are filled in. Its field `energy_residual` holds the lost
    energy at first; `collide_all` computes the residual from it. Points of the motion are logged from row `first_point`
    on, and sets of active contacts from row `first_set` on.
    """
    contact1 = Contact(Phase.COMPRESSION, 1.0, 0.0, 0.0, e1, 1.0)
    contact2 = Contact(Phase.COMPRESSION, kappa, 0.0, 0.0, e2, kappa)
    pair = Pair(1.0, 0.0, contact1, contact2, 0.0)
    state, logged = State.S1, State.S4
    rigid, plastic = Rigid.NONE, False  # the bodies of a contact with e = 0 stay united in every state
    ending = PairEnding.FINISHED
    n_states, n_events, windows = 0, 0, 0
    margin = inf
    time, row = 0.0, first_point
    M = mu / (1 + mu)
    highest = PRECISION_RATIO if options.cutoff == EXACT else min(options.cutoff, PRECISION_RATIO)
    logs_path = logs.path.shape[0] > 0
    modes = modes_of(mu, 1.0, kappa)
    while True:
        if state != logged:
            if first_set + n_states < logs.sets.shape[0]:
                logs.sets[first_set + n_states, 0] = State.S4 - state
            logged, n_states = state, n_states + 1
        if state == State.S4:
            break
        if n_events > options.max_events or windows >= MOST_WINDOWS:
            ending = PairEnding.TOO_MANY_EVENTS
            break
        if not options.stiffens and has_collapsed(pair, mu):
            pair = Pair(0.0, 0.0, pair.contact1, pair.contact2, 0.5)
            state, ending = State.S4, PairEnding.COLLAPSED
            continue
        if state == State.S1 and rigid == Rigid.NONE:
            rigid, ending, pair = rigid_contact(pair, mu, M, options, highest)
        if state == State.S1 and rigid == Rigid.NONE:
            if pair.contact1.k != modes.k1 or pair.contact2.k != modes.k2:
                modes = modes_of(mu, pair.contact1.k, pair.contact2.k)
            segment = segment_of(pair, mu, modes)
            pair, rate1, rate2, duration, margin, tried = follow_both_contacts(segment, pair, options, margin)
            windows += tried
            if logs_path:
                time, row = write_both(logs.path, row, options.points, time, state, duration, segment)
            opened1, opened2 = pair.contact1.phase == Phase.INACTIVE, pair.contact2.phase == Phase.INACTIVE
            n_events += rate1 + rate2 + opened1 + opened2
            plastic1, plastic2 = rate1 and e1 == 0, rate2 and e2 == 0
        else:
            alone = rigid if state == State.S1 or plastic else Rigid.NONE
            lone = lone_contact(pair, mu, M, state, alone, highest)
            compresses = lone.contact.phase == Phase.COMPRESSION
            leaving = follow_single_contact(
                lone.mass, lone.rate, lone.contact.E, lone.contact.e, compresses, lone.impulse_to_return
            )
            if logs_path:
                time, row = write_lone(logs.path, row, options.points, time, state, pair, lone, mu, leaving)
            pair = after_lone_contact(pair, lone, leaving, mu, state, options.stiffens, alone)
            plastic1, plastic2 = False, False
            if alone == Rigid.NONE:
                n_events += 1 + leaving.compression_ended
                plastic1 = leaving.compression_ended and lone.is_ball_ball and e1 == 0
                plastic2 = leaving.compression_ended and not lone.is_ball_ball and e2 == 0
        if plastic1 or plastic2:
            rigid, plastic = (Rigid.CONTACT1 if plastic1 else Rigid.CONTACT2), True
            ending = PairEnding.CLOSED_FORM
        state = state_of(pair)
    v1, v2 = pair.v2 - pair.d1, pair.v2
    row = write_point(logs.path, row, state, time, v1, v2, 0.0, 0.0)
    result.ending = ending
    result.n_states, result.n_events, result.n_points = n_states, n_events, row - first_point
    result.margin, result.energy_residual = margin, pair.loss
    return v1, v2


@kernel_entry
def collide_all(cells, options, logs, velocities, results):
    """Follow n collisions through their states to their ends, in units of m1, k1 and abs(v0).

    Python calls no other compiled function of this module.

    Parameters
    ----------
    cells : PairRatios
        Ratios of n collisions.
    options : PairOptions
    logs : PairLogs
        Filled in for one collision after another.
    velocities : ndarray, shape (n, 2)
        Filled in with the final v1 and v2; NaN if a collision was given up or not followed.
    results : recarray of `pair.record.RESULT`, shape (n,)
        Filled in.
    """
    point, entry = np.int64(0), np.int64(0)
    for i in range(cells.kappa.size):
        mu, result = cells.mu[i], results[i]
        if 1 / MASS_PRECISION <= mu <= MASS_PRECISION:
            v1, v2 = collide(
                cells.kappa[i], mu, cells.e1[i], cells.e2[i], options, logs, point, entry, result
            )
            if result.ending == PairEnding.TOO_MANY_EVENTS:
                v1 = v2 = nan
            result.energy_residual = 0.5 - result.energy_residual - 0.5 * (v1 * v1 + mu * v2 * v2)
        else:
            v1 = v2 = nan
            result.ending = PairEnding.UNREPRESENTABLE
            result.n_states, result.n_events, result.n_points = 0, 0, 0
            result.margin, result.energy_residual = nan, nan
        point, entry = point + result.n_points, entry + result.n_states
        velocities[i, 0], velocities[i, 1] = v1, v2
