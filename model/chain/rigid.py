"""Contacts of a chain that become rigid during a collision, because their running stiffness runs away.

The supplement describes this in section 3.4. `ringing_ends` decides it after an end of compression, `rests_rigidly` for
a contact at rest. Needs `chain.state`. Used by `chain.kernel`, which then unites the bodies.
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

#: Bodies are united if the contact between them can change less than this share of its neighbours' energy.
RIGID = 1e-14

#: A neighbour with less than this share of the other neighbour's energy is disregarded: it only rings itself.
SMALL = 1e-6


@kernel_helper
def ringing_ends(c, n, i):
    """Return whether contact i, which has just ended compression or is at rest, may count as rigid from here on.

    The contact rings about its static load, the force that holds its bodies at one velocity. Each end of compression
    makes its tangent stiffer by 1/e^2 at the same force, and its periods shorter by e. So the contact becomes rigid
    after a finite time tau (supplement, 3.4). It counts as rigid at once if four conditions hold up to then: its energy
    is negligible beside its neighbours' energy; the neighbours keep pressing it; no other body arrives; and its ringing
    cannot carry a neighbour's rate through zero, which would be an end of compression.

    A contact at rest without force will ring about its static load too. Its tangent and its energy are then about as
    large as under that load.
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
        swing = oscillation(c, i - 1)  # the upper ball will fall back with this energy
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
    """Return whether contact i of a power law is at rest without force, and would be rigid under its neighbours' load.

    If its energy under that load is below rounding, `chain.state.still_rounding` brings it to rest after every step. So
    the steps never show how such a contact rings.
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
    """Return whether bodies that are apart may meet within a time.

    `least` is twice the smallest energy of approach that matters.
    """
    for j in range(n):
        contact = c[j]
        if contact.phase == Phase.INACTIVE:
            approach = contact.w + time * max(acceleration(c, j), 0.0)
            matters = approach * approach > least * (contact.a + c[j + 1].a)
            if matters and -(contact.delta + equilibrium_depth(contact)) < time * approach:
                return True
    return False
