"""Search for the first event of a window of a chain.

An event is a zero of a watched function of a contact, such as its force or its rate of compression (`chain.laws`).
`first_event` searches all watched functions of all contacts. `first_zero` finds the first zero of one function, by
`chain.roots.first_root`. For a power law such as Hertz's the polynomials of a window only approximate the motion, so
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
    """First event of a window, or no event.

    A window is a time over which polynomials give the motion.
    """

    #: Number of the contact, from 0; -1 if the window has no event.
    contact: int
    #: The function that is zero at the event, one of `Watched`.
    watched: int
    #: Sign of this function before the event.
    sign: float
    #: Time of the event, divided by the length of the window. Infinite if the window has no event; -1 if the search was
    #: given up.
    x: float


@kernel_helper
def upper_ball_may_settle(c, n, i, watched):
    """Return whether `watched` is the function that shows when ball B1 of a drop ceases to approach B2, and is needed.

    It is needed while B1 flies freely and B2 touches the table. B2 may settle as soon as B1 no longer approaches it.
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
    """Return 1 if the bodies of a contact approach, or will approach at once; else -1."""
    w = scratch.rates[0]
    approaches = w > 0 or (w == 0 and scratch.rates[1] > 0)
    return 1.0 if approaches else -1.0


@kernel_helper
def watched_sign(c, n, i, watched, work):
    """Return the sign that the function `watched` of contact i keeps until its event; 0 if it is not watched now."""
    if upper_ball_may_settle(c, n, i, watched):
        return sign_of_approach(work[i])
    contact = c[i]
    is_held = contact.frozen and contact.phase == Phase.INACTIVE
    phase = Phase.HELD if is_held else contact.phase
    return WATCHED[contact.law, phase, watched]


@kernel_helper
def write_force_series(contact, scratch):
    """Write the power series of a function that has the sign of the force of a contact with a dashpot.

    The force is taken before it is cut off at zero. For Hunt-Crossley's law the function is 1 + b w; for other laws it
    is the force itself.
    """
    is_product, k, b = contact.law == Law.HUNT_CROSSLEY, contact.k, contact.b
    for j in range(ORDER + 1):
        damping = b * scratch.rates[j]
        scratch.watched[j] = damping if is_product else damping + k * scratch.deltas[j]
    scratch.watched[0] += 1.0 if is_product else k * equilibrium_depth(contact)


@kernel_helper
def first_zero(contact, scratch, watched, sign, h, latest):
    """Return the place x = t/h of the first zero of a watched function of a contact, if it is before `latest`.

    `sign` is the sign that the function has before its zero. The result is infinite if there is no zero, 0 if the
    function leaves this sign at once, and -1 if the search was given up.
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
        # The contact carries no force yet. The polynomial does not show how its force begins, but it can only press.
        rises = table[3] + table[4] + table[5] > 0
        return 0.0 if sign < 0 and rises else inf
    return first_root(table, sign, start, ORDER if is_series else ORDER_OF_STEP, latest)


@kernel_helper
def first_event(c, n, h, work):
    """Return the first event of a window of length h. `work` holds the polynomials of the window."""
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
