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
*bistiffness*; there an end of compression moves the point of zero force by (1 - e^2) delta into the contact, for good:
the permanent indentation of a loading along k and an unloading along k/e^2. A contact that ends restitution therefore
opens with a gap of exactly zero, and returns when its bodies meet where they parted.

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
def carries(phase):
    """Whether a contact carries force."""
    return INACTIVE < phase < SLACK


@uncounted
def has_dashpot(c):
    """Whether forces depend on rates, and contacts have no memory."""
    return c.law >= KELVIN_VOIGT


@uncounted
def has_series(c):
    """Whether the motion between events is summed as a power series, else taken in steps."""
    return c.p == 1


@uncounted
def rest(c, n, i):
    """Deformation of contact i that holds the weight of the body on the table; 0 of others, and without gravity."""
    return c.g[0] / (c.a[i] * c.k[i]) if i == n - 1 and c.g[0] > 0 else 0.0


@uncounted
def spring(c, n, i):
    """Return k delta^p of contact i."""
    depth = c.delta[i] + rest(c, n, i)
    if c.p == 1:
        return c.k[i] * depth
    return c.k[i] * depth**c.p if depth > 0 else 0.0


@uncounted
def damping(c, i):
    """Coefficient b of contact i as it is now: 0 while a dashpot of compression is parting."""
    return 0.0 if c.law == COMPRESSION_DASHPOT and c.phase[i] != COMPRESSION else c.b[i]


@uncounted
def force(c, n, i):
    """Force of contact i; 0 of one that does not act, and beyond the ends of a chain of n contacts."""
    if not (0 <= i < n and carries(c.phase[i])):
        return 0.0
    if c.law in (KELVIN_VOIGT, COMPRESSION_DASHPOT):
        damped = 1.0 if c.p == 1 else max(c.delta[i], 0.0) ** (0.5 * (c.p - 1))
        return spring(c, n, i) + damping(c, i) * c.w[i] * damped
    return spring(c, n, i) * (1 + c.b[i] * c.w[i]) if c.law == HUNT_CROSSLEY else spring(c, n, i)


@uncounted
def before_cut(c, i, delta, w, dw):
    """Give what has the sign of a dashpot's force before it is cut off at zero, and its slope; dw is w'."""
    if c.law == HUNT_CROSSLEY:
        return 1 + c.b[i] * w, c.b[i] * dw
    if c.b[i] == 0:
        return delta, w
    q, depth = 0.5 * (c.p + 1), max(delta, 0.0)
    return c.k[i] * depth**q + c.b[i] * w, c.k[i] * q * depth ** (q - 1) * w + c.b[i] * dw


@uncounted
def spent(c, n, i):
    """End the force of contact i: it keeps its stiffness for a return."""
    c.phase[i] = INACTIVE
    c.delta[i] = 0.0 - rest(c, n, i)


@uncounted
def returned(c, n, i):
    """Let contact i act again, in compression from zero force."""
    c.phase[i] = COMPRESSION
    c.delta[i] = 0.0 - rest(c, n, i)
    if c.law == LIU_ZHAO_BROGLIATO:
        c.k[i] = c.original[i]


@uncounted
def end_compression(c, i):
    """E <- e^2 E at the same force: k <- k/e^(2p)."""
    e = c.e[i]
    c.phase[i] = RESTITUTION
    c.delta[i] *= e * e
    c.k[i] /= e ** (2 * c.p)


@uncounted
def restart_compression(c, i):
    """Keep the stiffness; under the law of Liu, Zhao and Brogliato take back what the end of compression did."""
    c.phase[i] = COMPRESSION
    if c.law == LIU_ZHAO_BROGLIATO:
        c.delta[i] /= c.e[i] * c.e[i]
        c.k[i] = c.original[i]


@uncounted
def dashpot_event(c, n, i, what):
    """Apply an event of a contact of spring and dashpot."""
    never_slack = c.frozen or (c.law == KELVIN_VOIGT and c.b[i] == 0)
    if what == FORCE and c.phase[i] == COMPRESSION and c.delta[i] + rest(c, n, i) > 0 and not never_slack:
        c.phase[i] = SLACK
    elif c.phase[i] == INACTIVE:
        returned(c, n, i)
    elif what == RATE and c.delta[i] + rest(c, n, i) > 0:  # a dashpot of compression begins or ceases
        c.phase[i] = RESTITUTION if c.phase[i] == COMPRESSION else COMPRESSION
    elif what == FORCE and c.phase[i] == SLACK:
        c.phase[i] = COMPRESSION
    else:
        spent(c, n, i)
