"""Contact laws over time, for graphs: the watched functions of a contact, and when it becomes active and inactive.

Contact i has the rate of compression w_i, the force F_i, and the depth delta_i, which is counted from the surfaces that
an earlier plastic deformation has left. W is the Delassus matrix:

    delta_i' = w_i        w' = -W F

Forces and events are computed by the functions that linear contacts of chains use (`chain.laws`). k is the stiffness,
and b the damping:

| law | force of an active contact | it ends | at an end of compression |
|---|---|---|---|
| `STATE_TRANSITION` (bistiffness) | k delta | delta = 0 | delta <- e^2 delta, k <- k/e^2: F stays |
| `KELVIN_VOIGT` | k delta + b w | F = 0 | |
| `COMPRESSION_DASHPOT` | k delta + b w if w > 0, else k delta | delta = 0 | |
| `LINEAR_DASHPOT` | k delta + b w, of any sign | delta = 0 | |

At an end of compression w_i falls through 0. The force of a Kelvin-Voigt contact may end while its bodies still
overlap. The contact is then SLACK, and carries no force. It becomes active again if k delta + b w rises through 0, and
INACTIVE when delta reaches 0. The force of a linear dashpot may pull. It begins and ends at delta = 0, with a jump.

**Moving and frozen positions.** Usually delta_i' = w_i at all times. A negative delta is a gap along the fixed normal.
An inactive contact returns when its gap has closed, where delta rises through 0. It keeps its running stiffness. With
frozen positions, delta stays 0 while a contact is inactive. The contact then returns when w rises through 0, and no
contact is ever SLACK.

**Start rule.** The rule is applied to all contacts at first touch, and later to each inactive contact with delta = 0.
The contact becomes active if w > 0. If w = 0, it becomes active if the first non-zero derivative of w is positive. If
this derivative is negative, a gap opens (`in_time.motion.expand`).

**End of the collision.** The collision is over when no contact carries force and no gap closes. Bistiffness has two
closed forms, as in chains. A contact whose stiffness would grow without bound in a finite time becomes rigid
(`in_time.rigid`). And all contacts come to rest when they have at most 1e-30 of the energy of impact left. Laws with
a dashpot have no closed form.

**Simultaneous events** are applied one after another, in the order of the contacts' numbers. Any order would give the
same result, because an event changes only its own contact, and no rate. The force of a linear dashpot may jump at an
event. This changes accelerations, but no other contact.

Used by `in_time.event`, `in_time.motion` and `in_time.following`.
"""

from __future__ import annotations

from impact_xval.model.chain.laws import WATCHED, Law
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.pair.law import Phase

#: Laws that the contacts of a graph may have: all laws of linear contacts whose motion is a power series.
GRAPH_LAWS = (Law.STATE_TRANSITION, Law.KELVIN_VOIGT, Law.COMPRESSION_DASHPOT, Law.LINEAR_DASHPOT)


@kernel_helper
def watched_sign(contact, watched):
    """Return the sign that the function `watched` of a contact keeps until its event.

    The sign is 0 if the function is not watched in the present phase of the contact.
    """
    is_held = contact.frozen and contact.phase == Phase.INACTIVE
    phase = Phase.HELD if is_held else contact.phase
    return WATCHED[contact.law, phase, watched]


@kernel_helper
def begin_touching(contact):
    """Apply the start rule to an inactive contact of depth 0, as far as only its rate of compression is needed.

    If the rate is positive, the contact becomes active. If the rate is 0, the contact gets the flag `undecided`, and
    `graph.motion.decide` later tests derivatives of the rate.
    """
    contact.undecided = False
    if contact.is_rigid or contact.delta != 0 or contact.phase > Phase.COMPRESSION:
        return
    if contact.w > 0:
        contact.phase = Phase.COMPRESSION
    elif contact.w == 0:
        contact.phase = Phase.INACTIVE
        contact.undecided = True
