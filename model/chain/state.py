"""The state of a chain under way.

Contact i is between bodies i and i + 1, counted from 0. A body is a ball, several that a rigid contact has united, or
the table, the last one, of infinite mass. The unknowns are, for each contact, the compression rate w = v_{i+1} - v_i
and the deformation delta, delta' = w: of frozen positions only while the contact acts, which is equations (13)-(15) of
docs/theory.md in time; else always, negative across a gap. All of w and F are continuous through every event.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.chain.laws import carries, force, has_dashpot, has_series, rest, spent, spring
from impact_xval.model.compiled import uncounted
from impact_xval.model.pair.law import COMPRESSION, INACTIVE

#: Rounding of a neighbour's motion, as a share of its energy: the square of 2^-53, and what steps leave.
ROUNDING, ROUNDING_OF_STEPS = 1e-32, 1e-26

#: Far ahead of a wave a load underflows; below this share of the energy of impact it is none.
UNDERFLOW = 1e-150


class Chain(NamedTuple):
    """A chain under way; the arrays are changed in place.

    Without a comment on its shape an array has shape (C,), an element a contact.
    """

    #: Inverse masses of the bodies, shape (C + 1,); 0 for the table.
    a: NDArray[np.float64]
    #: Running and original stiffness, coefficient of restitution, damping of the law (`chain.laws`).
    k: NDArray[np.float64]
    original: NDArray[np.float64]
    e: NDArray[np.float64]
    b: NDArray[np.float64]
    #: Compression rate and deformation.
    w: NDArray[np.float64]
    delta: NDArray[np.float64]
    #: `INACTIVE`, `COMPRESSION`, `RESTITUTION` or `SLACK`.
    phase: NDArray[np.int64]
    #: Which contact of the collision this is: some become rigid and are left out.
    contact: NDArray[np.int64]
    #: Deformation that would hold all the energy of impact at the original stiffness.
    length: NDArray[np.float64]
    #: Twice the largest energy that this contact or a neighbour has had (`oscillation`).
    reach: NDArray[np.float64]
    #: Body of each ball, shape (N,).
    body: NDArray[np.int64]
    #: Exponent of the forces, one of `chain.laws`, and whether positions are frozen.
    p: float
    law: int
    frozen: bool
    #: Gravity, shape (1,): 0 without and from the first flight on; above 0 only on a table (`laws.rest`).
    g: NDArray[np.float64]


def new_chain(balls: int, contacts: int, p: float, law: int, frozen: bool) -> Chain:
    """Make a chain, a body a ball, that `begin` fills in."""
    k, original, e, b, w, delta, length, reach = np.zeros((8, contacts))
    phase, contact = np.zeros((2, contacts), np.int64)
    a, body = np.zeros(contacts + 1), np.zeros(balls, np.int64)
    return Chain(
        a, k, original, e, b, w, delta, phase, contact, length, reach, body, p, law, frozen, np.zeros(1)
    )


@uncounted
def begin(c, masses, stiffnesses, restitutions, dampings, rates, gaps, g):
    """Put a chain at first touch.

    Every closed contact acts that approaches, or is at rest in a row of closed ones beside one that does.
    """
    n = c.k.size
    c.g[0], c.a[n] = g, 0.0
    for ball in range(c.body.size):
        c.a[ball], c.body[ball] = 1 / masses[ball], ball
    for i in range(n):
        c.k[i], c.original[i] = stiffnesses[i], stiffnesses[i]
        c.e[i], c.b[i], c.contact[i], c.reach[i] = restitutions[i], dampings[i], i, 0.0
        c.w[i], c.delta[i] = rates[i], -gaps[i]
        c.phase[i] = COMPRESSION if c.w[i] > 0 and gaps[i] == 0 else INACTIVE
    for step in (1, -1):
        for j in range(n - 1):
            i = j + 1 if step == 1 else n - 2 - j
            if c.w[i] == 0 and gaps[i] == 0 and c.phase[i - step] == COMPRESSION:
                c.phase[i] = COMPRESSION


@uncounted
def acceleration(c, n, i):
    """Return w' of contact i: what its own force and those of its neighbours do to it."""
    own = (c.a[i] + c.a[i + 1]) * force(c, n, i)
    fall = c.g[0] if i == n - 1 else 0.0  # other bodies fall together
    return c.a[i] * force(c, n, i - 1) + c.a[i + 1] * force(c, n, i + 1) - own + fall


@uncounted
def tangent(c, i):
    """dF/ddelta of the spring of contact i."""
    return c.k[i] if c.p == 1 else c.p * c.k[i] * max(c.delta[i], 0.0) ** (c.p - 1)


@uncounted
def strain(c, n, i):
    """Strain energy of the spring of contact i, where it acts."""
    return spring(c, n, i) * (c.delta[i] + rest(c, n, i)) / (c.p + 1) if carries(c.phase[i]) else 0.0


@uncounted
def oscillation(c, n, i):
    """Twice the energy of the oscillation of contact i on its own, at its running stiffness."""
    F = spring(c, n, i) if carries(c.phase[i]) else 0.0
    return (F * F / tangent(c, i) if F > 0 else 0.0) + c.w[i] * c.w[i] / (c.a[i] + c.a[i + 1])


@uncounted
def neighbours(c, n, i):
    """Return what the neighbours that act ask of contact i: static, slope, imposed, swing.

    The force at which w_i' = 0, and its derivative in time; the amplitude of the rate that their own oscillations
    impose on contact i, which follows slower ones, while faster ones move its bodies as if it did not act; and the
    larger of their energies (`oscillation`).
    """
    inverse = c.a[i] + c.a[i + 1]
    frequency = inverse * tangent(c, i)
    static, slope, imposed, swing = c.g[0] / inverse if i == n - 1 else 0.0, 0.0, 0.0, 0.0
    for j in (i - 1, i + 1):
        if 0 <= j < n and carries(c.phase[j]):
            shared, of_j, energy = c.a[max(i, j)], c.a[j] + c.a[j + 1], oscillation(c, n, j)
            static += shared / inverse * force(c, n, j)
            slope += shared / inverse * tangent(c, j) * c.w[j]
            imposed += shared * sqrt(energy / of_j) * min(1.0, of_j * tangent(c, j) / frequency)
            swing = max(swing, energy)
    return static, slope, imposed, swing


@uncounted
def nothing(c, i, energy):
    """Energy of contact i, twice, that rounding can make: of its neighbours' motion so far, or where loads underflow.

    A contact j gives the ball that it shares with i at most a kinetic energy of its own, and rounding of that velocity
    is all that i can have of it by mistake. Ahead of a wave no neighbour has moved, and the smallest load counts.
    """
    share = 0.0 if has_dashpot(c) else ROUNDING if has_series(c) else ROUNDING_OF_STEPS
    return share * c.reach[i] + UNDERFLOW * energy


@uncounted
def still(c, n, energy):
    """Bring to rest the contacts in compression that have no energy but that of rounding."""
    before, own, after = 0.0, 0.0, 0.0
    for i in range(-1, n):
        before, own, after = own, after, oscillation(c, n, i + 1) if i + 1 < n else 0.0
        if i >= 0:
            c.reach[i] = max(c.reach[i], before, own, after)
    for i in range(n):
        if c.phase[i] == COMPRESSION and oscillation(c, n, i) <= nothing(c, i, energy):
            c.w[i], c.delta[i] = 0.0, 0.0 - rest(c, n, i)


@uncounted
def unite(c, n, i):
    """Make one body of the two that contact i joins, for good; the number of contacts that are left."""
    c.delta[n - 1] += rest(c, n, n - 1)
    c.a[i] = 1 / (1 / c.a[i] + 1 / c.a[i + 1])
    for j in range(i + 1, n):
        c.a[j] = c.a[j + 1]
    for numbers in (c.k, c.original, c.e, c.b, c.w, c.delta, c.length, c.reach):
        for j in range(i, n - 1):
            numbers[j] = numbers[j + 1]
    for j in range(i, n - 1):
        c.phase[j], c.contact[j] = c.phase[j + 1], c.contact[j + 1]
    for ball in range(c.body.size):
        if c.body[ball] > i:
            c.body[ball] -= 1
    if n > 1:
        c.delta[n - 2] -= rest(c, n - 1, n - 2)
    return n - 1


@uncounted
def ball_values(c, n, rates, drift, out):
    """Write to `out` the velocities of the balls of compression rates, or accelerations of their derivatives.

    `drift` is that of the centre of mass; without meaning on a table.
    """
    last = 0.0
    if c.a[n] > 0:
        mass, moment = 0.0, 0.0
        for i in range(n):
            mass += 1 / c.a[i]
            moment += mass * rates[i]
        last = drift + moment / (mass + 1 / c.a[n])
    ball = c.body.size - 1
    for i in range(n, -1, -1):
        if i < n:
            last -= rates[i]
        while ball >= 0 and c.body[ball] == i:
            out[ball] = last
            ball -= 1


@uncounted
def energy_of(c, n, masses, drift, velocities):
    """Write the velocities of the balls, and return their energy relative to the centre of mass or the table."""
    ball_values(c, n, c.w, drift, velocities)
    energy = 0.0
    for ball in range(masses.size):
        energy += 0.5 * masses[ball] * (velocities[ball] - drift) ** 2
    return energy


@uncounted
def kinetic_energy(c, n):
    """Kinetic energy relative to the centre of mass or the table, of rates alone.

    Body after body is added, with its velocity moment/mass relative to the centre of mass of those above it. Velocities
    (`energy_of`) do not tell: beside a ball 1e30 times as heavy, all of the energy of others is lost in its rounding.
    """
    total, mass, moment = 0.0, 0.0, 0.0
    for i in range(n):
        mass += 1 / c.a[i]
        moment += mass * c.w[i]
        total += 0.5 * (moment / mass) ** 2 / (1 / mass + c.a[i + 1])
    return total


@uncounted
def energy_left(c, n):
    """Energy of the contacts that act, and of the approach of bodies whose gap will close."""
    total = 0.0
    for i in range(n):
        if carries(c.phase[i]) or (c.w[i] > 0 and not c.frozen):
            total += 0.5 * c.w[i] * c.w[i] / (c.a[i] + c.a[i + 1]) + strain(c, n, i)
    return total


@uncounted
def bring_to_rest(c, n):
    """End all that acts or approaches, with no rate left: the strain energy dropped, and whether any of it is lossy.

    If none is, no energy went but that of rounding, and no events without end led here.
    """
    dropped, lossy = 0.0, False
    for i in range(n):
        if carries(c.phase[i]) or (c.w[i] > 0 and not c.frozen):
            dropped += strain(c, n, i)
            lossy |= c.e[i] < 1
            c.w[i] = 0.0
            spent(c, n, i)
    return dropped, lossy
