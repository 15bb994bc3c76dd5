"""Motion of two balls while a single contact is active: in S2, in S3, and in S1 if a contact is rigid.

`lone_contact` returns which contact is active, and against which mass it works. `pair.motion.follow_single_contact`
computes its motion. `after_lone_contact` returns the state of both balls after the motion.

Units as in `pair.motion`. Needs `pair.law` and `pair.limits`. Used by `pair.kernel`.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

from impact_xval.model.compiled import force_inlined
from impact_xval.model.pair.law import (
    Contact,
    Pair,
    Phase,
    end_of_compression,
    end_of_restitution,
    reactivate,
    restart,
    with_energy,
)
from impact_xval.model.pair.limits import Rigid, view_from
from impact_xval.model.pair.record import State


class LoneContact(NamedTuple):
    """The only active contact during a segment in which the other contact is inactive or rigid."""

    #: True for contact 1, between the balls; False for contact 2, between ball 2 and the table.
    is_ball_ball: bool
    #: Whether the other contact is rigid. Its bodies then move as one body.
    united: bool
    contact: Contact
    #: Mass that the contact works against.
    mass: float
    #: Rate of compression of the contact.
    rate: float
    #: Impulse of the active contact at which the other contact becomes active again; infinite if it never does.
    impulse_to_return: float


@force_inlined
def lone_contact(pair, mu, M, state, rigid, highest):
    """Return the single active contact in S2, in S3, or in S1 if a contact is rigid.

    If the rigid contact has enough energy to part its bodies, it is the active contact and completes its impact.
    Otherwise its bodies move as one body, and the other contact works against this body until the end of the collision
    (`pair.limits`).
    """
    if rigid == Rigid.NONE:
        if state == State.S3:
            return LoneContact(True, False, pair.contact1, M, pair.d1, max(0.0, mu * pair.v2))
        return LoneContact(False, False, pair.contact2, mu, -pair.v2, max(0.0, -mu * pair.d1))
    stiff_is_1 = rigid == Rigid.CONTACT1
    view = view_from(stiff_is_1, pair, mu, M)
    # The part F F_s/k of the stiff contact's energy cannot part its bodies: the contact needs it to pass on the force
    # F_s of the soft contact.
    passing_on = 2 * sqrt(pair.contact1.E * pair.contact2.E * (view.soft.k / view.stiff.k)) * view.share
    E = view.stiff.E - passing_on
    parts_bodies = view.rate * view.rate + 2 * E / view.mass > 1 / highest
    if parts_bodies:
        return LoneContact(stiff_is_1, False, with_energy(view.stiff, E), view.mass, view.rate, inf)
    united_rate = view.soft_rate + view.rate * view.share
    return LoneContact(not stiff_is_1, True, view.soft, view.united_mass, united_rate, inf)


@force_inlined
def after_lone_contact(pair, lone, leaving, mu, state, stiffens, rigid):
    """Return both balls and contacts after a segment with a single active contact.

    `pair` is the state at the start of the segment, and `leaving` describes its end.
    """
    c, loss = lone.contact, pair.loss
    if leaving.compression_ended:
        at_maximum = with_energy(c, c.E + 0.5 * lone.mass * lone.rate * lone.rate)
        c, loss = end_of_compression(at_maximum, loss)
    other_contact = pair.contact2 if lone.is_ball_ball else pair.contact1
    if leaving.returns:
        E = leaving.energy
        c = Contact(c.phase, c.k, E, sqrt(2 * c.k * E), c.e, c.original)
        d1, v2, other_contact = after_return(pair, lone, leaving, other_contact, stiffens)
    elif lone.united:
        # The bodies of the rigid contact stay together: both balls as one body, or B2 on the table.
        c, other_contact = end_of_restitution(c), end_of_restitution(other_contact)
        d1 = leaving.rate if lone.is_ball_ball else 0.0
        v2 = 0.0 if lone.is_ball_ball else -leaving.rate
    else:
        c = end_of_restitution(c)
        d1, v2, other_contact, loss = after_parting(
            pair, lone, leaving, other_contact, mu, state, stiffens, rigid, loss
        )
    contact1, contact2 = (c, other_contact) if lone.is_ball_ball else (other_contact, c)
    return Pair(d1, v2, contact1, contact2, loss)


@force_inlined
def after_return(pair, lone, leaving, other_contact, stiffens):
    """Return the rates d1 and v2 and the other contact, after the other contact has become active again.

    It begins in compression, with a rate of compression of zero.
    """
    other_contact = reactivate(stiffens, other_contact)
    if lone.is_ball_ball:
        return leaving.rate, 0.0, other_contact
    return 0.0, pair.v2 - pair.d1, other_contact  # v1 has not changed, and v2 now equals v1


@force_inlined
def after_parting(pair, lone, leaving, other_contact, mu, state, stiffens, rigid, loss):
    """Return the rates d1 and v2, the other contact and the lost energy, after the active contact ended restitution.

    If the active contact is rigid, it has completed its impact in no time, while the force of the other contact stayed
    the same. If the other contact was in restitution and its bodies now approach, its compression restarts.
    """
    if lone.is_ball_ball:
        d1, v2 = leaving.rate, pair.v2 - leaving.impulse / mu
        v2 = max(0.0, v2) if state == State.S3 else v2  # in S3 rounding must not make B2 approach the table
        compresses = -v2 > 0
    else:
        d1, v2 = pair.d1 - (pair.v2 + leaving.rate), -leaving.rate
        compresses = d1 > 0
    if rigid != Rigid.NONE and other_contact.phase == Phase.RESTITUTION and compresses:
        other_contact, loss = restart(stiffens, other_contact, loss)
    return d1, v2, other_contact, loss
