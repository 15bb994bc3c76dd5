"""The state of a chain under way.

Contact i is between bodies i and i + 1, counted from 0. A body is a ball, several that a rigid contact has united, or
the table, the last one, of infinite mass. The unknowns are, for each contact, the compression rate w = v_{i+1} - v_i
and the deformation delta, delta' = w: of frozen positions only while the contact acts, which is equations (13)-(15) of
docs/theory.md in time; else always, negative across a gap. All of w and F are continuous through every event.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from impact_xval.model.chain.laws import carries, force, has_dashpot, has_series, rest, spent, spring
from impact_xval.model.compiled import uncounted
from impact_xval.model.pair.law import COMPRESSION, INACTIVE

#: Rounding of a neighbour's motion, as a share of its energy: the square of 2^-53, and what steps leave.
ROUNDING, ROUNDING_OF_STEPS = 1e-32, 1e-26

#: Far ahead of a wave a load underflows; below this share of the energy of impact it is none.
UNDERFLOW = 1e-150


#: A contact under way, and the body above it. The last record of a chain is the body below its last contact. It is
#: always INACTIVE, and as c[-1] it stands above the first contact too: both ends have a neighbour without force.
CONTACT = np.dtype(
    [
        # Inverse mass of the body, 0 for the table; running and original stiffness, coefficient of restitution, damping
        # of the law (`chain.laws`); compression rate and deformation.
        *((name, "f8") for name in ("a", "k", "original", "e", "b", "w", "delta")),
        # Deformation that would hold all the energy of impact at the original stiffness; twice the largest energy that
        # this contact or a neighbour has had (`oscillation`).
        *((name, "f8") for name in ("length", "reach")),
        # Gravity, of the contact with the table: 0 of others, without gravity, and from the first flight on.
        ("g", "f8"),
        # `INACTIVE`, `COMPRESSION`, `RESTITUTION` or `SLACK`; which contact of the collision this is, for some become
        # rigid and are left out; how many balls the body is.
        *((name, "i8") for name in ("phase", "contact", "balls")),
        # Those of the chain: one of `chain.laws`, exponent of the force, and whether positions are frozen.
        *(("law", "i8"), ("p", "f8"), ("frozen", "?")),
    ],
    align=True,
)


def new_chain(contacts: int, p: float, law: int, frozen: bool) -> Any:
    """Make a chain, a record a contact and one more, that `begin` fills in."""
    chain = np.zeros(contacts + 1, CONTACT).view(np.recarray)
    chain.p, chain.law, chain.frozen = p, law, frozen
    return chain


@uncounted
def begin(c, masses, stiffnesses, restitutions, dampings, rates, gaps, g):
    """Put a chain at first touch.

    Every closed contact acts that approaches, or is at rest in a row of closed ones beside one that does.
    """
    n = c.size - 1
    for i in range(n + 1):
        one, ball = c[i], i < masses.size
        one.a, one.balls = (1 / masses[i], 1) if ball else (0.0, 0)
        one.phase, one.g = INACTIVE, 0.0
    for i in range(n):
        one = c[i]
        one.k, one.original, one.e, one.b = stiffnesses[i], stiffnesses[i], restitutions[i], dampings[i]
        one.contact, one.reach, one.w, one.delta = i, 0.0, rates[i], -gaps[i]
        one.phase = COMPRESSION if one.w > 0 and gaps[i] == 0 else INACTIVE
    c[n - 1].g = g
    for step in (1, -1):
        for j in range(n - 1):
            i = j + 1 if step == 1 else n - 2 - j
            if c[i].w == 0 and gaps[i] == 0 and c[i - step].phase == COMPRESSION:
                c[i].phase = COMPRESSION


@uncounted
def acceleration(c, i):
    """Return w' of contact i: what its own force and those of its neighbours do to it; other bodies fall together."""
    above, below = c[i].a, c[i + 1].a
    own = (above + below) * force(c[i])
    return above * force(c[i - 1]) + below * force(c[i + 1]) - own + c[i].g


@uncounted
def tangent(one):
    """dF/ddelta of the spring of a contact."""
    return one.k if one.p == 1 else one.p * one.k * max(one.delta, 0.0) ** (one.p - 1)


@uncounted
def tangent_at(one, F):
    """dF/ddelta of the spring of a contact where its force is F."""
    return one.p * one.k * (F / one.k) ** (1 - 1 / one.p) if F > 0 else 0.0


@uncounted
def strain(one):
    """Strain energy of the spring of a contact, where it acts."""
    return spring(one) * (one.delta + rest(one)) / (one.p + 1) if carries(one) else 0.0


@uncounted
def oscillation(c, i):
    """Twice the energy of the oscillation of contact i on its own, at its running stiffness."""
    one = c[i]
    F = spring(one) if carries(one) else 0.0
    return (F * F / tangent(one) if F > 0 else 0.0) + one.w * one.w / (one.a + c[i + 1].a)


@uncounted
def neighbours(c, i):
    """Return what the neighbours that act ask of contact i: static, slope, imposed, swing.

    The force at which w_i' = 0, and its derivative in time; the amplitude of the rate that their own oscillations
    impose on contact i, which follows slower ones, while faster ones move its bodies as if it did not act; and the
    larger of their energies (`oscillation`).
    """
    inverse = c[i].a + c[i + 1].a
    frequency = inverse * tangent(c[i])
    static, slope, imposed, swing = c[i].g / inverse, 0.0, 0.0, 0.0
    for j in range(i - 1, i + 2, 2):
        other = c[j]
        if carries(other):
            shared, of_j, energy = c[max(i, j)].a, other.a + c[j + 1].a, oscillation(c, j)
            static += shared / inverse * force(other)
            slope += shared / inverse * tangent(other) * other.w
            faster = of_j * tangent(other)
            imposed += shared * sqrt(energy / of_j) * (faster / frequency if faster < frequency else 1.0)
            swing = max(swing, energy)
    return static, slope, imposed, swing


@uncounted
def nothing(one, energy):
    """Energy of a contact, twice, that rounding can make: of its neighbours' motion so far, or where loads underflow.

    A neighbour gives the ball that both share at most a kinetic energy of its own, and rounding of that velocity is all
    that the contact can have of it by mistake. Ahead of a wave no neighbour has moved, and the smallest load counts.
    """
    share = 0.0 if has_dashpot(one) else ROUNDING if has_series(one) else ROUNDING_OF_STEPS
    return share * one.reach + UNDERFLOW * energy


@uncounted
def still(c, n, energy):
    """Bring to rest the contacts in compression that have no energy but that of rounding."""
    before, own, after = 0.0, 0.0, 0.0
    for i in range(-1, n):
        before, own, after = own, after, oscillation(c, i + 1) if i + 1 < n else 0.0
        if i >= 0:
            c[i].reach = max(max(c[i].reach, before), max(own, after))
    for i in range(n):
        one = c[i]
        if one.phase == COMPRESSION and oscillation(c, i) <= nothing(one, energy):
            one.w, one.delta = 0.0, 0.0 - rest(one)


@uncounted
def unite(c, n, i):
    """Make one body of the two that contact i joins, for good; the number of contacts that are left."""
    last = c[n - 1]
    last.delta += rest(last)
    g, inverse, balls = last.g, 1 / (1 / c[i].a + 1 / c[i + 1].a), c[i].balls + c[i + 1].balls
    for j in range(i, n):
        c[j] = c[j + 1]
    c[i].a, c[i].balls = inverse, balls
    if n > 1:
        last = c[n - 2]
        last.g = g
        last.delta -= rest(last)
    return n - 1


@uncounted
def ball_values(c, n, rates, drift, out, row, column):
    """Write the velocities of the balls of compression rates, or accelerations of their derivatives, into a row.

    `drift` is that of the centre of mass; without meaning on a table. `column` is that of the first ball.
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


@uncounted
def energy_of(c, n, masses, drift, velocities, row):
    """Write the velocities of the balls into a row; their energy relative to the centre of mass or the table."""
    ball_values(c, n, c.w, drift, velocities, row, np.int64(0))
    energy = 0.0
    for ball in range(velocities.shape[1]):
        energy += 0.5 * masses[row, ball] * (velocities[row, ball] - drift) ** 2
    return energy


@uncounted
def kinetic_energy(c, n):
    """Kinetic energy relative to the centre of mass or the table, of rates alone.

    Body after body is added, with its velocity moment/mass relative to the centre of mass of those above it. Velocities
    (`energy_of`) do not tell: beside a ball 1e30 times as heavy, all of the energy of others is lost in its rounding.
    """
    total, mass, moment = 0.0, 0.0, 0.0
    for i in range(n):
        mass += 1 / c[i].a
        moment += mass * c[i].w
        total += 0.5 * (moment / mass) ** 2 / (1 / mass + c[i + 1].a)
    return total


@uncounted
def energy_left(c, n):
    """Energy of the contacts that act, and of the approach of bodies whose gap will close."""
    total = 0.0
    for i in range(n):
        one = c[i]
        if carries(one) or (one.w > 0 and not one.frozen):
            total += 0.5 * one.w * one.w / (one.a + c[i + 1].a) + strain(one)
    return total


@uncounted
def bring_to_rest(c, n):
    """End all that acts or approaches, with no rate left: the strain energy dropped, and whether any of it is lossy.

    If none is, no energy went but that of rounding, and no events without end led here.
    """
    dropped, lossy = 0.0, False
    for i in range(n):
        one = c[i]
        if carries(one) or (one.w > 0 and not one.frozen):
            dropped += strain(one)
            lossy |= one.e < 1
            one.w = 0.0
            spent(one)
    return dropped, lossy
