"""A chain from its first touch to its end: piece by piece, each with one set of acting contacts.

Over a piece every rate and every deformation is a polynomial in time (`chain.series`, `chain.power_law`); the first
event is found with certainty (`chain.roots`); what it does to its contact is the law's (`chain.laws`). With frozen
positions the collision is over when no contact acts, else when no contact acts and no gap will close.

Ties: events at one instant are applied one after the other, in the order of contacts. That order does not matter, for
each changes only its own contact, and leaves all rates and forces as they are.
"""

from __future__ import annotations

from math import inf, pi, sqrt

from impact_xval.model.chain.laws import (
    FORCE,
    GAP,
    HELD,
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
    is_linear,
    restart_compression,
    returned,
    spent,
)
from impact_xval.model.chain.power_law import (
    ORDER_OF_STEP,
    advance,
    settle,
    step,
    watch_force,
)
from impact_xval.model.chain.roots import first_root, refine
from impact_xval.model.chain.series import ORDER, evaluate, expand, slope
from impact_xval.model.chain.state import (
    acceleration,
    ball_values,
    left_in_contacts,
    neighbours,
    nothing,
    oscillation,
    still,
    strain,
    tangent,
    touch,
    unite,
)
from impact_xval.model.compiled import uncounted
from impact_xval.model.grazing import STAKE
from impact_xval.model.law import INACTIVE, RESTITUTION

#: How a chain ended, as bits: what happened on the way.
PLASTIC, RUNAWAY, COLLAPSE, TOO_MANY_EVENTS = 1, 2, 4, 8

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
    negligible beside its neighbours', if they press it together all the while, and if its ringing cannot carry a
    neighbour's rate through zero, which would be an end of compression.
    """
    e = c.e[i]
    inverse, k = c.a[i] + c.a[i + 1], tangent(c, i)
    tau = 2 * pi / sqrt(k * inverse) / (1 - e)
    static, change, _, swing = neighbours(c, n, i)
    if abs(change) * tau >= 0.5 * static or max(force(c, n, i), static) ** 2 / (k * (1 - e)) > RIGID * swing:
        return False
    wiggle = abs(force(c, n, i) - static) / sqrt(inverse * k)
    for j in (i - 1, i + 1):
        if 0 <= j < n and carries(c.phase[j]) and oscillation(c, j) > SMALL * swing:
            room = 4 * c.a[max(i, j)] * wiggle + 2 * abs(acceleration(c, n, j)) * tau
            if abs(c.w[j]) < room:
                return False
    return True


@uncounted
def first_event(c, n, h, work):
    """Find the first event of a piece: the contact (-1: none), what, its sign, and the time per h.

    The time is -1 where the search was given up.
    """
    linear = is_linear(c)
    degree = ORDER if linear else ORDER_OF_STEP
    first, which, happens, its_sign = inf, -1, FORCE, 0.0
    for i in range(n):
        row = HELD if c.frozen and c.phase[i] == INACTIVE else c.phase[i]
        for what in (FORCE, GAP, RATE):
            sign = WATCHED[c.law, row, what]
            if sign == 0 or work.left_out[i, what]:
                continue
            table, at = work.rates if what == RATE else work.deltas, i
            if what == FORCE:
                table, at = work.watched, 0
                if linear:
                    for j in range(degree + 1):
                        table[0, j] = c.k[i] * work.deltas[i, j] + c.b[i] * work.rates[i, j]
                else:
                    watch_force(c, i, h, work)
            start = 0.0 if what == FORCE and work.cut[i] else sign * table[at, 0]
            at_rest = not linear and work.w[i] == 0 and work.delta[i] == 0
            if at_rest and (what == FORCE or work.kw[0, i] == 0):
                # Not yet pressed: the polynomial knows nothing of how a load begins, but it can only be pressed.
                rises = table[at, 3] + table[at, 4] + table[at, 5] > 0
                x = 0.0 if sign < 0 and rises else inf
            else:
                x = first_root(table, at, sign, start, degree, min(first, 1.0))
            if x < first:
                first, which, happens, its_sign = x, i, what, sign
    return which, happens, its_sign, first


@uncounted
def near_misses(c, n, degree, x, energy, margin, work):
    """Grazing margin after a piece of length x at whose end `c` is, given that before it.

    The magnitude of an extremum of a rate is taken relative to its amplitude: of the contact's own oscillation about
    the force that its neighbours ask of it, and of the motion that a change of that force imposes.
    """
    rates = work.rates
    for i in range(n):
        start = rates[i, 1]
        stake = (1 - c.e[i] * c.e[i]) * strain(c, i)
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
            log[row, 1 + 2 * balls :] = 1.0  # a contact that has become rigid acts
            for i in range(n):
                log[row, 1 + 2 * balls + c.contact[i]] = 1.0 if carries(c.phase[i]) else 0.0
        row += 1
    return row


@uncounted
def apply_event(c, n, i, what, energy, loss, code):
    """Apply the law to contact i, and unite its bodies if that made it rigid: contacts left, loss, code."""
    held = strain(c, i)
    if what == RATE:
        c.w[i] = 0.0
    if has_dashpot(c):
        dashpot_event(c, i, what)
    elif c.phase[i] == INACTIVE:
        returned(c, i)
    elif c.phase[i] == RESTITUTION and what == RATE:
        restart_compression(c, i)
    elif what == GAP:
        spent(c, i)
    elif c.e[i] == 0:
        return unite(c, n, i), loss + held, code | PLASTIC
    elif held <= nothing(c, i, energy):
        spent(c, i)
    else:
        end_compression(c, i)
        if c.law == STATE_TRANSITION and c.e[i] < 1 and ringing_ends(c, n, i):
            return unite(c, n, i), loss + held, code | RUNAWAY
    return n, loss + held - strain(c, i), code


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
    if is_linear(c):
        h = expand(c, n, work)
        which, what, _, x = first_event(c, n, h, work)
        x = min(x, 1.0)
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
def bring_to_rest(c, n):
    """End all that acts, with no rate left; the strain energy that is dropped."""
    dropped = 0.0
    for i in range(n):
        if carries(c.phase[i]):
            dropped += strain(c, i)
            c.w[i] = 0.0
            spent(c, i)
    return dropped


@uncounted
def collide(c, work, energy, drift, gaps, tolerance, max_pieces, points, log):
    """Follow one chain to its end.

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
        Filled with the path, as far as it goes; may have no rows.

    Returns
    -------
    n, code, events : int
        Contacts that have not become rigid; how it ended, as bits; number of events.
    margin : float
        Grazing margin: the smallest rate at which a compression rate turned around while its contact acted, per the
        largest one since it last did; contacts of e = 1 do not count. Infinite under laws of dashpots.
    loss : float
        Energy lost, under laws without dashpots.
    time : float
        Since first touch.
    rows : int
        Of the log, had it room for all.
    """
    n = c.k.size
    degree = ORDER if is_linear(c) else ORDER_OF_STEP
    code, events, rows = 0, 0, 0
    margin, loss, time, h_next = inf, 0.0, 0.0, FIRST_STEP
    touch(c, n, gaps)
    for _ in range(max_pieces):
        if c.law <= LIU_ZHAO_BROGLIATO and 0 < left_in_contacts(c, n) <= COLLAPSED * energy:
            code |= COLLAPSE
            loss += bring_to_rest(c, n)
        h, which = flight(c, n)
        if which < 0:
            return n, code, events, margin, loss, time, rows
        what, x, last = GAP, 1.0, 0
        if which < n:
            for i in range(n):
                work.rates[i, 0] = c.w[i]
                c.delta[i] += h * c.w[i]
                if c.phase[i] == SLACK and c.delta[i] <= 0:
                    c.phase[i] = INACTIVE
        else:
            last = degree
            h, h_next, which, what, x = follow(c, n, h_next, tolerance, work)
            if x < 0:
                break
            if not has_dashpot(c):
                margin = near_misses(c, n, degree, x, energy, margin, work)
        if x > 0:
            work.cut[:] = False
            rows = write_path(c, n, last, work, x, h, time, drift, points, log, rows)
        time += x * h
        if which >= 0:
            events += 1
            n, loss, code = apply_event(c, n, which, what, energy, loss, code)
            if has_dashpot(c):
                work.cut[which] = what == FORCE
        still(c, n, energy)
    return n, code | TOO_MANY_EVENTS, events, margin, loss, time, rows
