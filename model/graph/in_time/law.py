"""The laws of contacts in time, for graphs: what is watched of a contact, when it begins, and what its events do.

With rates of compression w and depths delta, counted from the present surfaces,

    delta_i' = w_i        w' = -W F

Laws, forces and events are those of linear contacts in chains (`chain.laws`), by the same functions:

| law | force of an active contact | it ends | at an end of compression |
|---|---|---|---|
| `STATE_TRANSITION` (bistiffness) | k delta | delta = 0 | delta <- e^2 delta, k <- k/e^2: F stays |
| `KELVIN_VOIGT` | k delta + b w | F = 0 | |
| `COMPRESSION_DASHPOT` | k delta + b w if w > 0, else k delta | delta = 0 | |
| `LINEAR_DASHPOT` | k delta + b w, of any sign | delta = 0 | |

An end of compression is w_i falling through 0. A Kelvin-Voigt contact whose force has ended while its bodies overlap is
SLACK: it carries no force. It is active again if k delta + b w rises through 0, and INACTIVE once delta = 0. The force
of a linear dashpot may pull; it begins and ends with a jump, at delta = 0.

**Positions.** delta_i' = w_i at all times, so that delta < 0 is a gap along the fixed normal. An inactive contact
returns when its gap has closed, delta rising through 0, with the running stiffness that it had. With frozen positions
delta = 0 while a contact is inactive. Then it returns when w rises through 0, and a contact whose force has ended is
never slack.

**Start.** At first touch all contacts have delta = 0. There, and whenever a contact has delta = 0, it is active if
w > 0. Where w = 0 too, its first non-zero derivative decides, order by order. If that is positive the contact is
active: a dashpot pushes from that order on. Else a gap opens (`in_time.motion.expand`).

**Over.** The collision is over when no contact carries force, and no gap closes. Bistiffness has two closed forms, as
in chains: a contact whose running stiffness runs away becomes rigid (`in_time.rigid`), and contacts come to rest where
they have 1e-30 of the energy of impact left. Laws with a dashpot have none.

**Ties.** Events at one instant are applied one after another, in the order of contacts. The order does not matter: each
changes only its own contact, and leaves all rates as they are. Of a linear dashpot the force may jump. That changes
accelerations, but no other contact.

Used by all modules of `graph.in_time` that follow.
"""

from __future__ import annotations

from impact_xval.model.chain.laws import WATCHED, Law
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.pair.law import Phase

#: Laws of linear contacts whose motion is a power series, which a graph may have.
GRAPH_LAWS = (Law.STATE_TRANSITION, Law.KELVIN_VOIGT, Law.COMPRESSION_DASHPOT, Law.LINEAR_DASHPOT)


@kernel_helper
def watched_sign(contact, watched):
    """Return the sign that a watched function of a contact has until its event; 0 if it is not watched."""
    is_held = contact.frozen and contact.phase == Phase.INACTIVE
    phase = Phase.HELD if is_held else contact.phase
    return WATCHED[contact.law, phase, watched]


@kernel_helper
def begin_touching(contact):
    """Make a touching contact active if its bodies approach, and leave one at rest undecided."""
    contact.undecided = False
    if contact.is_rigid or contact.delta != 0 or contact.phase > Phase.COMPRESSION:
        return
    if contact.w > 0:
        contact.phase = Phase.COMPRESSION
    elif contact.w == 0:
        contact.phase = Phase.INACTIVE
        contact.undecided = True
