"""The first event of a window: which contact, which watched function, and when.

`first_event` looks at all watched functions of all contacts; `first_zero` finds the first zero of one of them with
`chain.roots.first_root`. In a step of a power law the polynomials only approximate the motion, so
`chain.power_law.refine_event` refines the event afterwards.

Needs `chain.laws` for the watched functions. Used by `chain.kernel`.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from impact_xval.model.chain.laws import (
    WATCHED,
    Law,
    Watched,
    equilibrium_depth,
    has_series,
    is_active,
)
from impact_xval.model.chain.power_law import ORDER_OF_STEP, interpolate_force
from impact_xval.model.chain.roots import first_root
from impact_xval.model.chain.series import ORDER
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.pair.law import Phase


class Event(NamedTuple):
    """First event of a window."""

    #: Contact, -1 for none.
    contact: int
    #: The watched function that is zero at the event, one of `Watched`, and its sign before the event.
    watched: int
    sign: float
    #: Time of the event over the length of the window; infinite without an event, -1 where the search was given up.
    x: float


@kernel_helper
def upper_ball_may_settle(c, n, i, watched):
    """Return whether the end of B1's approach to B2 is watched: B1 flies freely, and the table holds B2.

    B2 may settle as soon as B1 no longer approaches.
    """
    return (
        watched == Watched.TURN
        and i == 0
        and n == 2
        and c[1].g > 0
        and c[0].phase == Phase.INACTIVE
        and not c[0].frozen
        and is_active(c[1])
    )


@kernel_helper
def sign_of_approach(scratch):
    """Return 1 if the bodies of a contact approach or begin to approach; else -1."""
    w = scratch.rates[0]
    approaches = w > 0 or (w == 0 and scratch.rates[1] > 0)
    return 1.0 if approaches else -1.0


@kernel_helper
def watched_sign(c, n, i, watched, work):
    """Return the sign that a watched function of contact i has until its event; 0 if it is not watched."""
    if upper_ball_may_settle(c, n, i, watched):
        return sign_of_approach(work[i])
    contact = c[i]
    is_held = contact.frozen and contact.phase == Phase.INACTIVE
    phase = Phase.HELD if is_held else contact.phase
    return WATCHED[contact.law, phase, watched]


@kernel_helper
def write_force_series(contact, scratch):
    """Write the series of a dashpot's force before the force is cut off at zero, up to a positive factor."""
    is_product, k, b = contact.law == Law.HUNT_CROSSLEY, contact.k, contact.b
    for j in range(ORDER + 1):
        damping = b * scratch.rates[j]
        scratch.watched[j] = damping if is_product else damping + k * scratch.deltas[j]
    scratch.watched[0] += 1.0 if is_product else k * equilibrium_depth(contact)


@kernel_helper
def first_zero(contact, scratch, watched, sign, h, latest):
    """Return x = t/h of the first zero of a watched function before x = `latest`.

    Infinity, 0 and -1 mean the same as in `chain.roots.first_root`.
    """
    is_series = has_series(contact)
    table = scratch.rates
    if watched == Watched.FORCE:
        if is_series:
            write_force_series(contact, scratch)
        else:
            interpolate_force(contact, h, scratch)
        table = scratch.watched
        start = 0.0 if scratch.force_is_zero else sign * table[0]
    elif watched == Watched.GAP:
        table = scratch.deltas
        start = sign * (table[0] + equilibrium_depth(contact))
    else:
        start = sign * table[0]
    at_rest = not is_series and scratch.w == 0 and scratch.delta == 0
    if at_rest and (watched == Watched.FORCE or scratch.kw[0] == 0):
        # The contact is not pressed yet. The polynomial does not show how its load begins, but a load can only press.
        rises = table[3] + table[4] + table[5] > 0
        return 0.0 if sign < 0 and rises else inf
    return first_root(table, sign, start, ORDER if is_series else ORDER_OF_STEP, latest)


@kernel_helper
def first_event(c, n, h, work):
    """Return the first event of a window of length h."""
    first_contact, first_watched, first_sign, first_x = -1, 0, 0.0, inf
    for i in range(n):
        for watched in range(4):
            sign = watched_sign(c, n, i, watched, work)
            if sign == 0 or work[i].ruled_out[watched] == 1:
                continue
            x = first_zero(c[i], work[i], watched, sign, h, min(first_x, 1.0))
            if x < first_x:
                first_contact, first_watched, first_sign, first_x = i, watched, sign, x
    return Event(first_contact, first_watched, first_sign, first_x)
