"""The model's law for one contact of a graph: the functions that are watched in each phase, and the effects of events.

The law is that of docs/theory.md, section 2. It does not depend on how the contacts are connected. F_i is the force of
contact i, w_i its rate of compression, k_i its running stiffness, e_i its restitution, and E_i its strain energy.

| event | condition | effect |
|---|---|---|
| end of compression | w_i falls through 0 in compression | k_i <- k_i/e_i^2, F_i stays: E_i <- e_i^2 E_i |
| restart of compression | w_i rises through 0 in restitution | k_i stays |
| end of restitution | F_i falls to 0 in restitution | inactive, k_i stays |
| return | w_i of an inactive contact rises through 0 | compression from F_i = 0 |

**Start rule.** The rule is applied at first touch and after every event. A contact without force becomes active if w_i
> 0. If w_i = 0, the contact becomes active if the first non-zero derivative of w_i is positive (`graph.motion.expand`).
The rule covers three cases: a contact far from the struck end of a row of balls, a contact between two loads that
balance, and a contact that its neighbour pulls open.

**Restitution 0.** At e_i = 0 an end of compression makes the contact infinitely stiff. From then on its phase is RIGID
while its neighbours press it together, and INACTIVE while they do not (`graph.rigid`).

**Simultaneous events** are applied one after another, in the order of the contacts' numbers. Any order would give the
same result, because an event changes only the phase and the stiffness of its own contact, and no rate and no force.

To change the law, change the table `WATCHED`, which states what ends each phase, and the four functions that apply
events.

Used by `graph.event` and `graph.kernel`.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.state import GraphPhase


class GraphWatched(IntEnum):
    """Function of time that belongs to a contact. A zero of the function may be an event."""

    FORCE = 0  # the force F_i of the contact
    RATE = 1  # the rate of compression w_i of the contact


#: Sign that a function keeps until its event, by the contact's phase and `GraphWatched`. It is 0 if the function is not
#: watched in this phase.
WATCHED = np.zeros((len(GraphPhase), len(GraphWatched)))
WATCHED[GraphPhase.INACTIVE, GraphWatched.RATE] = -1  # event: return
WATCHED[GraphPhase.COMPRESSION, GraphWatched.RATE] = 1  # event: end of compression
WATCHED[GraphPhase.RESTITUTION, GraphWatched.RATE] = -1  # event: restart of compression
WATCHED[GraphPhase.RESTITUTION, GraphWatched.FORCE] = 1  # event: end of restitution
WATCHED[GraphPhase.RIGID, GraphWatched.FORCE] = 1  # event: the neighbours cease to press the rigid contact


@kernel_helper
def end_compression(contact):
    """Apply an end of compression: the strain energy is multiplied by e^2, and the stiffness is divided by e^2.

    The force stays the same.
    """
    contact.k /= contact.e * contact.e
    contact.phase = GraphPhase.RESTITUTION


@kernel_helper
def restart_compression(contact):
    """Put a contact in restitution back into compression; its stiffness stays the same."""
    contact.phase = GraphPhase.COMPRESSION


@kernel_helper
def deactivate(contact):
    """Make a contact inactive. If it becomes active again, it compresses with the stiffness that it has now."""
    contact.F = 0.0
    contact.phase = GraphPhase.INACTIVE


@kernel_helper
def reactivate(contact):
    """Put an inactive contact into compression; its force begins at 0.

    A contact that has become rigid stays inactive here: `graph.rigid` makes it RIGID when a load presses it.
    """
    contact.F = 0.0
    if not contact.is_rigid:
        contact.phase = GraphPhase.COMPRESSION
