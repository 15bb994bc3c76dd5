"""The law of a contact: the functions that are watched in each phase, and the effects of events.

This is the model's law (docs/theory.md, section 2) for one contact. It does not depend on how contacts are connected.

| event | condition | effect |
|---|---|---|
| end of compression | w_i falls through 0 in compression | k_i <- k_i/e_i^2, F_i stays: E_i <- e_i^2 E_i |
| restart of compression | w_i rises through 0 in restitution | k_i stays |
| end of restitution | F_i falls to 0 in restitution | inactive, k_i stays |
| return | w_i of an inactive contact rises through 0 | compression from F_i = 0 |

**Start.** At first touch, and after every event, a contact without force is active if w_i > 0. If w_i = 0, the first
non-zero derivative of w_i decides: the contact is active if this derivative is positive (`graph.motion.expand`). The
rule covers a contact far down a row whose end is struck, a contact between two loads that balance, and a contact that
its neighbour pulls open.

**Limits.** At e_i = 0 an end of compression makes the contact infinitely stiff: from then on it is RIGID while its
neighbours press it, and INACTIVE while they do not (`graph.rigid`).

**Ties.** Events at one instant are applied one after another, in the order of contacts. The order does not matter,
because each event changes only its own contact, and leaves all rates and forces as they are.

To change the law, change `WATCHED`, which tells what ends a phase, and the four functions that apply events. Used by
`graph.event` and `graph.kernel`.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from impact_xval.model.compiled import kernel_helper
from impact_xval.model.graph.state import GraphPhase


class GraphWatched(IntEnum):
    """Function of time of one contact that the search for events may watch."""

    FORCE = 0  # the force F_i
    RATE = 1  # the rate of compression w_i


#: Sign of each function until its event, by phase and `GraphWatched`; 0 where the function is not watched.
WATCHED = np.zeros((len(GraphPhase), len(GraphWatched)))
WATCHED[GraphPhase.INACTIVE, GraphWatched.RATE] = -1  # return
WATCHED[GraphPhase.COMPRESSION, GraphWatched.RATE] = 1  # end of compression
WATCHED[GraphPhase.RESTITUTION, GraphWatched.RATE] = -1  # restart
WATCHED[GraphPhase.RESTITUTION, GraphWatched.FORCE] = 1  # end of restitution
WATCHED[GraphPhase.RIGID, GraphWatched.FORCE] = 1  # the neighbours no longer press the contact


@kernel_helper
def end_compression(contact):
    """End compression: E <- e^2 E at the same force, hence k <- k/e^2."""
    contact.k /= contact.e * contact.e
    contact.phase = GraphPhase.RESTITUTION


@kernel_helper
def restart_compression(contact):
    """Restart compression at the same stiffness."""
    contact.phase = GraphPhase.COMPRESSION


@kernel_helper
def deactivate(contact):
    """End restitution: the contact keeps its stiffness for its return."""
    contact.F = 0.0
    contact.phase = GraphPhase.INACTIVE


@kernel_helper
def reactivate(contact):
    """Begin compression from zero force; a contact that is rigid for good stays inactive until a load presses it."""
    contact.F = 0.0
    if not contact.is_rigid:
        contact.phase = GraphPhase.COMPRESSION
