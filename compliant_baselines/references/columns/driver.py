"""A column of N balls by a contact law in time, with positions, event by event.

The states of a contact, what is watched of each, and what an event does are those of two balls (`references.driver`):
the bistiffness law by `model.columns.diagram`, where a contact that has opened returns when its gap has closed;
dashpots by `references.dashpot_law`. A contact that carries force has a phase other than `INACTIVE`; one that does not
is slack while its bodies overlap, and open else.

The collision is over when no contact carries force and none will: no bodies approach. Events at one instant are applied
one after the other; each changes only its own contact, and no rate.
"""

from __future__ import annotations

from math import inf

import numpy as np

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
    FORCE,
    GAP,
    KELVIN_VOIGT,
    LOADED,
    OPEN,
    RATE,
    SLACK,
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


@inlined
def mode_of(law, c, i):
    """Mode of contact i, as the two-ball references name it."""
    if law == BISTIFFNESS:
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


@compiled
def first_event(law, c, b, n, h, modes, cut, left_out, work):
    """First event of a piece: the contact (-1: none), what, its sign, and the time per h.

    `modes` are those at the start of the piece, `cut` tells whose force is zero then by an event of this instant, and
    `left_out` what of which contact is not looked at.
    """
    first, which, happens, its_sign = inf, -1, FORCE, 0.0
    for i in range(n):
        for what in (FORCE, GAP, RATE):
            sign = WATCHED[law, modes[i], what]
            if sign == 0 or left_out[i, what]:
                continue
            order = watch(law, c, b, i, what, h, work)
            f = work.watched
            if what == FORCE and cut[i]:
                f[0] = 0.0
            if order == ORDER_OF_STEP and f[0] == 0 and f[1] == 0:
                # At rest and not yet pressed: a cubic knows nothing of how it begins, but it can only be pressed.
                x = 0.0 if sign < 0 and f[2] + f[3] + f[4] + f[5] > 0 else inf
            else:
                x = first_root(f, order, sign, min(first, 1.0))
            if x < first:
                first, which, happens, its_sign = x, i, what, sign
    return which, happens, its_sign, first


@compiled
def dashpot_event(c, b, i, mode, what, law):
    """Apply an event of a contact of spring and dashpot."""
    after = dashpot_law.change(mode, what, law == KELVIN_VOIGT and b[i] == 0)
    if what == GAP or after == OPEN:
        c.delta[i] = 0.0
    c.phase[i] = COMPRESSION if after == LOADED else INACTIVE


@compiled
def flight(c, n):
    """Time until the first gap closes while no contact carries force, and of which contact; -1 if none will."""
    first, which = inf, -1
    for i in range(n):
        if c.phase[i] != INACTIVE:
            return 0.0, n
        if c.w[i] > 0 and max(0.0, -c.delta[i] / c.w[i]) < first:
            first, which = max(0.0, -c.delta[i] / c.w[i]), i
    return first, which


@compiled
def collide(law, scaled, gaps, b, p, tolerance, max_steps, points, log):
    """Follow one column to its end.

    Parameters
    ----------
    law : int
        `BISTIFFNESS`, `KELVIN_VOIGT` or `HUNT_CROSSLEY`.
    scaled : tuple
        The column, as of `model.columns.solving.scaled_column`.
    gaps, b : ndarray, shape (C,)
        Gaps at first, and c or a of each contact, in the units of `scaled`.
    p : float
        Exponent of the springs.
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
    linear = is_linear(law, c)
    order = ORDER if linear else ORDER_OF_STEP
    nothing = (NOTHING if linear else NOTHING_OF_STEPS) * energy
    work, modes, cut = new_workspace(n), np.zeros(n, np.int64), np.zeros(n, np.bool_)
    left_out = np.zeros((n, 3), np.bool_)
    code, events, rows, time, h_next, loss, margin = 0, 0, 0, 0.0, FIRST_STEP, 0.0, inf
    touch(c, n, gaps)
    for _ in range(max_steps):
        h, which = flight(c, n)
        if which < 0:
            velocities = np.empty(c.body.size)
            ball_values(c, n, c.w, drift, velocities)
            return velocities, code, events, margin, time, rows
        for i in range(n):
            modes[i] = mode_of(law, c, i)
        what, sign, x, degree = GAP, 0.0, 1.0, order
        if which < n:
            degree = 0
            for i in range(n):
                work.rates[0, i] = c.w[i]
                c.delta[i] += h * c.w[i]
        else:
            if linear:
                h = expand(c, b, n, work)
            else:
                h, h_next = advance(law, c, b, n, h_next, tolerance, work)
            left_out[:] = False
            which, what, sign, x = first_event(law, c, b, n, h, modes, cut, left_out, work)
            if linear:
                x = min(x, 1.0)
                evaluate(work.rates, order, n, x, c.w)
                evaluate(work.deltas, order, n, x, c.delta)
            while not linear and which >= 0:
                x, happened = settle(law, c, b, n, h, x, which, what, sign, work)
                if happened:
                    break
                left_out[which, what] = True
                step(law, c, b, n, h, work)
                which, what, sign, x = first_event(law, c, b, n, h, modes, cut, left_out, work)
            x = min(x, 1.0)
            if law == BISTIFFNESS:
                margin = near_misses(c, n, order, work.rates, x, energy, margin)
        if x > 0:
            cut[:] = False
            rows = write_path(c, n, degree, work.rates, x, h, time, drift, points, log, rows)
        time += x * h
        if which >= 0:
            events += 1
            if law != BISTIFFNESS:
                dashpot_event(c, b, which, modes[which], what, law)
                cut[which] = what == FORCE
            elif modes[which] == OPEN:
                c.phase[which], c.delta[which] = COMPRESSION, 0.0
            else:
                n, loss, code = apply_event(c, n, which, what == GAP, True, nothing, loss, code)
        if law == BISTIFFNESS:
            still(c, n, nothing)
    velocities = np.empty(c.body.size)
    return velocities, code | TOO_MANY_EVENTS, events, margin, time, rows
