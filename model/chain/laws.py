"""The contact laws as data: the functions that are watched in each phase of a contact, and the effects of events.

| law | force of an active contact | memory |
|---|---|---|
| `STATE_TRANSITION` | F = k delta^p | an end of compression stiffens it: E <- e^2 E, F stays |
| `LIU_ZHAO_BROGLIATO` | F = k delta^p | the same, but each compression runs at the original k |
| `KELVIN_VOIGT` | F = k delta^p + b delta^((p - 1)/2) delta' | none |
| `HUNT_CROSSLEY` | F = k delta^p (1 + b delta') | none |
| `COMPRESSION_DASHPOT` | as `KELVIN_VOIGT` while delta' > 0, else k delta^p | none |
| `LINEAR_DASHPOT` | as `KELVIN_VOIGT`, and it may pull: it lasts until delta = 0 | none |

A contact is INACTIVE while it carries no force. With frozen positions, as in the model, it keeps delta = 0 and returns
when its bodies begin to approach. With positions, it returns when its gap has closed.

`STATE_TRANSITION` with positions is called *bistiffness*. There an end of compression moves the point of zero force by
(1 - e^2) delta into the contact, for good. So a contact that ends restitution opens with a gap of exactly zero.

With gravity, the lower ball of a drop has settled on the table. Its contact counts delta from the equilibrium depth, so
that the weight need not cancel to rounding (`equilibrium_depth`). An end of compression takes 1 - e^2 of the whole
strain energy of this contact; the strain by the weight is included.

A contact with a dashpot pushes from first touch on, and its force ends before its bodies are apart. The contact is then
SLACK: the bodies overlap without force, and the contact is loaded again if a neighbour pushes them together. Three
kinds of contact are never slack:

* a contact without damping;
* a contact whose dashpot acts in compression only. The dashpot begins and ceases to act at delta' = 0, so the force is
  continuous. While the bodies part, only the spring acts, and it pushes for as long as they overlap;
* a contact that may pull. It is active for as long as its bodies overlap. When it becomes active or inactive, its force
  jumps between 0 and the force of the dashpot, while positions and rates stay continuous.

Used by all modules of `chain`; `Law` also by the callers of `chain.following`.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from impact_xval.model.compiled import kernel_helper
from impact_xval.model.pair.law import Phase


class Law(IntEnum):
    """Law of all contacts of a chain. The order counts: laws with a dashpot come after laws without a dashpot.

    Most of the code that depends on the law is in this module: `WATCHED`, `damping`, `force`, `force_indicator` and the
    events. `chain.series` and `chain.event` treat `HUNT_CROSSLEY` separately, because its force is a product.
    `chain.drop` treats the two laws separately that are linear throughout a contact.
    """

    STATE_TRANSITION = 0
    LIU_ZHAO_BROGLIATO = 1
    KELVIN_VOIGT = 2
    HUNT_CROSSLEY = 3
    COMPRESSION_DASHPOT = 4
    LINEAR_DASHPOT = 5


class Watched(IntEnum):
    """Function of time of one contact that the search for events may watch."""

    FORCE = 0  # a function with the sign of a dashpot's force before the force is cut off at zero
    GAP = 1  # the deformation delta; its zero is the end of a gap or of an overlap
    RATE = 2  # the compression rate w
    TURN = 3  # the compression rate of an inactive contact; its zero ends a window, but is no event


#: Sign of each function until its event, by law, phase and `Watched`; 0 where the function is not watched. HELD is the
#: phase of an inactive contact with frozen positions.
WATCHED = np.zeros((len(Law), len(Phase), len(Watched)))
WATCHED[:, Phase.INACTIVE, Watched.GAP] = WATCHED[:, Phase.HELD, Watched.RATE] = -1
for _law in (Law.STATE_TRANSITION, Law.LIU_ZHAO_BROGLIATO, Law.COMPRESSION_DASHPOT):
    WATCHED[_law, Phase.COMPRESSION, Watched.RATE] = 1
    WATCHED[_law, Phase.RESTITUTION, Watched.GAP] = 1
    WATCHED[_law, Phase.RESTITUTION, Watched.RATE] = -1
for _law in (Law.KELVIN_VOIGT, Law.HUNT_CROSSLEY):
    WATCHED[_law, Phase.COMPRESSION, Watched.FORCE] = 1
    WATCHED[_law, Phase.SLACK, Watched.FORCE] = -1
    WATCHED[_law, Phase.SLACK, Watched.GAP] = 1
for _law in (Law.HUNT_CROSSLEY, Law.LINEAR_DASHPOT):
    WATCHED[_law, Phase.COMPRESSION, Watched.GAP] = 1


@kernel_helper
def is_active(contact):
    """Return whether a contact carries force."""
    return Phase.INACTIVE < contact.phase < Phase.SLACK


@kernel_helper
def has_dashpot(contact):
    """Return whether the force of a contact depends on the rate; a contact with a dashpot has no memory."""
    return contact.law >= Law.KELVIN_VOIGT


@kernel_helper
def has_series(contact):
    """Return whether the motion between events is summed as a power series; otherwise it is integrated in steps."""
    return contact.p == 1


@kernel_helper
def equilibrium_depth(contact):
    """Return the deformation at which the contact with the table holds the weight; 0 without gravity."""
    return contact.g / (contact.a * contact.k) if contact.g > 0 else 0.0


@kernel_helper
def spring_force(contact):
    """Return k delta^p, with the deformation counted from first touch."""
    depth = contact.delta + equilibrium_depth(contact)
    if contact.p == 1:
        return contact.k * depth
    return contact.k * depth**contact.p if depth > 0 else 0.0


@kernel_helper
def damping(contact):
    """Return the coefficient b of a contact; 0 for a compression dashpot while its bodies part."""
    is_parting = contact.law == Law.COMPRESSION_DASHPOT and contact.phase != Phase.COMPRESSION
    return 0.0 if is_parting else contact.b


@kernel_helper
def force(contact):
    """Return the force of a contact; 0 if it is not active."""
    if not is_active(contact):
        return 0.0
    if contact.law == Law.HUNT_CROSSLEY:
        return spring_force(contact) * (1 + contact.b * contact.w)
    if has_dashpot(contact):
        damped = 1.0 if contact.p == 1 else max(contact.delta, 0.0) ** (0.5 * (contact.p - 1))
        return spring_force(contact) + damping(contact) * contact.w * damped
    return spring_force(contact)


@kernel_helper
def force_indicator(contact, delta, w, dw):
    """Return a function with the sign of a dashpot's force before the force is cut off at zero, and its slope in time.

    For a linear contact with a dashpot the function is the force itself. `dw` is the slope of the rate w. The function
    is not meant for contacts that may pull, because their force is never cut off.
    """
    if contact.law == Law.HUNT_CROSSLEY:
        return 1 + contact.b * w, contact.b * dw
    if contact.b == 0:
        return delta, w
    q, depth = 0.5 * (contact.p + 1), max(delta, 0.0)
    value = contact.k * depth**q + contact.b * w
    return value, contact.k * q * depth ** (q - 1) * w + contact.b * dw


@kernel_helper
def deactivate(contact):
    """End the force of a contact; it keeps its stiffness for its return."""
    contact.phase = Phase.INACTIVE
    contact.delta = 0.0 - equilibrium_depth(contact)


@kernel_helper
def reactivate(contact):
    """Make a contact active again, in compression from zero force."""
    contact.phase = Phase.COMPRESSION
    contact.delta = 0.0 - equilibrium_depth(contact)
    if contact.law == Law.LIU_ZHAO_BROGLIATO:
        contact.k = contact.original


@kernel_helper
def end_compression(contact):
    """End compression: E <- e^2 E at the same force, hence k <- k/e^(2p)."""
    contact.phase = Phase.RESTITUTION
    contact.delta *= contact.e * contact.e
    contact.k /= contact.e ** (2 * contact.p)


@kernel_helper
def restart_compression(contact):
    """Restart compression at the same stiffness.

    Under the law of Liu, Zhao and Brogliato, the restart reverses the end of compression.
    """
    contact.phase = Phase.COMPRESSION
    if contact.law == Law.LIU_ZHAO_BROGLIATO:
        contact.delta /= contact.e * contact.e
        contact.k = contact.original


@kernel_helper
def apply_dashpot_event(contact, watched):
    """Apply the event of a contact with spring and dashpot at which a watched function is zero."""
    overlaps = contact.delta + equilibrium_depth(contact) > 0
    never_slack = contact.frozen or (contact.law == Law.KELVIN_VOIGT and contact.b == 0)
    if watched == Watched.FORCE and contact.phase == Phase.COMPRESSION and overlaps and not never_slack:
        contact.phase = Phase.SLACK
    elif contact.phase == Phase.INACTIVE:
        reactivate(contact)
    elif watched == Watched.RATE and overlaps:  # a compression dashpot begins or ceases to act
        if contact.phase == Phase.COMPRESSION:
            contact.phase = Phase.RESTITUTION
        else:
            contact.phase = Phase.COMPRESSION
    elif watched == Watched.FORCE and contact.phase == Phase.SLACK:
        contact.phase = Phase.COMPRESSION
    else:
        deactivate(contact)
