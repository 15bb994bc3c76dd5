"""A chain from its first touch to its end: piece by piece, each with one set of acting contacts.

Over a piece every rate and every deformation is a polynomial in time (`chain.series`, `chain.power_law`); the first
event is found with certainty (`chain.roots`); what it does to its contact is the law's (`chain.laws`). With frozen
positions the collision is over when no contact acts, else when no contact acts and no gap will close.

Ties: events at one instant are applied one after the other, in the order of contacts. That order does not matter, for
each changes only its own contact, and leaves all rates and forces as they are.
"""

from __future__ import annotations

from math import inf, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from impact_xval.model.chain.laws import (
    FORCE,
    GAP,
    HELD,
    HUNT_CROSSLEY,
    LIU_ZHAO_BROGLIATO,
    RATE,
    SLACK,
    STATE_TRANSITION,
    WATCHED,
    carries,
    dashpot_event,
    end_compression,
    force,
    has_dashpot,
    has_series,
    rest,
    restart_compression,
    returned,
    spent,
)
from impact_xval.model.chain.power_law import (
    ORDER_OF_STEP,
    advance,
    new_workspace,
    settle,
    step,
    watch_force,
)
from impact_xval.model.chain.rest import (
    FREE,
    GOING,
    STUCK,
    fall_time,
    how_over,
    in_flight,
    may_settle,
    over_within,
    settled,
)
from impact_xval.model.chain.roots import first_root, refine
from impact_xval.model.chain.series import ORDER, evaluate, expand, expand_product, slope, span
from impact_xval.model.chain.state import (
    acceleration,
    ball_values,
    bring_to_rest,
    energy_left,
    energy_of,
    neighbours,
    new_chain,
    nothing,
    oscillation,
    still,
    strain,
    tangent,
    touch,
    unite,
)
from impact_xval.model.compiled import OPTIONS, compiled, uncounted
from impact_xval.model.pair.grazing import STAKE
from impact_xval.model.pair.law import INACTIVE, RESTITUTION

#: What happens where the rate of a contact that does not act is zero, which is no event of its own.
TURN = 3

#: How a chain ended, as bits: what happened on the way.
PLASTIC, RUNAWAY, COLLAPSE, TOO_MANY_EVENTS = 1, 2, 4, 8

#: What the log says of a contact that acts, and of one that has become rigid; 0 of others.
ACTS, UNITED = 1.0, 2.0

#: Bodies are united where all that the contact between them can still do changes less than this share of its
#: neighbours' energy.
RIGID = 1e-14

#: Neighbours of less than this share of the other's energy ring themselves, and are disregarded.
SMALL = 1e-6

#: With this share of the energy left in all contacts that act, their bodies are taken to be at rest.
COLLAPSED = 1e-30

#: Step of the method for power laws that is tried first, in units of about 1 of masses, stiffnesses and velocities.
FIRST_STEP = 1e-3


@uncounted
def ringing_ends(c, n, i):
    """Tell whether a contact that has just ended compression may be taken for rigid from here on.

    It rings about the force that its neighbours' forces ask of it, each end of compression stiffens it by 1/e^2 (if
    linear), and it is rigid after a finite time tau (supplement, 3.4). It is taken for rigid at once if its energy is
    negligible beside its neighbours', if they press it together all the while, if no other body arrives meanwhile, and
    if its ringing cannot carry a neighbour's rate through zero, which would be an end of compression.
    """
    e = c.e[i]
    inverse, k = c.a[i] + c.a[i + 1], tangent(c, i)
    tau = 2 * pi / sqrt(k * inverse) / (1 - e)
    static, change, _, swing = neighbours(c, n, i)
    if not c.frozen and meets_within(c, n, 2 * tau, RIGID * swing):
        return False
    load = max(force(c, n, i), static) ** 2
    if c.g[0] > 0 and i > 0 and not carries(c.phase[i - 1]):
        swing = oscillation(c, n, i - 1)  # the upper ball comes down again, with this energy
        load = max(load, c.k[i - 1] * swing)
    if abs(change) * tau >= 0.5 * static or load / (k * (1 - e)) > RIGID * swing:
        return False
    wiggle = abs(force(c, n, i) - static) / sqrt(inverse * k)
    for j in (i - 1, i + 1):
        if 0 <= j < n and carries(c.phase[j]) and oscillation(c, n, j) > SMALL * swing:
            room = 4 * c.a[max(i, j)] * wiggle + 2 * abs(acceleration(c, n, j)) * tau
            if abs(c.w[j]) < room:
                return False
    return True


@uncounted
def meets_within(c, n, time, least):
    """Tell whether bodies that are apart may meet within a time, with more than this energy of approach, twice."""
    for j in range(n):
        if c.phase[j] == INACTIVE:
            approach = c.w[j] + time * max(acceleration(c, n, j), 0.0)
            matters = approach * approach > least * (c.a[j] + c.a[j + 1])
            if matters and -(c.delta[j] + rest(c, n, j)) < time * approach:
                return True
    return False


@uncounted
def first_event(c, n, h, work):
    """Find the first event of a piece: the contact (-1: none), what, its sign, and the time per h.

    The time is -1 where the search was given up.
    """
    series = has_series(c)
    degree = ORDER if series else ORDER_OF_STEP
    first, which, happens, its_sign = inf, -1, FORCE, 0.0
    for i in range(n):
        row = HELD if c.frozen and c.phase[i] == INACTIVE else c.phase[i]
        for what in (FORCE, GAP, RATE):
            sign = WATCHED[c.law, row, what]
            if sign == 0 or work.left_out[i, what]:
                continue
            table, at = work.rates if what == RATE else work.deltas, i
            start = sign * (table[i, 0] + rest(c, n, i)) if what == GAP else sign * table[i, 0]
            if what == FORCE:
                table, at = work.watched, 0
                if series:
                    watch_force_of_series(c, n, i, work)
                else:
                    watch_force(c, i, h, work)
                start = 0.0 if work.cut[i] else sign * table[0, 0]
            at_rest = not series and work.w[i] == 0 and work.delta[i] == 0
            if at_rest and (what == FORCE or work.kw[0, i] == 0):
                # Not yet pressed: the polynomial knows nothing of how a load begins, but it can only be pressed.
                rises = table[at, 3] + table[at, 4] + table[at, 5] > 0
                x = 0.0 if sign < 0 and rises else inf
            else:
                x = first_root(table, at, sign, start, degree, min(first, 1.0))
            if x < first:
                first, which, happens, its_sign = x, i, what, sign
    if c.g[0] > 0 and n == 2 and not c.frozen and c.phase[0] == INACTIVE and carries(c.phase[1]):
        # B2 at rest counts once B1 no longer approaches.
        w = work.rates[0, 0]
        sign = 1.0 if w > 0 or (w == 0 and work.rates[0, 1] > 0) else -1.0
        x = first_root(work.rates, 0, sign, sign * w, degree, min(first, 1.0))
        if x < first:
            first, which, happens = x, 0, TURN
    return which, happens, its_sign, first


@uncounted
def watch_force_of_series(c, n, i, work):
    """Write the series of the force of a dashpot before it is cut off, up to a positive factor."""
    for j in range(ORDER + 1):
        damping = c.b[i] * work.rates[i, j]
        work.watched[0, j] = damping if c.law == HUNT_CROSSLEY else damping + c.k[i] * work.deltas[i, j]
    work.watched[0, 0] += 1.0 if c.law == HUNT_CROSSLEY else c.k[i] * rest(c, n, i)


@uncounted
def near_misses(c, n, degree, x, energy, margin, work):
    """Grazing margin after a piece of length x at whose end `c` is, given that before it.

    The magnitude of an extremum of a rate is taken relative to its amplitude: of the contact's own oscillation about
    the force that its neighbours ask of it, and of the motion that a change of that force imposes.
    """
    rates = work.rates
    for i in range(n):
        start = rates[i, 1]
        stake = (1 - c.e[i] * c.e[i]) * strain(c, n, i)
        if not carries(c.phase[i]) or stake <= STAKE * energy or start * acceleration(c, n, i) >= 0:
            continue
        sign = 1.0 if start > 0 else -1.0
        for j in range(degree):
            work.watched[0, j] = (j + 1) * rates[i, j + 1]
        bend = sign * slope(work.watched, degree - 1, 0, x)
        turn = sign * slope(rates, degree, i, x)
        at = x
        if turn < 0:
            at, _ = refine(
                work.watched, 0, sign, sign * start, 0, degree - 1, 0.0, x, sign * start, turn, bend
            )
        value = 0.0
        for j in range(degree, -1, -1):
            value = value * at + rates[i, j]
        static, _, imposed, _ = neighbours(c, n, i)
        k = tangent(c, i)
        if k > 0:
            ring = (force(c, n, i) - static) * sqrt((c.a[i] + c.a[i + 1]) / k)
            size = sqrt(max(value * value, c.w[i] * c.w[i]) + ring * ring) + imposed
            margin = min(margin, abs(value) / size)
    return margin


@uncounted
def write_path(c, n, degree, work, x, h, time, drift, points, log, row):
    """Write points of a piece: time, velocities and accelerations of the balls, and which contacts act."""
    if row >= log.shape[0]:
        return row + points
    balls, rates, values = c.body.size, work.rates, work.values
    for point in range(points):
        if row < log.shape[0]:
            now = x * point / points
            log[row, 0] = time + now * h
            evaluate(rates, degree, n, now, values)
            ball_values(c, n, values, drift, log[row, 1 : 1 + balls])
            for i in range(n):
                values[i] = slope(rates, degree, i, now) / h
            ball_values(c, n, values, 0.0, log[row, 1 + balls : 1 + 2 * balls])
            log[row, 1 + 2 * balls :] = UNITED
            for i in range(n):
                log[row, 1 + 2 * balls + c.contact[i]] = ACTS if carries(c.phase[i]) else 0.0
        row += 1
    return row


@uncounted
def apply_event(c, n, i, what, energy, loss, code):
    """Apply the law to contact i, and unite its bodies if that made it rigid: contacts left, loss, code."""
    held = strain(c, n, i)
    if what in (RATE, TURN):
        c.w[i] = 0.0
    if what == TURN:
        pass
    elif has_dashpot(c):
        dashpot_event(c, n, i, what)
    elif c.phase[i] == INACTIVE:
        returned(c, n, i)
    elif c.phase[i] == RESTITUTION and what == RATE:
        restart_compression(c, i)
    elif what == GAP:
        spent(c, n, i)
    elif c.e[i] == 0:
        return unite(c, n, i), loss + held, code | PLASTIC
    elif held <= nothing(c, i, energy):
        spent(c, n, i)
    else:
        end_compression(c, i)
        if c.law == STATE_TRANSITION and c.e[i] < 1 and ringing_ends(c, n, i):
            return unite(c, n, i), loss + held, code | RUNAWAY
    return n, loss + held - strain(c, n, i), code


@uncounted
def flight(c, n):
    """Time until the first gap closes while no contact carries force, and of which contact; -1 if none will.

    The contact is n where one does. A contact at rest that acts carries none.
    """
    first, which = inf, -1
    for i in range(n):
        if carries(c.phase[i]) and (c.delta[i] > 0 or c.w[i] != 0):
            return 0.0, n
        if not c.frozen and c.w[i] > 0 and max(0.0, -c.delta[i] / c.w[i]) < first:
            first, which = max(0.0, -c.delta[i] / c.w[i]), i
    return first, which


@uncounted
def fly(c, n, h, work):
    """Carry all bodies over a time h without forces."""
    for i in range(n):
        work.rates[i, 0] = c.w[i]
        c.delta[i] += h * c.w[i]
        if c.phase[i] == SLACK and c.delta[i] <= 0:
            c.phase[i] = INACTIVE


@uncounted
def follow(c, n, h_next, tolerance, work):
    """Follow a piece up to its first event.

    Returns
    -------
    h, h_next : float
        Length of the piece, and of the step to try next.
    which, what : int
        The contact whose event it was (-1: none), and what.
    x : float
        When, per h; 1 without an event, below 0 where it cannot be said.
    """
    work.left_out[:] = False
    if has_series(c):
        h = span(c, n, work)
        h = h if h < inf else fall_time(c, n)
        if c.law == HUNT_CROSSLEY:
            h = expand_product(c, n, h, work)
        else:
            expand(c, n, h, work)
        which, what, _, x = first_event(c, n, h, work)
        x = min(x, 1.0)
        if c.g[0] > 0 and n == 2 and x > 0 and has_dashpot(c):
            stop = over_within(c, n, x, work)
            which, x = (-1, stop) if stop < x else (which, x)
        evaluate(work.rates, ORDER, n, x, c.w)
        evaluate(work.deltas, ORDER, n, x, c.delta)
        return h, h_next, which, what, x
    h, h_next = advance(c, n, h_next, tolerance, work)
    if h == 0:
        return h, h_next, -1, RATE, -1.0  # slopes lie beyond double precision
    which, what, sign, x = first_event(c, n, h, work)
    while which >= 0 and x >= 0:
        x, happened = settle(c, n, h, x, which, what, sign, work)
        if happened:
            break
        work.left_out[which, what] = True
        step(c, n, h, work)
        which, what, sign, x = first_event(c, n, h, work)
    return h, h_next, which, what, min(x, 1.0)


@uncounted
def state_of(c, n):
    """State of two balls on a table, less one: which contacts act; -1 once one has become rigid."""
    if n < 2:
        return -1
    return (0 if carries(c.phase[0]) else 1) + (0 if carries(c.phase[1]) else 2)


@compiled
def how_ended(c, n, quiet):
    """How a collision with gravity is over, or that it goes on, after so many pieces without an event."""
    end = how_over(c, n)
    if end == GOING and may_settle(c, n, quiet):
        mu, k1, k2, g = 1 / c.a[1], c.k[0], c.k[1], c.g[0]
        if settled(mu, k1, k2, c.b[0], c.b[1], g, c.delta[0], c.w[0], c.delta[1], -c.w[1]):
            return STUCK
    return end


class Followed(NamedTuple):
    """How a chain went.

    Attributes
    ----------
    n : int
        Contacts that have not become rigid.
    code : int
        What happened on the way, as bits.
    end : int
        How it ended (`chain.rest`); `GOING` if it was given up.
    events, pieces : int
        Numbers of them.
    margin : float
        Grazing margin: the smallest rate at which a compression rate turned around while its contact acted, per the
        largest one since it last did; contacts of e = 1 do not count. Infinite under laws of dashpots.
    loss : float
        What was lost and what is left of the kinetic energy, relative to the centre of mass or the table, per that
        before: 1 but for rounding, under laws without dashpots and without gravity.
    time, fall : float
        Since first touch, and until the first flight of a collision with gravity.
    rows : int
        Of the log, had it room for all.
    n_states : int
        Number of states of two balls on a table.
    sequence : int
        These states, two bits each, the last one lowest (S1 is 0): the last 32.
    """

    n: Any
    code: Any
    end: Any
    events: Any
    pieces: Any
    margin: Any
    loss: Any
    time: Any
    fall: Any
    rows: Any
    n_states: Any
    sequence: Any


@njit(inline="always", **OPTIONS)
def collide(c, work, energy, drift, gaps, tolerance, max_pieces, points, log):
    """Follow one chain to its end. Compiled as a part of `collide_all`: compiled apart, it would take as long again.

    Parameters
    ----------
    c : Chain
        At first touch; left as it is at the end.
    work : Workspace
    energy : float
        Kinetic energy of the balls relative to their centre of mass, or to the table.
    drift : float
        Velocity of the centre of mass; without meaning on a table.
    gaps : ndarray, shape (C,)
        At first; zero where positions are frozen.
    tolerance : float
        Error of a step, where steps are taken.
    max_pieces : int
        Pieces of segments after which the chain is given up.
    points : int
        Rows of the log for each piece.
    log : ndarray, shape (rows, 1 + 2 N + C)
        Filled with the path and its end, as far as it goes; may have no rows.

    Returns
    -------
    Followed
    """
    n = c.k.size
    degree = ORDER if has_series(c) else ORDER_OF_STEP
    code, end, events, pieces, quiet, rows = 0, GOING, 0, 0, 0, 0
    margin, loss, time, fall, h_next = inf, 0.0, 0.0, inf, FIRST_STEP
    sequence, n_states, state = np.uint64(0), 1, 0
    work.cut[:] = False
    touch(c, n, gaps)
    while True:
        now = state_of(c, n)
        if now >= 0 and now != state:
            state, sequence, n_states = now, (sequence << np.uint64(2)) | np.uint64(now), n_states + 1
        if c.law <= LIU_ZHAO_BROGLIATO and 0 < energy_left(c, n) <= COLLAPSED * energy:
            code |= COLLAPSE
            loss += bring_to_rest(c, n)
        h, which = 0.0, n
        if c.g[0] > 0:
            end = how_ended(c, n, quiet)
            if end == GOING and in_flight(c, n):
                c.delta[n - 1] += rest(c, n, n - 1)
                c.g[0], fall = 0.0, time
        if c.g[0] == 0:
            h, which = flight(c, n)
            end = FREE if which < 0 else GOING
        if end != GOING:
            break
        if pieces == max_pieces:
            code |= TOO_MANY_EVENTS
            break
        pieces, quiet = pieces + 1, quiet + 1
        what, x, last = RATE if c.frozen else GAP, 1.0, 0
        if which < n:
            fly(c, n, h, work)
        else:
            last = degree
            h, h_next, which, what, x = follow(c, n, h_next, tolerance, work)
            if x < 0:
                code |= TOO_MANY_EVENTS
                break
            if not has_dashpot(c):
                margin = near_misses(c, n, degree, x, energy, margin, work)
        if x > 0:
            work.cut[:] = False
            rows = write_path(c, n, last, work, x, h, time, drift, points, log, rows)
        time += x * h
        if which >= 0:
            acted = carries(c.phase[which])
            n, loss, code = apply_event(c, n, which, what, energy, loss, code)
            if has_dashpot(c):
                work.cut[which] = what == FORCE
            # That bodies part which overlapped without force changes nothing.
            if what != TURN and (not has_dashpot(c) or carries(c.phase[which]) != acted):
                events, quiet = events + 1, 0
        still(c, n, energy)
    for i in range(n):
        work.rates[i, 0] = c.w[i]
    rows = write_path(c, n, 0, work, 0.0, 1.0, time, drift, 1, log, rows)  # the end
    if state != 3:
        sequence, n_states = (sequence << np.uint64(2)) | np.uint64(3), n_states + 1
    return Followed(
        n, code, end, events, pieces, margin, loss, time, min(fall, time), rows, n_states, sequence
    )


@njit(nogil=True, **OPTIONS)
def collide_all(
    law, p, frozen, masses, stiffnesses, restitutions, dampings, rates, drifts, gaps, gravities, tolerance,
    max_pieces, points, log, velocities, numbers, sequences,
):  # fmt: skip
    """Follow chains of one number of balls, in units of about 1; the only kernel that Python calls.

    Not a loop that numba shares out to threads: compiling one takes four times as long. It holds no lock of Python, so
    that threads can be given parts of the arrays.

    Parameters
    ----------
    law : int
        One of `chain.laws`.
    p : float
        Exponent of the forces.
    frozen : bool
        Whether positions are frozen.
    masses : ndarray, shape (n, N)
    stiffnesses, restitutions, dampings, rates, gaps : ndarray, shape (n, C)
        C is N - 1, or N on a table. Rates are those of compression at first touch.
    drifts, gravities : ndarray, shape (n,)
        Velocity of the centre of mass; g. A mass of NaN marks a chain that is left out.
    tolerance, max_pieces, points, log
        As of `collide`; the log is that of the first one.
    velocities : ndarray, shape (n, N)
        Where the final velocities go.
    numbers : ndarray, shape (n, 11)
        Where the numbers of `Followed` go but for the last one.
    sequences : ndarray of uint64, shape (n,)
        Where that one goes.
    """
    contacts = stiffnesses.shape[1]
    work, no_log = new_workspace(contacts), log[:0]
    for i in range(masses.shape[0]):
        if np.isnan(masses[i, 0]):
            continue
        c = new_chain(
            masses[i], stiffnesses[i], restitutions[i], dampings[i], rates[i], p, law, frozen, gravities[i]
        )
        energy = energy_of(c, contacts, masses[i], drifts[i], velocities[i])
        c.length[:] = (energy * (p + 1) / stiffnesses[i]) ** (1 / (p + 1))
        went = collide(
            c, work, energy, drifts[i], gaps[i], tolerance, max_pieces, points, log if i == 0 else no_log
        )
        left = energy_of(c, went.n, masses[i], drifts[i], velocities[i])
        out = numbers[i]
        out[0], out[1], out[2], out[3], out[4] = went.n, went.code, went.end, went.events, went.pieces
        out[5], out[6], out[7], out[8] = went.margin, (went.loss + left) / energy, went.time, went.fall
        out[9], out[10], sequences[i] = went.rows, went.n_states, went.sequence
