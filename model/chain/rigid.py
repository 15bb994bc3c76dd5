"""Contacts of a chain that become rigid during a collision (supplement, section 3.4).

Each end of compression makes a contact stiffer, and its stiffness may grow without bound in a finite time.
`ringing_ends` tests after an end of compression whether the contact may be treated as rigid. `rests_rigidly` tests this
for a contact at rest. `chain.kernel` then unites the two bodies.

Needs `chain.state`. Used by `chain.kernel`.
"""

from __future__ import annotations

from math import pi, sqrt

from impact_xval.model.chain.laws import equilibrium_depth, force, is_active
from impact_xval.model.chain.state import (
    acceleration,
    oscillation,
    rounding_energy,
    static_load,
    tangent,
    tangent_at,
)
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.pair.law import Phase

#: A contact may become rigid if its energy is at most this share of the energy of its neighbours.
RIGID = 1e-14

#: A neighbouring contact with less than this share of the energy of the other neighbour only oscillates itself, and is
#: disregarded.
SMALL = 1e-6


@kernel_helper
def ringing_ends(c, n, i):
    """Return whether contact i, which has just ended compression or is at rest, may be treated as rigid from here on.

    The force of the contact oscillates about its static load, the force that keeps its bodies at one velocity. Each end
    of compression divides its tangent stiffness by e^2 at the same force, and multiplies its period by e. So the
    contact becomes rigid after a finite time tau (supplement, 3.4). It is treated as rigid at once if four conditions
    are true until then:

    - its energy is negligible beside the energy of its neighbours;
    - the neighbours keep pressing it;
    - no other body arrives;
    - its oscillation cannot carry a neighbour's rate through zero, which would be an end of compression.

    The force of a contact at rest without force will oscillate about its static load, too. For this contact, tangent
    stiffness and energy are estimated from the static load.
    """
    contact, upper = c[i], c[i - 1]
    e, F = contact.e, force(contact)
    static, change, swing = static_load(c, i)
    k = tangent(contact) if F > 0 else tangent_at(contact, static)
    inverse = contact.a + c[i + 1].a
    tau = 2 * pi / sqrt(k * inverse) / (1 - e)
    if not contact.frozen and bodies_meet_within(c, n, 2 * tau, RIGID * swing):
        return False
    load_squared = max(F, static) ** 2
    if contact.g > 0 and i > 0 and not is_active(upper):
        swing = oscillation(c, i - 1)  # the upper ball falls back with this energy
        load_squared = max(load_squared, upper.k * swing)
    may_unload = abs(change) * tau >= 0.5 * static
    has_energy = load_squared / (k * (1 - e)) > RIGID * swing
    if may_unload or has_energy:
        return False
    wiggle = abs(F - static) / sqrt(inverse * k)
    for j in range(i - 1, i + 2, 2):
        if is_active(c[j]) and oscillation(c, j) > SMALL * swing:
            room = 4 * c[max(i, j)].a * wiggle + 2 * abs(acceleration(c, j)) * tau
            if abs(c[j].w) < room:
                return False
    return True


@kernel_helper
def rests_rigidly(c, n, i, energy):
    """Return whether contact i, at rest without force, would be rigid if its neighbours pressed it.

    The function is used for power laws, whose motion is integrated in steps.

    With the load of its neighbours the energy of the contact is less than rounding. So `chain.state.still_rounding`
    brings the contact to rest after every step, and the steps never show how it oscillates. That is why it is tested
    here.
    """
    contact = c[i]
    is_pristine = contact.phase == Phase.COMPRESSION and contact.w == 0 and contact.delta == 0
    if not is_pristine or contact.e == 1:
        return False
    static, _, _ = static_load(c, i)
    if static <= 0:
        return False
    if static * static / tangent_at(contact, static) > rounding_energy(contact, energy):
        return False
    return ringing_ends(c, n, i)


@kernel_helper
def bodies_meet_within(c, n, time, least):
    """Return whether bodies across an open gap may meet within a time.

    Meetings with little energy are ignored: `least` is twice the smallest energy of approach that matters.
    """
    for j in range(n):
        contact = c[j]
        if contact.phase == Phase.INACTIVE:
            approach = contact.w + time * max(acceleration(c, j), 0.0)
            matters = approach * approach > least * (contact.a + c[j + 1].a)
            if matters and -(contact.delta + equilibrium_depth(contact)) < time * approach:
                return True
    return False
