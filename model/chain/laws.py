"""The contact laws: forces, the functions that are watched in each phase of a contact, and the effects of events.

delta is the deformation of a contact, k its stiffness, b its damping, F its force, E its strain energy, and e its
coefficient of restitution.

| law | force of an active contact | effect of an end of compression |
|---|---|---|
| `STATE_TRANSITION` | F = k delta^p | the contact becomes stiffer: E <- e^2 E at the same F |
| `LIU_ZHAO_BROGLIATO` | F = k delta^p | the same, but each compression begins with the original k |
| `KELVIN_VOIGT` | F = k delta^p + b delta^((p - 1)/2) delta' | none |
| `HUNT_CROSSLEY` | F = k delta^p (1 + b delta') | none |
| `COMPRESSION_DASHPOT` | as `KELVIN_VOIGT` while delta' > 0, else k delta^p | none |
| `LINEAR_DASHPOT` | as `KELVIN_VOIGT`, and it may pull: it lasts until delta = 0 | none |

A contact is INACTIVE while it carries no force. Positions are *frozen* in the model: gaps are ignored, an inactive
contact keeps delta = 0, and it returns when its bodies begin to approach. If positions are not frozen, it returns when
its gap has closed.

`STATE_TRANSITION` with moving positions is called *bistiffness*. With this law an end of compression moves the point of
zero force by (1 - e^2) delta into the contact, for the rest of the collision. So when restitution ends, the gap is
exactly zero.

In a drop with gravity the lower ball has settled on the table. Deformations of its contact are counted from the
equilibrium depth (`equilibrium_depth`). So no large force has to cancel against the weight. An end of compression takes
the share 1 - e^2 of the whole strain energy of this contact, including the strain by the weight.

A contact with a dashpot pushes from first touch on, and its force ends while its bodies still overlap. The contact is
then SLACK: it carries no force, and is loaded again if a neighbour pushes its bodies together. Three kinds of contact
are never SLACK:

* a contact without damping;
* a contact whose dashpot acts in compression only. The dashpot begins and ceases to act at delta' = 0, so the force is
  continuous. While the bodies part, only the spring acts, and it pushes as long as they overlap;
* a contact that may pull. It is active as long as its bodies overlap. When it becomes active or inactive, its force
  jumps between 0 and the force of the dashpot; positions and rates stay continuous.

Used by all modules of `chain` that compute motion. Callers of `chain.following` use `Law`.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from impact_xval.model.compiled import kernel_helper
from impact_xval.model.pair.law import Phase


class Law(IntEnum):
    """Law of all contacts of a chain.

    The code relies on the order of the values: laws with a dashpot have larger values than laws without.

    Most of the code that depends on the law is in this module: `WATCHED`, `damping`, `force`, `force_indicator` and the
    functions that apply events. `chain.series` and `chain.event` treat `HUNT_CROSSLEY` separately, because its force is
    a product of two series. `chain.drop` treats `KELVIN_VOIGT` and `LINEAR_DASHPOT` separately, because their forces
    are linear throughout a contact.
    """

    STATE_TRANSITION = 0
    LIU_ZHAO_BROGLIATO = 1
    KELVIN_VOIGT = 2
    HUNT_CROSSLEY = 3
    COMPRESSION_DASHPOT = 4
    LINEAR_DASHPOT = 5


class Watched(IntEnum):
    """Function of time that belongs to a contact. A zero of the function may be an event."""

    FORCE = 0  # a function with the sign of the force of a contact with a dashpot, not cut off at zero
    GAP = 1  # the deformation delta; at its zero a gap or an overlap ends
    RATE = 2  # the rate of compression w
    TURN = 3  # the rate of compression of an inactive contact; its zero only ends a window


#: Sign that a function keeps until its event, by law, phase and `Watched`. It is 0 if the function is not watched in
#: this phase. HELD is the phase of an inactive contact with frozen positions.
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
    """Return whether a contact has a dashpot: its force then depends on the rate of compression."""
    return contact.law >= Law.KELVIN_VOIGT


@kernel_helper
def has_series(contact):
    """Return whether the motion between events is a power series. If not, it is integrated in steps."""
    return contact.p == 1


@kernel_helper
def equilibrium_depth(contact):
    """Return the deformation at which the contact with the table carries the weight of its ball; 0 without gravity."""
    return contact.g / (contact.a * contact.k) if contact.g > 0 else 0.0


@kernel_helper
def spring_force(contact):
    """Return the force k delta^p of the spring, with the deformation counted from first touch."""
    depth = contact.delta + equilibrium_depth(contact)
    if contact.p == 1:
        return contact.k * depth
    return contact.k * depth**contact.p if depth > 0 else 0.0


@kernel_helper
def damping(contact):
    """Return the present damping b of a contact; 0 for a compression dashpot while its bodies part."""
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
    """Return a number with the sign of the force of a contact with a dashpot, and its derivative in time.

    The force is taken before it is cut off at zero. For a linear contact the number is the force itself. `dw` is the
    derivative of the rate w. Contacts that may pull do not use this function, because their force is never cut off.
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
    """Make a contact inactive. If it becomes active again, it compresses with the stiffness that it has now."""
    contact.phase = Phase.INACTIVE
    contact.delta = 0.0 - equilibrium_depth(contact)


@kernel_helper
def reactivate(contact):
    """Put an inactive contact into compression, from zero deformation."""
    contact.phase = Phase.COMPRESSION
    contact.delta = 0.0 - equilibrium_depth(contact)
    if contact.law == Law.LIU_ZHAO_BROGLIATO:
        contact.k = contact.original


@kernel_helper
def end_compression(contact):
    """Apply an end of compression: the strain energy is multiplied by e^2, at the same force.

    The stiffness is therefore divided by e^(2p).
    """
    contact.phase = Phase.RESTITUTION
    contact.delta *= contact.e * contact.e
    contact.k /= contact.e ** (2 * contact.p)


@kernel_helper
def restart_compression(contact):
    """Put a contact in restitution back into compression; its stiffness stays the same.

    In the law of Liu, Zhao and Brogliato the stiffness becomes the original stiffness again.
    """
    contact.phase = Phase.COMPRESSION
    if contact.law == Law.LIU_ZHAO_BROGLIATO:
        contact.delta /= contact.e * contact.e
        contact.k = contact.original


@kernel_helper
def apply_dashpot_event(contact, watched):
    """Apply the event of a contact with a dashpot: the function `watched` has reached zero."""
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
