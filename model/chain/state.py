"""The state of a chain during a collision, and quantities that are computed from it.

`CONTACT` is the record of a contact. `begin` sets a chain to its state at first touch. Other functions compute
accelerations, energies, and the load that neighbouring contacts put on a contact (`static_load`). `still_rounding`
removes motion that is only rounding. `unite` makes one body of two, and `write_velocities` writes the velocities of
balls.

Contact i is between the bodies i and i + 1, counted from 0. A body is a ball, or several balls that rigid contacts have
united, or the table. The table is always the last body, and has infinite mass. The unknowns of contact i are its rate
of compression w = v_{i+1} - v_i and its deformation delta. If positions move, delta' = w at all times, and a negative
delta is a gap. If positions are frozen, as in the model, delta' = w only while the contact is active; these are
equations (13)-(15) of docs/theory.md, written in time. All rates w and forces F are continuous at every event.

Needs `chain.laws`. Used by the modules of `chain` that compute motion.
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

#: Largest energy of a contact that is taken for rounding, as a share of the energy of its neighbours. `ROUNDING` is
#: valid for motion by power series: about the square of 2^-53, the rounding of a velocity. `ROUNDING_OF_STEPS` is valid
#: for motion in steps.
ROUNDING, ROUNDING_OF_STEPS = 1e-32, 1e-26

#: Energies below this share of the energy of impact are taken as zero. In a long row of balls the forces far ahead of
#: the wave are so small that they underflow.
UNDERFLOW = 1e-150


#: Record of one contact during a collision, and of the body above it. A chain c has one record per contact, and one
#: more record for the body below the last contact. The phase of this last record is always INACTIVE. The index c[-1]
#: gives the last record, too. So the first and the last contact each have a neighbour without force.
CONTACT = np.dtype(
    [
        ("a", "f8"),  # inverse mass of the body above the contact; 0 for the table
        ("k", "f8"),  # running stiffness: ends of compression increase it
        ("original", "f8"),  # stiffness before the first end of compression
        ("e", "f8"),  # coefficient of restitution
        ("b", "f8"),  # damping (`chain.laws`)
        ("w", "f8"),  # rate of compression
        ("delta", "f8"),  # deformation; a negative deformation is a gap
        ("length", "f8"),  # deformation that would hold all the energy of impact, at the original stiffness
        ("reach", "f8"),  # largest `oscillation` so far of this contact and its neighbours
        (
            "g",
            "f8",
        ),  # gravity, at the contact with the table; 0 at other contacts, and after the first flight begins
        ("phase", "i8"),  # one of `Phase`: INACTIVE, COMPRESSION, RESTITUTION or SLACK
        ("index", "i8"),  # number of the contact in the collision; rigid contacts are removed from the chain
        ("balls", "i8"),  # number of balls that the body above the contact consists of
        ("law", "i8"),  # one of `Law`; equal for all contacts of a chain, like p and frozen
        ("p", "f8"),  # exponent of the force
        ("frozen", "?"),  # whether gaps are ignored, so that an inactive contact keeps its deformation 0
    ],
    align=True,
)


def new_chain(contacts: int, p: float, law: Law, frozen: bool) -> Records:
    """Return records of a chain for `begin` to fill in: one record per contact, and one for the last body."""
    chain = zero_records(contacts + 1, CONTACT)
    chain.p, chain.law, chain.frozen = p, law, frozen
    return chain


@kernel_helper
def begin(c, masses, stiffnesses, restitutions, dampings, rates, gaps, g):
    """Set a chain to its state at first touch.

    A closed contact, whose gap is 0, is active if its bodies approach. A closed contact at rest is also active if other
    closed contacts connect it with a contact whose bodies approach.
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
    """Make a contact active if it is closed and at rest, and the contact `neighbour` is active."""
    if contact.w == 0 and gap == 0 and neighbour.phase == Phase.COMPRESSION:
        contact.phase = Phase.COMPRESSION


@kernel_helper
def acceleration(c, i):
    """Return the derivative w' of the rate of contact i, by all forces on its two bodies."""
    above, below = c[i].a, c[i + 1].a
    by_itself = (above + below) * force(c[i])
    return above * force(c[i - 1]) + below * force(c[i + 1]) - by_itself + c[i].g


@kernel_helper
def tangent(contact):
    """Return the tangent stiffness dF/ddelta of the spring of a contact at its deformation."""
    if contact.p == 1:
        return contact.k
    return contact.p * contact.k * max(contact.delta, 0.0) ** (contact.p - 1)


@kernel_helper
def tangent_at(contact, F):
    """Return the tangent stiffness dF/ddelta that the spring of a contact has if its force is F."""
    return contact.p * contact.k * (F / contact.k) ** (1 - 1 / contact.p) if F > 0 else 0.0


@kernel_helper
def strain_energy(contact):
    """Return the strain energy of the spring of a contact; 0 if the contact is not active."""
    if not is_active(contact):
        return 0.0
    return spring_force(contact) * (contact.delta + equilibrium_depth(contact)) / (contact.p + 1)


@kernel_helper
def oscillation(c, i):
    """Return twice the energy that contact i has if no other contact acts, at its running stiffness.

    The spring is linearised: its energy is F^2/2 over the tangent stiffness.
    """
    contact = c[i]
    F = spring_force(contact) if is_active(contact) else 0.0
    strain = F * F / tangent(contact) if F > 0 else 0.0
    return strain + contact.w * contact.w / (contact.a + c[i + 1].a)


@kernel_helper
def static_load(c, i):
    """Return the static load of contact i, its derivative in time, and the `oscillation` of a neighbouring contact.

    The static load is the force that keeps the rate of the contact constant, w_i' = 0. The returned `oscillation` is
    the larger one of those of the two neighbours.
    """
    inverse = c[i].a + c[i + 1].a
    static, slope, swing = c[i].g / inverse, 0.0, 0.0
    for j in range(i - 1, i + 2, 2):
        neighbour = c[j]
        if is_active(neighbour):
            shared = c[max(i, j)].a  # inverse mass of the body between contacts i and j
            static += shared / inverse * force(neighbour)
            slope += shared / inverse * tangent(neighbour) * neighbour.w
            swing = max(swing, oscillation(c, j))
    return static, slope, swing


@kernel_helper
def rounding_energy(contact, energy):
    """Return an upper bound of twice the energy that rounding alone can give to a contact.

    `energy` is the energy of impact. A contact shares a ball with its neighbour, and the neighbour gives this ball at
    most its own energy. The contact gets a wrong energy only by the rounding of the ball's velocity. Ahead of a wave no
    neighbour has moved. There only energies that underflow are taken for rounding.
    """
    share = ROUNDING_OF_STEPS
    if has_dashpot(contact):
        share = 0.0
    elif has_series(contact):
        share = ROUNDING
    return share * contact.reach + UNDERFLOW * energy


@kernel_helper
def still_rounding(c, n, energy):
    """Set rate and force to 0 in each contact in compression whose energy is only rounding."""
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
    """Unite the two bodies of contact i for the rest of the collision, and return the number of remaining contacts."""
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
    """Compute the velocities of the balls from the rates of compression, and write them into a row of `out`.

    The first velocity is written into `column`. `drift` is the velocity of the centre of mass, which is not used on a
    table. From the derivatives of rates and the acceleration of the centre of mass the function computes the
    accelerations of the balls.
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
    """Write the velocities of the balls into a row, and return their kinetic energy.

    The energy is relative to the centre of mass or to the table.
    """
    write_ball_values(c, n, c.w, drift, velocities, row, np.int64(0))
    energy = 0.0
    for ball in range(velocities.shape[1]):
        energy += 0.5 * masses[row, ball] * (velocities[row, ball] - drift) ** 2
    return energy


@kernel_helper
def kinetic_energy(c, n):
    """Return the kinetic energy relative to the centre of mass or the table, computed from rates of compression.

    The bodies are added from the top. Each body adds the energy of its motion relative to the centre of mass of the
    bodies above it. The relative velocity is moment/mass. The energy is not computed from the velocities of the balls:
    rounding of the velocity of a ball that is 1e30 times as heavy as the others would hide their energy.
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
    """Return the sum of kinetic and strain energies of all contacts that are active or whose bodies approach."""
    total = 0.0
    for i in range(n):
        contact = c[i]
        if may_still_act(contact):
            total += 0.5 * contact.w * contact.w / (contact.a + c[i + 1].a) + strain_energy(contact)
    return total


@kernel_helper
def bring_to_rest(c, n):
    """Make all contacts inactive that are active or whose bodies approach, and set their rates to 0.

    The function returns their strain energy, which is lost, and whether a contact among them has a restitution below 1.
    If all restitutions are 1, the state is not the limit of infinitely many events, and the lost energy is only
    rounding.
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
