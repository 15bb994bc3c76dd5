"""The contact laws as data: what is watched of a contact in each phase, and what an event does to it.

| law | force of a contact that acts | memory |
|---|---|---|
| `STATE_TRANSITION` | F = k delta^p | an end of compression stiffens it: E <- e^2 E, F stays |
| `LIU_ZHAO_BROGLIATO` | F = k delta^p | the same, but each compression runs at the original k |
| `KELVIN_VOIGT` | F = k delta^p + b delta^((p - 1)/2) delta' | none |
| `HUNT_CROSSLEY` | F = k delta^p (1 + b delta') | none |
| `COMPRESSION_DASHPOT` | that of `KELVIN_VOIGT` while delta' > 0, else k delta^p | none |

A contact is INACTIVE while it carries no force. With frozen positions, as in the model, it keeps delta = 0 and returns
where its bodies begin to approach; with positions it returns where its gap has closed. The first law with positions is
*bistiffness*: an end of compression moves the point of zero force by (1 - e^2) delta into the contact, for good, so
that a contact that ends restitution opens with a gap of exactly zero.

With gravity the lower ball of a drop has settled on the table: its contact counts delta from there, so that the weight
need not cancel to rounding (`rest`). An end of compression takes 1 - e^2 of all its strain energy, weight included.

A dashpot pushes from first touch, and its force is spent before its bodies are apart: the contact is SLACK while they
overlap without force, and is loaded again if a neighbour pushes them together. Without damping it is never slack.

Nor is a contact whose dashpot acts in compression only: there delta' = 0 at both ends of the dashpot's action, so that
the force is continuous, and while the bodies part it is the spring's, which lasts as long as they overlap.
"""

from __future__ import annotations

import numpy as np

from impact_xval.model.compiled import uncounted
from impact_xval.model.pair.law import COMPRESSION, INACTIVE, RESTITUTION

STATE_TRANSITION, LIU_ZHAO_BROGLIATO, KELVIN_VOIGT, HUNT_CROSSLEY, COMPRESSION_DASHPOT = 0, 1, 2, 3, 4

#: Phases beside those of the impact law; a dashpot that acts is in COMPRESSION. HELD is the row of an INACTIVE contact
#: in `WATCHED` where positions are frozen.
SLACK, HELD = 3, 4

#: What may be watched of a contact: the sign of its force before that is cut off at zero, its deformation, its rate;
#: and the rate of one that does not act, whose zero is no event of its own.
FORCE, GAP, RATE, TURN = 0, 1, 2, 3

#: The sign that what is watched has until its event, by law, phase and what; 0 where it is not watched.
WATCHED = np.zeros((5, 5, 4))
WATCHED[:, INACTIVE, GAP] = WATCHED[:, HELD, RATE] = -1
_TURNING, _CUT = [STATE_TRANSITION, LIU_ZHAO_BROGLIATO, COMPRESSION_DASHPOT], [KELVIN_VOIGT, HUNT_CROSSLEY]
WATCHED[_TURNING, COMPRESSION, RATE] = 1
WATCHED[_TURNING, RESTITUTION, GAP], WATCHED[_TURNING, RESTITUTION, RATE] = 1, -1
WATCHED[_CUT, COMPRESSION, FORCE] = 1
WATCHED[_CUT, SLACK, FORCE], WATCHED[_CUT, SLACK, GAP] = -1, 1
WATCHED[HUNT_CROSSLEY, COMPRESSION, GAP] = 1


@uncounted
def carries(one):
    """Whether a contact carries force."""
    return INACTIVE < one.phase < SLACK


@uncounted
def has_dashpot(one):
    """Whether forces depend on rates, and contacts have no memory."""
    return one.law >= KELVIN_VOIGT


@uncounted
def has_series(one):
    """Whether the motion between events is summed as a power series, else taken in steps."""
    return one.p == 1


@uncounted
def rest(one):
    """Deformation of a contact that holds the weight of the body on the table; 0 of others, and without gravity."""
    return one.g / (one.a * one.k) if one.g > 0 else 0.0


@uncounted
def spring(one):
    """Return k delta^p of a contact."""
    depth = one.delta + rest(one)
    if one.p == 1:
        return one.k * depth
    return one.k * depth**one.p if depth > 0 else 0.0


@uncounted
def damping(one):
    """Coefficient b of a contact as it is now: 0 while a dashpot of compression is parting."""
    return 0.0 if one.law == COMPRESSION_DASHPOT and one.phase != COMPRESSION else one.b


@uncounted
def force(one):
    """Force of a contact; 0 of one that does not act."""
    if not carries(one):
        return 0.0
    if one.law == KELVIN_VOIGT or one.law == COMPRESSION_DASHPOT:
        damped = 1.0 if one.p == 1 else max(one.delta, 0.0) ** (0.5 * (one.p - 1))
        return spring(one) + damping(one) * one.w * damped
    return spring(one) * (1 + one.b * one.w) if one.law == HUNT_CROSSLEY else spring(one)


@uncounted
def before_cut(one, delta, w, dw):
    """Give what has the sign of a dashpot's force before it is cut off at zero, and its slope; dw is w'."""
    if one.law == HUNT_CROSSLEY:
        return 1 + one.b * w, one.b * dw
    if one.b == 0:
        return delta, w
    q, depth = 0.5 * (one.p + 1), max(delta, 0.0)
    return one.k * depth**q + one.b * w, one.k * q * depth ** (q - 1) * w + one.b * dw


@uncounted
def spent(one):
    """End the force of a contact: it keeps its stiffness for a return."""
    one.phase = INACTIVE
    one.delta = 0.0 - rest(one)


@uncounted
def returned(one):
    """Let a contact act again, in compression from zero force."""
    one.phase = COMPRESSION
    one.delta = 0.0 - rest(one)
    if one.law == LIU_ZHAO_BROGLIATO:
        one.k = one.original


@uncounted
def end_compression(one):
    """E <- e^2 E at the same force: k <- k/e^(2p)."""
    one.phase = RESTITUTION
    one.delta *= one.e * one.e
    one.k /= one.e ** (2 * one.p)


@uncounted
def restart_compression(one):
    """Keep the stiffness; under the law of Liu, Zhao and Brogliato take back what the end of compression did."""
    one.phase = COMPRESSION
    if one.law == LIU_ZHAO_BROGLIATO:
        one.delta /= one.e * one.e
        one.k = one.original


@uncounted
def dashpot_event(one, what):
    """Apply an event of a contact of spring and dashpot."""
    never_slack = one.frozen or (one.law == KELVIN_VOIGT and one.b == 0)
    if what == FORCE and one.phase == COMPRESSION and one.delta + rest(one) > 0 and not never_slack:
        one.phase = SLACK
    elif one.phase == INACTIVE:
        returned(one)
    elif what == RATE and one.delta + rest(one) > 0:  # a dashpot of compression begins or ceases
        one.phase = RESTITUTION if one.phase == COMPRESSION else COMPRESSION
    elif what == FORCE and one.phase == SLACK:
        one.phase = COMPRESSION
    else:
        spent(one)
