"""The state of a chain during a collision, and quantities that are computed from it.

`CONTACT` is the record of a contact; `begin` fills in a chain at first touch. Further functions compute accelerations,
energies and the load by neighbours (`static_load`). `still_rounding` removes energy that only rounding has made,
`unite` makes two bodies one, and `write_velocities` writes the velocities of balls.

Contact i is between bodies i and i + 1, counted from 0. A body is a ball, or several balls that a rigid contact has
united, or the table, which is then the last body and has infinite mass. The unknowns are, for each contact, the
compression rate w = v_{i+1} - v_i and the deformation delta. With frozen positions delta' = w holds only while the
contact is active; these are equations (13)-(15) of docs/theory.md, written in time. With positions delta' = w always
holds, and delta is negative across a gap. All w and F are continuous through every event.

Needs `chain.laws`. Used by the other modules of `chain`, from the motion to the kernel.
"""

from __future__ import annotations

import numpy as np

from impact_xval.model.arrays import Records, zero_records
from impact_xval.model.chain.laws import (
    Law,
    deactivate,
    equilibrium_depth,
    force,
    has_dashpot,
    has_series,
    is_active,
    spring_force,
)
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.pair.law import Phase

#: Rounding of a neighbour's motion, as a share of its energy. Exact motion is rounded by 2^-53, whose square is the
#: first number; motion by steps leaves the second.
ROUNDING, ROUNDING_OF_STEPS = 1e-32, 1e-26

#: Loads below this share of the energy of impact count as zero: far ahead of a wave, loads underflow.
UNDERFLOW = 1e-150


#: A contact during a collision and the body above it. A chain c has one such record per contact, and one more for the
#: body below the last contact. This last record is always INACTIVE. As c[-1] it also stands before the first contact,
#: so that the contacts at both ends have a neighbour without force.
CONTACT = np.dtype(
    [
        ("a", "f8"),  # inverse mass of the body; 0 for the table
        ("k", "f8"),  # running stiffness
        ("original", "f8"),  # stiffness before the first end of compression
        ("e", "f8"),  # coefficient of restitution
        ("b", "f8"),  # damping (`chain.laws`)
        ("w", "f8"),  # compression rate
        ("delta", "f8"),  # deformation
        ("length", "f8"),  # deformation that would hold all the energy of impact at the original stiffness
        ("reach", "f8"),  # twice the largest energy so far of this contact and its neighbours (`oscillation`)
        ("g", "f8"),  # gravity of the contact with the table; 0 for others, and from the first flight on
        ("phase", "i8"),  # Phase: INACTIVE, COMPRESSION, RESTITUTION or SLACK
        ("index", "i8"),  # number of the contact in the collision; rigid contacts are no longer in the chain
        ("balls", "i8"),  # number of balls of the body
        ("law", "i8"),  # Law; one for the whole chain, like p and frozen
        ("p", "f8"),  # exponent of the force
        ("frozen", "?"),  # whether positions are frozen
    ],
    align=True,
)


def new_chain(contacts: int, p: float, law: Law, frozen: bool) -> Records:
    """Return a chain for `begin` to fill in: one record per contact, and one for the last body."""
    chain = zero_records(contacts + 1, CONTACT)
    chain.p, chain.law, chain.frozen = p, law, frozen
    return chain


@kernel_helper
def begin(c, masses, stiffnesses, restitutions, dampings, rates, gaps, g):
    """Put a chain at first touch.

    A closed contact is active if its bodies approach. A closed contact at rest is active too if a row of closed
    contacts connects it with a contact whose bodies approach.
    """
    n = c.size - 1
    for i in range(n + 1):
        is_ball = i < masses.size
        c[i].a = 1 / masses[i] if is_ball else 0.0
        c[i].balls = 1 if is_ball else 0
        c[i].phase, c[i].g = Phase.INACTIVE, 0.0
    for i in range(n):
        contact = c[i]
        contact.k, contact.original = stiffnesses[i], stiffnesses[i]
        contact.e, contact.b, contact.w, contact.delta = restitutions[i], dampings[i], rates[i], -gaps[i]
        contact.index, contact.reach = i, 0.0
        if contact.w > 0 and gaps[i] == 0:
            contact.phase = Phase.COMPRESSION
    c[n - 1].g = g
    for i in range(1, n):
        activate_resting(c[i], gaps[i], c[i - 1])
    for i in range(n - 2, -1, -1):
        activate_resting(c[i], gaps[i], c[i + 1])


@kernel_helper
def activate_resting(contact, gap, neighbour):
    """Make a closed contact at rest active if its neighbour is active."""
    if contact.w == 0 and gap == 0 and neighbour.phase == Phase.COMPRESSION:
        contact.phase = Phase.COMPRESSION


@kernel_helper
def acceleration(c, i):
    """Return w' of contact i by its own force, by its neighbours' forces, and by gravity at the table."""
    above, below = c[i].a, c[i + 1].a
    by_itself = (above + below) * force(c[i])
    return above * force(c[i - 1]) + below * force(c[i + 1]) - by_itself + c[i].g


@kernel_helper
def tangent(contact):
    """Return dF/ddelta of the spring of a contact."""
    if contact.p == 1:
        return contact.k
    return contact.p * contact.k * max(contact.delta, 0.0) ** (contact.p - 1)


@kernel_helper
def tangent_at(contact, F):
    """Return dF/ddelta of the spring of a contact where its force is F."""
    return contact.p * contact.k * (F / contact.k) ** (1 - 1 / contact.p) if F > 0 else 0.0


@kernel_helper
def strain_energy(contact):
    """Return the strain energy of the spring of a contact; 0 if it is not active."""
    if not is_active(contact):
        return 0.0
    return spring_force(contact) * (contact.delta + equilibrium_depth(contact)) / (contact.p + 1)


@kernel_helper
def oscillation(c, i):
    """Return twice the energy of the oscillation of contact i alone, at its running stiffness."""
    contact = c[i]
    F = spring_force(contact) if is_active(contact) else 0.0
    strain = F * F / tangent(contact) if F > 0 else 0.0
    return strain + contact.w * contact.w / (contact.a + c[i + 1].a)


@kernel_helper
def static_load(c, i):
    """Return the force of contact i at which w_i' = 0, the slope of this force in time, and a neighbour's energy.

    The energy is `oscillation` of the neighbour that has more of it.
    """
    inverse = c[i].a + c[i + 1].a
    static, slope, swing = c[i].g / inverse, 0.0, 0.0
    for j in range(i - 1, i + 2, 2):
        neighbour = c[j]
        if is_active(neighbour):
            shared = c[max(i, j)].a  # inverse mass of the body between both contacts
            static += shared / inverse * force(neighbour)
            slope += shared / inverse * tangent(neighbour) * neighbour.w
            swing = max(swing, oscillation(c, j))
    return static, slope, swing


@kernel_helper
def rounding_energy(contact, energy):
    """Return twice the energy that rounding alone can give a contact, where the energy of impact is `energy`.

    A contact shares a ball with its neighbour. The neighbour gives this ball at most the neighbour's own energy, and
    the rounding of the ball's velocity is all the energy that the contact can get by mistake. Ahead of a wave no
    neighbour has moved; there only loads that underflow count as rounding.
    """
    share = ROUNDING_OF_STEPS
    if has_dashpot(contact):
        share = 0.0
    elif has_series(contact):
        share = ROUNDING
    return share * contact.reach + UNDERFLOW * energy


@kernel_helper
def still_rounding(c, n, energy):
    """Bring to rest the contacts in compression whose energy is only rounding."""
    above, middle, below = 0.0, 0.0, 0.0
    for i in range(-1, n):
        above, middle, below = middle, below, oscillation(c, i + 1) if i + 1 < n else 0.0
        if i >= 0:
            c[i].reach = max(max(c[i].reach, above), max(middle, below))
    for i in range(n):
        contact = c[i]
        if contact.phase == Phase.COMPRESSION and oscillation(c, i) <= rounding_energy(contact, energy):
            contact.w, contact.delta = 0.0, 0.0 - equilibrium_depth(contact)


@kernel_helper
def unite(c, n, i):
    """Make the two bodies of contact i one for good, and return the number of remaining contacts."""
    last = c[n - 1]
    last.delta += equilibrium_depth(last)
    g = last.g
    inverse, balls = 1 / (1 / c[i].a + 1 / c[i + 1].a), c[i].balls + c[i + 1].balls
    for j in range(i, n):
        c[j] = c[j + 1]
    c[i].a, c[i].balls = inverse, balls
    if n > 1:
        last = c[n - 2]
        last.g = g
        last.delta -= equilibrium_depth(last)
    return n - 1


@kernel_helper
def write_ball_values(c, n, rates, drift, out, row, column):
    """Write velocities of balls, computed from compression rates, into a row of `out` from a column on.

    `drift` is the velocity of the centre of mass; it is not used on a table. Given slopes of rates and the acceleration
    of the centre of mass, the function writes accelerations.
    """
    last, ball = 0.0, column
    if c[n].a > 0:
        mass, moment = 0.0, 0.0
        for i in range(n):
            mass += 1 / c[i].a
            moment += mass * rates[i]
        last = drift + moment / (mass + 1 / c[n].a)
    for i in range(n + 1):
        ball += c[i].balls
    for i in range(n, -1, -1):
        if i < n:
            last -= rates[i]
        for _ in range(c[i].balls):
            ball -= 1
            out[row, ball] = last


@kernel_helper
def write_velocities(c, n, masses, drift, velocities, row):
    """Write the velocities of the balls into a row, and return their energy relative to the centre of mass or table."""
    write_ball_values(c, n, c.w, drift, velocities, row, np.int64(0))
    energy = 0.0
    for ball in range(velocities.shape[1]):
        energy += 0.5 * masses[row, ball] * (velocities[row, ball] - drift) ** 2
    return energy


@kernel_helper
def kinetic_energy(c, n):
    """Return the kinetic energy relative to the centre of mass or the table, computed from rates alone.

    The bodies are added from the top. Each adds the energy of its motion relative to the centre of mass of the bodies
    above it; the relative velocity is moment/mass. Velocities of balls would not do: beside a ball 1e30 times as heavy,
    rounding of its velocity hides the energy of all other balls.
    """
    total, mass, moment = 0.0, 0.0, 0.0
    for i in range(n):
        mass += 1 / c[i].a
        moment += mass * c[i].w
        total += 0.5 * (moment / mass) ** 2 / (1 / mass + c[i + 1].a)
    return total


@kernel_helper
def may_still_act(contact):
    """Return whether a contact is active, or its bodies approach across a gap."""
    return is_active(contact) or (contact.w > 0 and not contact.frozen)


@kernel_helper
def energy_left(c, n):
    """Return the energy of active contacts, and of bodies that approach across a gap."""
    total = 0.0
    for i in range(n):
        contact = c[i]
        if may_still_act(contact):
            total += 0.5 * contact.w * contact.w / (contact.a + c[i + 1].a) + strain_energy(contact)
    return total


@kernel_helper
def bring_to_rest(c, n):
    """End all contacts that are active or whose bodies approach, and return the strain energy that is dropped.

    Also returned is whether one of these contacts has e < 1. If none has, the state is no end of infinitely many
    events, and the dropped energy is only rounding.
    """
    dropped, is_lossy = 0.0, False
    for i in range(n):
        contact = c[i]
        if may_still_act(contact):
            dropped += strain_energy(contact)
            is_lossy |= contact.e < 1
            contact.w = 0.0
            deactivate(contact)
    return dropped, is_lossy
