"""A column of N balls by a contact law in time, with positions, event by event.

The states of a contact, what is watched of each, and what an event does are those of two balls (`references.driver`):
the bistiffness law by `model.columns.diagram`, where a contact that has opened returns when its gap has closed;
dashpots by `references.dashpot_law`. A contact that carries force has a phase other than `INACTIVE`; one that does not
is slack while its bodies overlap, and open else.

With `frozen` positions no contact has a gap or is slack: one whose force has ended keeps delta = 0 and carries force
again where its bodies begin to approach. The bistiffness law so frozen is the model.

The collision is over when no contact carries force and none will: no bodies approach. Events at one instant are applied
one after the other; each changes only its own contact, and no rate.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.references import dashpot_law
from impact_xval.compliant_baselines.references.columns.motion import (
    ORDER_OF_STEP,
    advance,
    expand,
    is_linear,
    new_workspace,
    settle,
    step,
    watch,
)
from impact_xval.compliant_baselines.references.contact_law import (
    BISTIFFNESS,
    COMPRESSION_DASHPOT,
    FORCE,
    GAP,
    HELD,
    KELVIN_VOIGT,
    LOADED,
    OPEN,
    RATE,
    SLACK,
    carries,
)
from impact_xval.compliant_baselines.references.contact_law import COMPRESSION as COMPRESSES
from impact_xval.compliant_baselines.references.contact_law import RESTITUTION as RESTORES
from impact_xval.compliant_baselines.references.driver import WATCHED
from impact_xval.model.columns.chain import NOTHING, NOTHING_OF_STEPS, ball_values, still
from impact_xval.model.columns.diagram import (
    FIRST_STEP,
    TOO_MANY_EVENTS,
    apply_event,
    near_misses,
    write_path,
)
from impact_xval.model.columns.roots import first_root
from impact_xval.model.columns.series import ORDER, evaluate
from impact_xval.model.columns.solving import chain_of
from impact_xval.model.compiled import compiled, inlined
from impact_xval.model.law import COMPRESSION, INACTIVE, RESTITUTION

#: A contact of spring and dashpot that has less than this share of the energy of impact is at rest. Far ahead of a wave
#: its load underflows, and rounding would open and close it for ever; at this share it moves no bit of any other.
UNDERFLOW = 1e-150


@inlined
def mode_of(law, c, i, frozen):
    """Mode of contact i, as the two-ball references name it."""
    if frozen and c.phase[i] == INACTIVE:
        return HELD
    if law in (BISTIFFNESS, COMPRESSION_DASHPOT):
        return COMPRESSES if c.phase[i] == COMPRESSION else RESTORES if c.phase[i] == RESTITUTION else OPEN
    if c.phase[i] != INACTIVE:
        return LOADED
    return SLACK if c.delta[i] > 0 else OPEN


@compiled
def touch(c, n, gaps):
    """Let every closed contact act that approaches, or is at rest in a row of closed contacts beside one that does."""
    for i in range(n):
        c.delta[i] = -gaps[i]
        c.phase[i] = COMPRESSION if c.w[i] > 0 and gaps[i] == 0 else INACTIVE
    for i in range(1, n):
        if c.w[i] == 0 and gaps[i] == 0 and c.phase[i - 1] == COMPRESSION:
            c.phase[i] = COMPRESSION
    for i in range(n - 2, -1, -1):
        if c.w[i] == 0 and gaps[i] == 0 and c.phase[i + 1] == COMPRESSION:
            c.phase[i] = COMPRESSION


class Marks(NamedTuple):
    """What is noted of each contact.

    Attributes
    ----------
    modes : ndarray of int, shape (C,)
        Modes at the start of a piece.
    cut : ndarray of bool, shape (C,)
        Whose force is zero by an event of this instant.
    left_out : ndarray of bool, shape (C, 3)
        What is not looked at, since it was seen not to happen in this piece.
    """

    modes: NDArray[np.int64]
    cut: NDArray[np.bool_]
    left_out: NDArray[np.bool_]


@compiled
def first_event(law, c, b, n, h, marks, work):
    """Find the first event of a piece: the contact (-1: none), what, its sign, and the time per h."""
    first, which, happens, its_sign = inf, -1, FORCE, 0.0
    for i in range(n):
        for what in (FORCE, GAP, RATE):
            sign = WATCHED[law, marks.modes[i], what]
            if sign == 0 or marks.left_out[i, what]:
                continue
            order = watch(law, c, b, i, what, h, work)
            f = work.watched
            if what == FORCE and marks.cut[i]:
                f[0] = 0.0
            if order == ORDER_OF_STEP and work.w[i] == 0 and work.delta[i] == 0:
                # At rest: a cubic knows nothing of how its load begins, but it can only be pressed.
                x = 0.0 if sign < 0 and f[1] + f[2] + f[3] + f[4] + f[5] > 0 else inf
            else:
                x = first_root(f, order, sign, min(first, 1.0))
            if x < first:
                first, which, happens, its_sign = x, i, what, sign
    return which, happens, its_sign, first


@compiled
def dashpot_event(law, c, b, i, mode, what, frozen):
    """Apply an event of a contact of spring and dashpot."""
    if law == COMPRESSION_DASHPOT:
        after = dashpot_law.change_of_compression(mode, what)
    else:
        after = dashpot_law.change(mode, what, frozen or (law == KELVIN_VOIGT and b[i] == 0))
    if what == GAP or after == OPEN:
        c.delta[i] = 0.0
    elif what == RATE:
        c.w[i] = 0.0
    c.phase[i] = RESTITUTION if after == RESTORES else COMPRESSION if carries(after) else INACTIVE


@compiled
def flight(c, n):
    """Time until the first gap closes while no contact carries force, and of which contact; -1 if none will.

    A contact at rest that acts carries none.
    """
    first, which = inf, -1
    for i in range(n):
        if c.phase[i] != INACTIVE and (c.delta[i] > 0 or c.w[i] != 0):
            return 0.0, n
        if c.w[i] > 0 and max(0.0, -c.delta[i] / c.w[i]) < first:
            first, which = max(0.0, -c.delta[i] / c.w[i]), i
    return first, which


@compiled
def follow(law, c, b, n, h_next, tolerance, marks, work):
    """Follow a piece up to its first event.

    Returns
    -------
    h, h_next : float
        Length of the piece, and of the step to try next.
    which, what : int
        The contact whose event it was (-1: none), and what.
    x : float
        When, per h; 1 without an event.
    """
    if is_linear(law, c):
        h = expand(c, b, n, work)
    else:
        h, h_next = advance(law, c, b, n, h_next, tolerance, work)
    marks.left_out[:] = False
    which, what, sign, x = first_event(law, c, b, n, h, marks, work)
    if is_linear(law, c):
        evaluate(work.rates, ORDER, n, min(x, 1.0), c.w)
        evaluate(work.deltas, ORDER, n, min(x, 1.0), c.delta)
        return h, h_next, which, what, min(x, 1.0)
    while which >= 0:
        x, happened = settle(law, c, b, n, h, x, which, what, sign, work)
        if happened:
            break
        marks.left_out[which, what] = True
        step(law, c, b, n, h, work)
        which, what, sign, x = first_event(law, c, b, n, h, marks, work)
    return h, h_next, which, what, min(x, 1.0)


@compiled
def apply_law(law, c, b, n, which, what, frozen, marks, nothing, code):
    """Apply the law to a contact at an event: contacts left, code."""
    if law != BISTIFFNESS:
        dashpot_event(law, c, b, which, marks.modes[which], what, frozen)
        marks.cut[which] = what == FORCE
    elif marks.modes[which] == OPEN or marks.modes[which] == HELD:
        c.phase[which], c.delta[which] = COMPRESSION, 0.0
    else:
        n, _, code = apply_event(c, n, which, what == GAP, True, nothing, 0.0, code)
    return n, code


@compiled
def collide(law, scaled, gaps, b, p, frozen, tolerance, max_steps, points, log):
    """Follow one column to its end.

    Parameters
    ----------
    law : int
        `BISTIFFNESS`, `KELVIN_VOIGT`, `HUNT_CROSSLEY` or `COMPRESSION_DASHPOT`.
    scaled : tuple
        The column, as of `model.columns.solving.scaled_column`.
    gaps, b : ndarray, shape (C,)
        Gaps at first, and c or a of each contact, in the units of `scaled`.
    p : float
        Exponent of the springs.
    frozen : bool
        Whether a contact that carries no force returns as soon as its bodies approach.
    tolerance : float
        Error of a step, where steps are taken.
    max_steps : int
        Pieces of segments after which the column is given up.
    points, log
        As for `model.columns.diagram.collide`.

    Returns
    -------
    velocities : ndarray, shape (N,)
    code, events : int
        How it ended, as bits of `model.columns.diagram`; number of events.
    margin : float
        Grazing margin under the bistiffness law, infinite under others.
    time : float
        Duration.
    rows : int
        Of the log, had it room for all.
    """
    c, energy = chain_of(scaled, p)
    n, drift = gaps.size, scaled[-1]
    nothing = UNDERFLOW * energy
    if law == BISTIFFNESS:
        nothing = (NOTHING if is_linear(law, c) else NOTHING_OF_STEPS) * energy
    work = new_workspace(n)
    marks = Marks(np.zeros(n, np.int64), np.zeros(n, np.bool_), np.zeros((n, 3), np.bool_))
    velocities = np.empty(c.body.size)
    code, events, rows, time, h_next, margin = 0, 0, 0, 0.0, FIRST_STEP, inf
    touch(c, n, gaps)
    for _ in range(max_steps):
        h, which = flight(c, n)
        if which < 0:
            ball_values(c, n, c.w, drift, velocities)
            return velocities, code, events, margin, time, rows
        for i in range(n):
            marks.modes[i] = mode_of(law, c, i, frozen)
        what, x, order = RATE if frozen else GAP, 1.0, 0
        if which < n:
            for i in range(n):
                work.rates[0, i] = c.w[i]
                c.delta[i] += h * c.w[i]
        else:
            order = ORDER if is_linear(law, c) else ORDER_OF_STEP
            h, h_next, which, what, x = follow(law, c, b, n, h_next, tolerance, marks, work)
            if h == 0:
                break  # slopes lie beyond double precision
            if law == BISTIFFNESS:
                margin = near_misses(c, n, order, work.rates, x, energy, margin)
        if x > 0:
            marks.cut[:] = False
            rows = write_path(c, n, order, work.rates, x, h, time, drift, points, log, rows)
        time += x * h
        if which >= 0:
            events += 1
            n, code = apply_law(law, c, b, n, which, what, frozen, marks, nothing, code)
        if frozen:
            for i in range(n):
                if c.phase[i] == INACTIVE:
                    c.delta[i] = 0.0
        still(c, n, nothing)
    return velocities, code | TOO_MANY_EVENTS, events, margin, time, rows
