"""A chain from its first touch to its end: piece by piece, each with one set of acting contacts.

Over a piece every rate and every deformation is a polynomial in time (`chain.series`, `chain.power_law`); the first
event is found with certainty (`chain.roots`); what it does to its contact is the law's (`chain.laws`). With frozen
positions the collision is over when no contact acts, else when no contact acts and no gap will close.

Ties: events at one instant are applied one after the other, in the order of contacts. That order does not matter, for
each changes only its own contact, and leaves all rates and forces as they are.
"""

from __future__ import annotations

from math import inf, isnan, pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from impact_xval.model.chain import laws, state
from impact_xval.model.chain.grazing import near_misses
from impact_xval.model.chain.laws import FORCE, GAP, RATE, TURN, carries, force, has_dashpot, has_series, rest
from impact_xval.model.chain.power_law import ORDER_OF_STEP, advance, settle, step, through_ends, watch_force
from impact_xval.model.chain.rest import FREE, GOING, QUIET, fall_time, how_ended, in_flight, over_within
from impact_xval.model.chain.roots import first_root
from impact_xval.model.chain.series import ORDER, expand, expand_product, place, slope, span, value
from impact_xval.model.compiled import entry, merged, uncounted
from impact_xval.model.pair.law import COMPRESSION, INACTIVE, RESTITUTION

#: How a chain ended, as bits: what happened on the way.
PLASTIC, RUNAWAY, COLLAPSE, TOO_MANY_EVENTS, MADE_ENERGY = 1, 2, 4, 8, 16

#: Why its outcome is a limit, by the bit.
HAPPENED = {
    PLASTIC: "closed form of e = 0: the bodies of a contact that ended compression are one from there on",
    RUNAWAY: "the running stiffness of a contact runs away: its bodies are one from where it is rigid to rounding",
    COLLAPSE: "bodies come to rest together after infinitely many events",
}

#: Bodies are united where all that the contact between them can still do changes less than this share of its
#: neighbours' energy.
RIGID = 1e-14

#: Neighbours of less than this share of the other's energy ring themselves, and are disregarded.
SMALL = 1e-6

#: With this share of the energy left in all contacts that act, their bodies are taken to be at rest.
COLLAPSED = 1e-30

#: Pieces, times contacts less one, after which a chain is given up: about a second.
MOST_WORK = 1_000_000

#: Share of the kinetic energy by which a chain may end above it. No law makes any: rounding and steps have left at most
#: 1.2e-11 of it (p = 1.5; 3e-14 for p = 1 and 3), in 20,000 chains whose masses and stiffnesses lie up to 1e12 apart.
GAIN = 1e-9

#: Numbers that are handed on: numba would compile what takes a literal 0 or 1 once more for it.
ZERO, ONE = np.int64(0), np.int64(1)

#: Step of the method for power laws that is tried first, in units of about 1 of masses, stiffnesses and velocities.
FIRST_STEP = 1e-3


@uncounted
def ringing_ends(c, n, i):
    """Tell whether a contact that has just ended compression, or is at rest, may be taken for rigid from here on.

    It rings about the force that its neighbours' forces ask of it, each end of compression makes its tangent stiffer by
    1/e^2 at the same force, its periods shorter by e, and it is rigid after a finite time tau (supplement, 3.4). It is
    taken for rigid at once if its energy is negligible beside its neighbours', if they press it together all the while,
    if no other body arrives meanwhile, and if its ringing cannot carry a neighbour's rate through zero, which would be
    an end of compression.

    From rest without force it comes back to that under a constant load: the end of compression shrinks the way back by
    e^2 and the energy too. So it rings about the load from there on, with tangent and energy of that order.
    """
    one, upper = c[i], c[i - 1]
    e, F = one.e, force(one)
    static, change, _, swing = state.neighbours(c, i)
    k = state.tangent(one) if F > 0 else state.tangent_at(one, static)
    inverse = one.a + c[i + 1].a
    tau = 2 * pi / sqrt(k * inverse) / (1 - e)
    if not one.frozen and meets_within(c, n, 2 * tau, RIGID * swing):
        return False
    load = max(F, static) ** 2
    if one.g > 0 and i > 0 and not carries(upper):
        swing = state.oscillation(c, i - 1)  # the upper ball comes down again, with this energy
        load = max(load, upper.k * swing)
    if abs(change) * tau >= 0.5 * static or load / (k * (1 - e)) > RIGID * swing:
        return False
    wiggle = abs(F - static) / sqrt(inverse * k)
    for j in range(i - 1, i + 2, 2):
        if carries(c[j]) and state.oscillation(c, j) > SMALL * swing:
            room = 4 * c[max(i, j)].a * wiggle + 2 * abs(state.acceleration(c, j)) * tau
            if abs(c[j].w) < room:
                return False
    return True


@uncounted
def stays_at_rest(c, n, i, energy):
    """Tell whether a contact of a power law is at rest without force, and rigid under the load of its neighbours.

    Where its energy under that load is less than what is taken for rounding (`state.still`) it is brought to rest again
    after every step, and no step shows how it rings.
    """
    one = c[i]
    if one.phase != COMPRESSION or one.w != 0 or one.delta != 0 or one.e == 1:
        return False
    static, _, _, _ = state.neighbours(c, i)
    if static <= 0 or static * static / state.tangent_at(one, static) > state.nothing(one, energy):
        return False
    return ringing_ends(c, n, i)


@uncounted
def meets_within(c, n, time, least):
    """Tell whether bodies that are apart may meet within a time, with more than this energy of approach, twice."""
    for j in range(n):
        one = c[j]
        if one.phase == INACTIVE:
            approach = one.w + time * max(state.acceleration(c, j), 0.0)
            matters = approach * approach > least * (one.a + c[j + 1].a)
            if matters and -(one.delta + rest(one)) < time * approach:
                return True
    return False


@uncounted
def first_event(c, n, h, work):
    """Find the first event of a piece: the contact (-1: none), what, its sign, and the time per h.

    The time is -1 where the search was given up.
    """
    series = has_series(c[0])
    degree = ORDER if series else ORDER_OF_STEP
    first, which, happens, its_sign = inf, -1, FORCE, 0.0
    for i in range(n):
        one, own = c[i], work[i]
        row = laws.HELD if one.frozen and one.phase == INACTIVE else one.phase
        for what in range(4):
            sign = laws.WATCHED[one.law, row, what]
            if what == TURN and i == 0 and n == 2 and c[1].g > 0 and row == INACTIVE and carries(c[1]):
                # B2 at rest counts once B1 no longer approaches.
                w = own.rates[0]
                sign = 1.0 if w > 0 or (w == 0 and own.rates[1] > 0) else -1.0
            if sign == 0 or own.left_out >> what & 1:
                continue
            table = own.rates if what >= RATE else own.deltas
            start = sign * (table[0] + rest(one)) if what == GAP else sign * table[0]
            if what == FORCE:
                table = own.watched
                if series:
                    watch_force_of_series(one, own)
                else:
                    watch_force(one, h, own)
                start = 0.0 if own.cut else sign * table[0]
            at_rest = not series and own.w == 0 and own.delta == 0
            if at_rest and (what == FORCE or own.kw[0] == 0):
                # Not yet pressed: the polynomial knows nothing of how a load begins, but it can only be pressed.
                rises = table[3] + table[4] + table[5] > 0
                x = 0.0 if sign < 0 and rises else inf
            else:
                x = first_root(table, sign, start, degree, min(first, 1.0))
            if x < first:
                first, which, happens, its_sign = x, i, what, sign
    return which, happens, its_sign, first


@uncounted
def watch_force_of_series(one, own):
    """Write the series of the force of a dashpot before it is cut off, up to a positive factor."""
    product, k, b = one.law == laws.HUNT_CROSSLEY, one.k, one.b
    for j in range(ORDER + 1):
        damping = b * own.rates[j]
        own.watched[j] = damping if product else damping + k * own.deltas[j]
    own.watched[0] += 1.0 if product else k * rest(one)


@uncounted
def write_path(c, n, degree, work, x, h, time, drift, points, log, row):
    """Write points of a piece: time, velocities and accelerations of balls, which contacts act; the next row."""
    balls = (log.shape[1] - c.size) // 2
    for point in range(points):
        if row < log.shape[0]:
            now = x * point / points
            log[row, 0] = time + now * h
            for i in range(n):
                work[i].value = value(work[i].rates, degree, now)
            state.ball_values(c, n, work.value, drift, log, row, ONE)
            for i in range(n):
                work[i].value = slope(work[i].rates, degree, now) / h
            state.ball_values(c, n, work.value, 0.0, log, row, ONE + balls)
            for i in range(work.size):
                log[row, 1 + 2 * balls + i] = 1.0 if work[i].acts else 0.0
        row += 1
    return row


@uncounted
def apply_event(c, n, i, what, energy):
    """Apply the law to contact i, and unite its bodies if that made it rigid: contacts left, loss, code."""
    one = c[i]
    held, code = state.strain(one), 0
    if what >= RATE:
        one.w = 0.0
    if what == TURN:
        pass
    elif has_dashpot(one):
        laws.dashpot_event(one, what)
    elif one.phase == INACTIVE:
        laws.returned(one)
    elif one.phase == RESTITUTION and what == RATE:
        laws.restart_compression(one)
    elif what == GAP or (one.e > 0 and held <= state.nothing(one, energy)):
        laws.spent(one)
    elif one.e == 0:
        code = PLASTIC
    else:
        laws.end_compression(one)
        code = RUNAWAY if one.law == laws.STATE_TRANSITION and one.e < 1 and ringing_ends(c, n, i) else 0
    if code:
        return state.unite(c, n, i), held, code
    return n, held - state.strain(one), code


@uncounted
def flight(c, n):
    """Time until the first gap closes while no contact carries force, and of which contact; -1 if none will.

    The contact is n where one does. A contact at rest that acts carries none.
    """
    first, which = inf, -1
    for i in range(n):
        one = c[i]
        if carries(one) and (one.delta > 0 or one.w != 0):
            return 0.0, n
        if not one.frozen and one.w > 0 and max(0.0, -one.delta / one.w) < first:
            first, which = max(0.0, -one.delta / one.w), i
    return first, which


@uncounted
def fly(c, n, h, work):
    """Carry all bodies over a time h without forces."""
    for i in range(n):
        one = c[i]
        work[i].rates[0] = one.w
        one.delta += h * one.w
        if one.phase == laws.SLACK and one.delta <= 0:
            one.phase = INACTIVE


@uncounted
def follow(c, n, h_next, tolerance, work):
    """Follow a piece up to its first event: its length, the step to try next, and the event.

    That is its contact (-1: none), what, and when, per length of the piece; below 0 where it cannot be said.
    """
    for i in range(n):
        work[i].left_out = 0
    series = has_series(c[0])
    if series:
        h = span(c, n, work)
        h = h if h < inf else fall_time(c, n)
        if c[0].law == laws.HUNT_CROSSLEY:
            h = expand_product(c, n, h, work)
        else:
            expand(c, n, h, work)
    else:
        h, h_next = advance(c, n, h_next, tolerance, work)
    found, found_what = -1, FORCE
    while True:
        which, what, sign, x = first_event(c, n, h, work)
        if which < 0 and found >= 0:
            which, what, x = found, found_what, 1.0
            break
        if series or which < 0 or x < 0:
            break
        x, happened = settle(c, n, h, x, which, what, sign, work)
        work[which].left_out |= 1 << what
        if happened:
            # The step now ends with this event. Where its time by the polynomial was wrong another may come before it.
            found, found_what, h = which, what, x * h
            if h == 0:
                x = 0.0
                break
            through_ends(c, n, h, work)
        else:
            step(c, n, h, work)
    x = min(x, 1.0)
    if series:
        if n == 2 and c[1].g > 0 and x > 0 and has_dashpot(c[0]):
            stop = over_within(c, n, x, work)
            if stop < x:
                which, x = -1, stop
        place(c, n, x, work)
    return h, h_next, which, what, x


@uncounted
def note_set(c, n, work, sets, first, row):
    """Write the set of acting contacts to row `row` if it is not that before, of rows from `first` on; the next row.

    A rigid contact acts while another one does.
    """
    some = False
    for i in range(n):
        some |= carries(c[i])
    for i in range(work.size):
        work[i].acted, work[i].acts = work[i].acts, some
    for i in range(n):
        work[c[i].contact].acts = carries(c[i])
    new = row == first
    for i in range(work.size):
        new |= work[i].acts != work[i].acted
    if new and row < sets.shape[0]:
        for i in range(work.size):
            sets[row, i // 64] |= np.uint64(work[i].acts) << np.uint64(i % 64)
    return row + new


class Followed(NamedTuple):
    """How a chain went: the numbers that `follow_chains` gives of each."""

    #: What happened on the way, as bits; how it ended (`chain.rest`), `GOING` if it was given up.
    code: Any
    end: Any
    #: Numbers of them.
    events: Any
    pieces: Any
    #: Grazing margin (`chain.grazing`). Infinite under laws of dashpots.
    margin: Any
    #: What was lost and what is left of the kinetic energy, relative to the centre of mass or the table, per that
    #: before: 1 but for rounding, under laws without dashpots and without gravity.
    loss: Any
    #: Since first touch, and until the first flight of a collision with gravity.
    time: Any
    fall: Any
    #: Of the log, had it room for all, and of the log of sets.
    rows: Any
    n_states: Any


@merged
def collide(c, work, energy, drift, g, tolerance, max_pieces, points, log, at, out, sets, first):
    """Follow a chain from first touch to its end, as it is left.

    `out` is given the numbers of `Followed`, and the number of contacts that are left is returned; the log is written
    from row `at` on, the sets from row `first`. See `follow_chains`.
    """
    n, frozen, dashpot = work.size, c[0].frozen, has_dashpot(c[0])
    steps = not has_series(c[0])
    degree = ORDER_OF_STEP if steps else ORDER
    code, end, events, pieces, quiet, rows = ZERO, GOING, ZERO, ZERO, ZERO, at
    margin, loss, time, fall, h_next, row = inf, 0.0, 0.0, inf, FIRST_STEP, first
    while True:
        if c[0].law <= laws.LIU_ZHAO_BROGLIATO and 0 < state.energy_left(c, n) <= COLLAPSED * energy:
            dropped, lossy = state.bring_to_rest(c, n)
            loss, code = loss + dropped, code | (COLLAPSE if lossy else 0)
        h, which = 0.0, n
        if g > 0:
            end = how_ended(c, n, quiet > 0 and quiet % QUIET == 0)
            if end == GOING and in_flight(c, n):
                last = c[n - 1]
                last.delta += rest(last)
                g, last.g, fall = 0.0, 0.0, time
        if g == 0:
            h, which = flight(c, n)
            end = FREE if which < 0 else GOING
        if end != GOING:
            break
        if pieces == max_pieces or pieces * (work.size - 1) >= MOST_WORK:
            code |= TOO_MANY_EVENTS
            break
        pieces, quiet = pieces + 1, quiet + 1
        what, x, last_power = RATE if frozen else GAP, 1.0, 0
        if which < n:
            fly(c, n, h, work)
        else:
            last_power = degree
            h, h_next, which, what, x = follow(c, n, h_next, tolerance, work)
            if x < 0:
                code |= TOO_MANY_EVENTS
                break
            if not dashpot:
                margin = near_misses(c, n, degree, x, h, energy, margin, work)
        if x > 0:
            for i in range(work.size):
                work[i].cut = False
            row = note_set(c, n, work, sets, first, row)
            rows = write_path(c, n, last_power, work, x, h, time, drift, points, log, rows)
        time += x * h
        if which >= 0:
            acted = carries(c[which])
            n, lost, happened = apply_event(c, n, which, what, energy)
            loss, code = loss + lost, code | happened
            if dashpot:
                work[which].cut = what == FORCE
            # That bodies part which overlapped without force changes nothing.
            if what != TURN and (not dashpot or carries(c[which]) != acted):
                events, quiet = events + 1, 0
        state.still(c, n, energy)
        if steps and c[0].law == laws.STATE_TRANSITION:
            for i in range(n - 1, -1, -1):
                if stays_at_rest(c, n, i, energy):
                    n, code = state.unite(c, n, i), code | RUNAWAY
    if end != GOING:
        if end != FREE:
            row = note_set(c, n, work, sets, first, row)
        row = note_set(c, ZERO, work, sets, first, row)
    for i in range(n):
        work[i].rates[0] = c[i].w
    rows = write_path(c, n, ZERO, work, 0.0, 1.0, time, drift, ONE, log, rows)  # the end
    out[0], out[1], out[2], out[3], out[4] = code, end, events, pieces, margin
    out[5], out[6], out[7], out[8], out[9] = loss, time, min(fall, time), rows - at, row - first
    return n


@entry
def follow_chains(
    c, work, masses, stiffnesses, restitutions, dampings, rates, drifts, gaps, gravities, tolerance,
    max_pieces, points, log, sets, velocities, numbers,
):  # fmt: skip
    """Follow chains of one number of balls, in units of about 1; the only kernel that Python calls.

    It holds no lock, so that threads can be given parts of arrays. Given are, for C of N - 1, or N on a table,

        c, work         (C + 1,) of `CONTACT` and (C,) of `WORK`: written over, but for law, exponent and frozen
        masses          (n, N); a first mass of NaN marks a chain that is left out
        stiffnesses, restitutions, dampings, rates, gaps    (n, C), rates of compression at first touch
        drifts          (n,): velocity of the centre of mass, without meaning on a table
        gravities       (n,)
        tolerance       error of a step, where steps are taken
        max_pieces      pieces of segments after which a chain is given up; all are after `MOST_WORK`
        points          (n,): rows of the log for each piece

    Filled are, the first two for all chains one after another as far as they fit,

        log             (rows, 1 + 2 N + C): the paths of chains and their ends (`write_path`); may have no rows
        sets            (entries, W), zero before: the sets of acting contacts, bit i of word i//64 for contact i. The
                        first of a chain is that at first touch, its last one the empty one of the end, unless it is
                        given up; a set that lasts no time is left out
        velocities      (n, N): the final ones
        numbers         (n, 10): those of `Followed`
    """
    at, row = ZERO, ZERO
    for i in range(masses.shape[0]):
        numbers[i, 8], numbers[i, 9] = 0.0, 0.0
        if isnan(masses[i, 0]):
            continue
        state.begin(
            c, masses[i], stiffnesses[i], restitutions[i], dampings[i], rates[i], gaps[i], gravities[i]
        )
        energy = state.energy_of(c, work.size, masses, drifts[i], velocities, i)
        most = (1 + GAIN) * state.kinetic_energy(c, work.size)
        for j in range(work.size):
            one, work[j].cut = c[j], False
            one.length = (energy * (one.p + 1) / one.k) ** (1 / (one.p + 1))
        n = collide(
            c, work, energy, drifts[i], gravities[i], tolerance, max_pieces, points[i], log, at, numbers[i],
            sets, row,
        )  # fmt: skip
        left = state.energy_of(c, n, masses, drifts[i], velocities, i)
        numbers[i, 5] = (numbers[i, 5] + left) / energy
        numbers[i, 0] += MADE_ENERGY * (gravities[i] == 0 and not state.kinetic_energy(c, n) <= most)
        at += int(numbers[i, 8])
        row += int(numbers[i, 9])
