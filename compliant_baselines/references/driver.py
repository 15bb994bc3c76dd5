"""One driver for the contact laws in time: a collision of the column, event by event, exact to rounding.

A collision is a sequence of segments. In each the same contacts carry force, the motion is a polynomial
(`references.taylor`), and the first root of what is watched (`model.chain.roots`) ends it. What is watched of a
contact, and what an event does to it, is the law's: `references.bistiffness_law` and `references.dashpot_law`.

**Frozen positions.** With `frozen` an OPEN contact does not move: it keeps p = 0, whatever gap or rest of a penetration
its bodies have, and carries force again at p' = 0, where they begin to approach. None is SLACK: one whose force falls
to zero is OPEN, what was left of its penetration forgotten. That is the law in the impulse space of the
state-transition model; the bistiffness law so frozen is, without gravity, that model in time.

Units and unknowns as in `references.taylor` and `references.ending`.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from impact_xval.compliant_baselines.contract.trajectory import FREE, GOING, STUCK
from impact_xval.compliant_baselines.references import bistiffness_law, dashpot_law
from impact_xval.compliant_baselines.references.bistiffness_law import as_one, becomes_rigid, stands_still
from impact_xval.compliant_baselines.references.contact_law import (
    BISTIFFNESS,
    COMPRESSION,
    END_OF_COMPRESSION,
    FORCE,
    GAP,
    HELD,
    HUNT_CROSSLEY,
    KELVIN_VOIGT,
    LIMIT,
    LOADED,
    NOTHING,
    OPEN,
    RATE,
    carries,
    event_of,
    part,
    state_of,
)
from impact_xval.compliant_baselines.references.ending import TOO_LONG, how_over, over_within, settled
from impact_xval.compliant_baselines.references.taylor import (
    D1,
    ORDER,
    P1,
    Q2,
    V2,
    evaluate,
    expand,
    expand_product,
    longest_step,
    trusted,
)
from impact_xval.model.chain.roots import first_root

#: What each law watches: by law, mode and what.
WATCHED = np.stack(
    [bistiffness_law.WATCHED, dashpot_law.KELVIN_VOIGT_WATCHED, dashpot_law.HUNT_CROSSLEY_WATCHED]
)

#: Rows of a table of coefficients beyond those of `taylor`: the force of each contact, up to a positive factor.
FORCES = 4
N_ROWS = 6

#: Segments without an event after which it is examined whether the balls of a drop only settle any more.
QUIET = 6

#: Columns of a log row, one row a segment: the state at its start, its length, and the event at its end, times 10, plus
#: its contact; k1, k2 the present stiffnesses, in use or not; g what gravity there is.
LOG_COLUMNS = ("time", "p1", "d1", "q2", "v2", "duration", "k1", "k2", "mode1", "mode2", "event", "g")
LOG_WIDTH = len(LOG_COLUMNS)


class Law(NamedTuple):
    """A contact law with its numbers for one collision, in scaled units, or for many: arrays (n,).

    Attributes
    ----------
    code : int
        `BISTIFFNESS`, `KELVIN_VOIGT` or `HUNT_CROSSLEY`.
    a1, a2
        What the law has of each contact: e, greater than 0; c per sqrt(k1 m1); or a times abs(v0). NaN or infinite:
        unrepresentable.
    cutoff : float
        Where a contact of the bistiffness law is taken for rigid.
    """

    code: int
    a1: Any
    a2: Any
    cutoff: float = inf

    @property
    def dampings(self) -> tuple[Any, Any]:
        """What the dashpots have of `a1` and `a2`: nothing, where there are none."""
        return (0.0, 0.0) if self.code == BISTIFFNESS else (self.a1, self.a2)


class Followed(NamedTuple):
    """How a collision went, in scaled units: numbers of one collision, or arrays (n,) of many.

    Attributes
    ----------
    v1, v2
        Velocities at the end, those of balls at rest as they are.
    end
        `FREE`, `REST`, `STUCK` or `TOO_LONG`; -1 of one among many: unrepresentable.
    sequence, n_states
        States two bits each, the last one lowest (S1 is 0), and how many; the sequence holds the last 32.
    n_events, n_steps
        Events and segments.
    duration, fall
        How long it took, and for how long of that gravity acted.
    limited
        Whether a contact became rigid, and a closed-form limit finished the collision.
    """

    v1: Any
    v2: Any
    end: Any
    sequence: Any
    n_states: Any
    n_events: Any
    n_steps: Any
    duration: Any
    fall: Any
    limited: Any


@part
def flight_time(p1, d1, p2, v2, g):
    """Bound the time until, while no contact carries force, a gap closes or a penetration is gone.

    Half as long again as that time, so that the event itself lies well inside; `inf` if there is none.
    """
    first = -p1 / d1 if p1 * d1 < 0 else inf
    height, second = -p2, inf
    if g > 0:
        square = v2 * v2 + 2 * g * height
        if height < 0 and v2 > 0:
            # Out of the table: at the surface, or at the top of a flight that never gets there.
            second = -2 * height / (v2 + sqrt(square)) if square > 0 else v2 / g
        elif height >= 0:
            root = sqrt(square)
            second = (v2 + root) / g if v2 > 0 else 2 * height / (root - v2) if height > 0 else 0.0
    elif height * v2 < 0:
        second = -height / v2
    return 1.5 * min(first, second)


@part
def fill_motion(table, degree, h, law, on1, on2, mu, k1, k2, c1, c2, r2, g):
    """Fill in the motion over a time h from the state in column 0; `on1`, `on2`: which contacts carry force."""
    k1, c1 = (k1, c1) if on1 else (0.0, 0.0)
    k2, c2 = (k2, c2) if on2 else (0.0, 0.0)
    carried = g if on2 else 0.0  # a contact 2 under force carries m2 g at q2 = 0
    if law == HUNT_CROSSLEY and (on1 or on2):
        expand_product(table, degree, h, mu, k1, k2, c1, c2, r2, carried, carried - g)
    else:
        expand(table, degree, h, mu, k1, k2, c1, c2, carried, carried - g)


@part
def begin_segment(table, law, mode1, mode2, mu, k1, k2, c1, c2, r2, g):
    """Fill in the motion: its length, its degree, and up to which part of the length it is trusted."""
    on1, on2 = carries(mode1), carries(mode2)
    h, degree = inf, ORDER
    if not on1 and not on2:
        h, degree = flight_time(table[P1, 0], table[D1, 0], table[Q2, 0] + r2, table[V2, 0], g), 2
    else:
        a1, b1 = (k1, c1) if on1 else (0.0, 0.0)
        a2, b2 = (k2, c2) if on2 else (0.0, 0.0)
        if law == HUNT_CROSSLEY:
            # A first guess, from the stiffness and the damping at this instant.
            a1, b1 = a1 * (1 + b1 * abs(table[D1, 0])), b1 * a1 * abs(table[P1, 0])
            a2, b2 = a2 * (1 + b2 * abs(table[V2, 0])), b2 * a2 * abs(table[Q2, 0] + r2)
        h = longest_step(mu, a1, a2, b1, b2)
    fill_motion(table, degree, h, law, on1, on2, mu, k1, k2, c1, c2, r2, g)
    return h, degree, trusted(table, degree) if law == HUNT_CROSSLEY and degree == ORDER else 1.0


@part
def first_event(table, degree, x, contact, law, mode, k, c, rest, frozen, spent):
    """First event of a contact up to x: when, and what; x and `NOTHING` if there is none.

    `rest` is p less the row of the table, `spent` whether the force is zero by the event that just happened.
    """
    position, rate, turn = (P1, D1, 1.0) if contact == 1 else (Q2, V2, -1.0)  # p1' = d1, p2' = -v2
    watched, what = WATCHED[law, HELD if frozen and mode == OPEN else mode], NOTHING
    if watched[FORCE] != 0:
        row, sign = FORCES + contact - 1, watched[FORCE]
        dashpot_law.fill_force(table, row, degree, law, position, rate, k, turn * c, rest)
        root = first_root(table, row, sign, 0.0 if spent else sign * table[row, 0], degree, x)
        if root <= x:
            x, what = root, FORCE
    if watched[GAP] != 0:
        sign = watched[GAP]
        root = first_root(table, position, sign, sign * (table[position, 0] + rest), degree, x)
        if root <= x:
            x, what = root, GAP
    if watched[RATE] != 0:
        sign = watched[RATE] * turn
        root = first_root(table, rate, sign, sign * table[rate, 0], degree, x)
        if root <= x:
            x, what = root, RATE
    return x, what


@part
def after_event(law, what, mode, k, q, rate, rest, a, frozen):
    """Mode, stiffness, q and rate of a contact after an event, and which event it was; a as for `collide`."""
    if what == GAP:
        q = 0.0 - rest
    elif what == RATE:
        rate = 0.0
    if law == BISTIFFNESS:
        after, k, q = bistiffness_law.change(mode, what, k, q, a)
    else:
        after = dashpot_law.change(mode, what, frozen or (law == KELVIN_VOIGT and a == 0))
        q = 0.0 - rest if after == OPEN else q
    return after, k, q, rate, event_of(mode, after)


@part
def write_row(log, n, time, state, duration, k1, k2, mode1, mode2, event, g):
    """Write row n of a log, if it has one."""
    if n < log.shape[0]:
        log[n, 0], log[n, 1], log[n, 2], log[n, 3], log[n, 4] = time, state[0], state[1], state[2], state[3]
        log[n, 5], log[n, 6], log[n, 7], log[n, 8], log[n, 9] = duration, k1, k2, mode1, mode2
        log[n, 10], log[n, 11] = event, g


@njit(cache=True, error_model="numpy")
def how_ended(law, mode1, mode2, mu, p1, d1, q2, v2, k1, k2, c1, c2, g, quiet, left):
    """How the collision ended, or `GOING`; for how many segments nothing happened, and how many are left."""
    on1, on2 = carries(mode1), carries(mode2)
    end = how_over(on1, on2, mu, p1, d1, q2, v2, k1, k2, g)
    if end == GOING and left <= 0:
        return TOO_LONG
    examined = law == KELVIN_VOIGT and g > 0 and quiet > 0 and quiet % QUIET == 0
    if end == GOING and examined and on1 and on2 and settled(mu, k2, c1, c2, g, p1, d1, q2, v2):
        return STUCK
    return end


@part
def end_of_segment(table, degree, x, law, mode1, mode2, mu, k1, k2, c1, c2, r2, g, frozen, spent):
    """When a segment ends, at most x, by which contact (0: neither) and what.

    `spent` is the contact whose force is zero by the event that just happened. In a drop, B2 at rest counts once B1 no
    longer approaches: then neither contact and `RATE`.
    """
    # Contacts and row are no literals: for each of them numba would compile a function of its own.
    x, what = first_event(table, degree, x, np.int64(1), law, mode1, k1, c1, 0.0, frozen, spent == 1)
    contact = 1 if what != NOTHING else 0
    x, what2 = first_event(table, degree, x, np.int64(2), law, mode2, k2, c2, r2, frozen, spent == 2)
    if what2 != NOTHING:
        contact, what = 2, what2
    if g > 0 and mode1 == OPEN and mode2 != OPEN and not frozen:
        d1 = table[D1, 0]
        sign = 1.0 if d1 > 0 or (d1 == 0 and table[D1, 1] > 0) else -1.0
        root = first_root(table, np.int64(D1), sign, sign * d1, degree, x)
        if root < x:
            x, contact, what = root, 0, RATE
    if g > 0 and x > 0 and law != BISTIFFNESS:
        stop = over_within(table, degree, x, carries(mode1), carries(mode2), mu, k1, k2, g)
        if stop < x:
            x, contact, what = stop, 0, NOTHING
    return x, contact, what


@njit(cache=True, error_model="numpy")
def collide(law, kappa, mu, a1, a2, g, cutoff, frozen, max_steps, log):
    r"""Follow one collision to its end.

    Parameters
    ----------
    law : int
        `BISTIFFNESS`, `KELVIN_VOIGT` or `HUNT_CROSSLEY`.
    kappa, mu : float
        k2/k1 and m2/m1, positive and finite.
    a1, a2 : float
        What the law has of each contact: e, greater than 0; c per sqrt(k1 m1); or a times \|v0\|.
    g : float
        Gravity; 0 is the scenario `impact`, anything else `drop`.
    cutoff : float
        Where a contact of the bistiffness law is taken for rigid; infinity for other laws.
    frozen : bool
        Whether an open contact returns as soon as its bodies approach.
    max_steps : int
        Segments after which the collision is given up.
    log : ndarray, shape (n, LOG_WIDTH)
        Filled with one row a segment (`LOG_COLUMNS`) and one for the end, as far as it goes.

    Returns
    -------
    Followed
    """
    table = np.empty((N_ROWS, ORDER + 1))
    c1, c2 = (0.0, 0.0) if law == BISTIFFNESS else (a1, a2)
    mode1 = mode2 = COMPRESSION if law == BISTIFFNESS else LOADED
    k1, k2, p1, d1, q2, v2 = 1.0, kappa, 0.0, 1.0, 0.0, 0.0
    time, fall, limited, spent = 0.0, np.inf, False, 0
    state, sequence, n_states, n_events, n, last = 1, np.uint64(0), 1, 0, 0, 0
    end = GOING
    while True:
        now = state_of(mode1, mode2)
        if now != state:
            state, sequence, n_states = now, (sequence << np.uint64(2)) | np.uint64(now - 1), n_states + 1
        if end == GOING:
            counts = n - last, max_steps - n
            end = how_ended(law, mode1, mode2, mu, p1, d1, q2, v2, k1, k2, c1, c2, g, *counts)
        if end != GOING:
            break
        if g > 0 and mode1 == OPEN and mode2 == OPEN:
            q2, g, fall = q2 + mu * g / k2, 0.0, time  # in flight: from here on the bodies no longer fall

        r2, column = mu * g / k2, (law, mode1, mode2, mu, k1, k2, c1, c2)
        table[P1, 0], table[D1, 0], table[Q2, 0], table[V2, 0] = p1, d1, q2, v2
        h, degree, x = begin_segment(table, *column, r2, g)
        x, contact, what = end_of_segment(table, degree, x, *column, r2, g, frozen, spent)
        if x < 0:
            end = TOO_LONG  # numbers beyond what can be certified
            break
        write_row(log, n, time, (p1, d1, q2, v2), x * h, k1, k2, mode1, mode2, 0, g)
        p1, d1, q2, v2 = evaluate(table, degree, x)
        p1, d1 = (0.0, min(d1, 0.0)) if frozen and mode1 == OPEN else (p1, d1)
        q2, v2 = (-r2, max(v2, 0.0)) if frozen and mode2 == OPEN else (q2, v2)
        time, event = time + x * h, 0
        if contact == 1:
            mode1, k1, p1, d1, event = after_event(law, what, mode1, k1, p1, d1, 0.0, a1, frozen)
        elif contact == 2:
            mode2, k2, q2, v2, event = after_event(law, what, mode2, k2, q2, v2, r2, a2, frozen)
        elif what == RATE:
            d1 = 0.0
        if event > 0 and n < log.shape[0]:
            log[n, 10] = event * 10 + contact
        spent, n = (contact if what == FORCE else 0), n + 1
        n_events, last = (n_events + 1, n) if event > 0 else (n_events, last)

        if event == END_OF_COMPRESSION and becomes_rigid(
            contact, mode1, mode2, mu, p1, d1, q2, v2, k1, k2, cutoff, g
        ):
            entry = p1, d1, q2, v2
            d1, v2, wait, end = as_one(contact, mu, p1, d1, q2, v2, k1, k2, a1, a2, mode1, mode2, g)
            write_row(log, n, time, entry, wait, k1, k2, mode1, mode2, LIMIT * 10, g)
            time, limited, mode1, mode2, p1, q2, n = time + wait, True, OPEN, OPEN, 0.0, -mu * g / k2, n + 1
        if k1 > cutoff and k2 > cutoff * kappa and stands_still(mu, p1, d1, q2 + mu * g / k2, v2, k1, k2, g):
            d1, v2, limited = 0.0, 0.0, True
            end = STUCK if g > 0 else FREE

    write_row(log, n, time, (p1, d1, q2, v2), 0.0, k1, k2, mode1, mode2, 0, g)
    if state != 4:
        sequence, n_states = (sequence << np.uint64(2)) | np.uint64(3), n_states + 1
    return Followed(v2 - d1, v2, end, sequence, n_states, n_events, n, time, min(fall, time), limited)


@njit(cache=True, nogil=True, error_model="numpy")
def follow_all(
    v1, v2, end, sequence, n_states, n_events, n_steps, duration, fall, limited,
    law, kappa, mu, a1, a2, g, cutoff, frozen, max_steps,
):  # fmt: skip
    """Follow many collisions, those with finite parameters and k2/k1 > 0, into arrays (n,) of `Followed`.

    Not a loop that numba shares out to threads: compiling one takes four times as long. It holds no lock of Python, so
    that threads can be given parts of the arrays.
    """
    no_log = np.empty((0, LOG_WIDTH))
    for i in range(kappa.size):
        if 0 < kappa[i] < np.inf and a1[i] < np.inf and a2[i] < np.inf:
            one = collide(law, kappa[i], mu[i], a1[i], a2[i], g[i], cutoff, frozen, max_steps, no_log)
            v1[i], v2[i], end[i], sequence[i] = one.v1, one.v2, one.end, one.sequence
            n_states[i], n_events[i], n_steps[i] = one.n_states, one.n_events, one.n_steps
            duration[i], fall[i], limited[i] = one.duration, one.fall, one.limited
