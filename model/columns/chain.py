"""The state of a column under way, and the impact law as what an event does to one contact of it.

Contact i is between bodies i and i + 1, counted from 0. A body is a ball, several that a rigid contact has united, or
the table, the last one, of infinite mass. The unknowns are, for each contact, the compression rate w = v_{i+1} - v_i
and the virtual deformation delta of positions that stay frozen, delta' = w, with the force F = k delta^p: equations
(13)-(15) of docs/theory.md in time, for any number of contacts. All of w and F are continuous through every event.

The law is that of `model.law` in these terms. At an end of compression E <- e^2 E, where E = k delta^(p+1)/(p + 1), and
F stays: delta <- e^2 delta, k <- k/e^(2p).
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.compiled import Floats, compiled, inlined
from impact_xval.model.law import COMPRESSION, INACTIVE, RESTITUTION

#: A contact in compression that has less than this share of the energy of impact is at rest; for linear contacts and
#: for others. Below it, errors decide what happens.
NOTHING, NOTHING_OF_STEPS = 1e-32, 1e-26


class Chain(NamedTuple):
    """A column under way; the arrays are changed in place.

    Attributes
    ----------
    a : ndarray, shape (C + 1,)
        Inverse masses of the bodies; 0 for the table.
    k, original, e : ndarray, shape (C,)
        Running and original stiffness, coefficient of restitution.
    w, delta : ndarray, shape (C,)
        Compression rate and deformation.
    phase : ndarray of int, shape (C,)
        `INACTIVE`, `COMPRESSION` or `RESTITUTION`.
    contact : ndarray of int, shape (C,)
        Which contact of the column this is: some become rigid and are left out.
    length : ndarray, shape (C,)
        Deformation that would hold all the energy of impact at the original stiffness.
    body : ndarray of int, shape (N,)
        Body of each ball.
    p : float
        Exponent of the forces.
    """

    a: NDArray[np.float64]
    k: NDArray[np.float64]
    original: NDArray[np.float64]
    e: NDArray[np.float64]
    w: NDArray[np.float64]
    delta: NDArray[np.float64]
    phase: NDArray[np.int64]
    contact: NDArray[np.int64]
    length: NDArray[np.float64]
    body: NDArray[np.int64]
    p: float


@inlined
def power_force(k: float, delta: float, p: float) -> float:
    """F = k delta^p."""
    if p == 1:
        return k * delta
    return k * delta**p if delta > 0 else 0.0


@inlined
def force(c: Chain, n: int, i: int) -> float:
    """Force of contact i; 0 of one that does not act, and beyond the ends of a chain of n contacts."""
    return power_force(c.k[i], c.delta[i], c.p) if 0 <= i < n and c.phase[i] != INACTIVE else 0.0


@inlined
def acceleration(c: Chain, n: int, i: int) -> float:
    """Return w' of contact i: what its own force and those of its neighbours do to it."""
    own = (c.a[i] + c.a[i + 1]) * force(c, n, i)
    return c.a[i] * force(c, n, i - 1) + c.a[i + 1] * force(c, n, i + 1) - own


@inlined
def tangent(c: Chain, i: int) -> float:
    """dF/ddelta of contact i."""
    return c.k[i] if c.p == 1 else c.p * c.k[i] * max(c.delta[i], 0.0) ** (c.p - 1)


@inlined
def strain(c: Chain, n: int, i: int) -> float:
    """Strain energy of contact i."""
    return force(c, n, i) * c.delta[i] / (c.p + 1)


@inlined
def oscillation(c: Chain, n: int, i: int) -> float:
    """Twice the energy of the oscillation of contact i on its own, at its running stiffness."""
    F = force(c, n, i)
    return (F * F / tangent(c, i) if F > 0 else 0.0) + c.w[i] * c.w[i] / (c.a[i] + c.a[i + 1])


@inlined
def neighbours(c: Chain, n: int, i: int) -> tuple[float, float, float, float]:
    """Return what the neighbours that act ask of contact i.

    Returns
    -------
    static, slope : float
        The force at which w_i' = 0, and its derivative in time.
    imposed : float
        Amplitude of the rate that their own oscillations impose on contact i: it follows slower ones, and faster ones
        move its bodies as if it did not act.
    swing : float
        The larger of their energies (`oscillation`).
    """
    inverse = c.a[i] + c.a[i + 1]
    frequency = inverse * tangent(c, i)
    static, slope, imposed, swing = 0.0, 0.0, 0.0, 0.0
    for j in (i - 1, i + 1):
        if 0 <= j < n and c.phase[j] != INACTIVE:
            shared, of_j, energy = c.a[max(i, j)], c.a[j] + c.a[j + 1], oscillation(c, n, j)
            static += shared / inverse * force(c, n, j)
            slope += shared / inverse * tangent(c, j) * c.w[j]
            imposed += shared * sqrt(energy / of_j) * min(1.0, of_j * tangent(c, j) / frequency)
            swing = max(swing, energy)
    return static, slope, imposed, swing


@compiled
def begin(c: Chain, n: int) -> None:
    """Let every contact act that approaches, or is at rest in a row of contacts at rest beside one that approaches."""
    for i in range(n):
        c.phase[i] = COMPRESSION if c.w[i] > 0 else INACTIVE
    for i in range(1, n):
        if c.w[i] == 0 and c.phase[i - 1] == COMPRESSION:
            c.phase[i] = COMPRESSION
    for i in range(n - 2, -1, -1):
        if c.w[i] == 0 and c.phase[i + 1] == COMPRESSION:
            c.phase[i] = COMPRESSION


@compiled
def still(c: Chain, n: int, nothing: float) -> None:
    """Bring to rest what has no energy: neighbours load a contact at rest long before it matters."""
    for i in range(n):
        if c.phase[i] == COMPRESSION and oscillation(c, n, i) <= nothing:
            c.w[i], c.delta[i] = 0.0, 0.0


@compiled
def rate_event(c: Chain, n: int, i: int, stiffens: bool, nothing: float, loss: float) -> float:
    """Apply the law where the rate of contact i is zero; the loss with the energy that it takes."""
    c.w[i] = 0.0
    e = c.e[i]
    if c.phase[i] == INACTIVE:
        c.phase[i] = COMPRESSION
        c.delta[i] = 0.0
        if not stiffens:
            c.k[i] = c.original[i]
    elif c.phase[i] == RESTITUTION:
        c.phase[i] = COMPRESSION
        if not stiffens:
            loss -= (1 / (e * e) - 1) * strain(c, n, i)
            c.delta[i] /= e * e
            c.k[i] = c.original[i]
    elif strain(c, n, i) <= nothing:
        loss += strain(c, n, i)
        spent(c, i)
    else:
        c.phase[i] = RESTITUTION
        loss += (1 - e * e) * strain(c, n, i)
        c.delta[i] *= e * e
        c.k[i] /= e ** (2 * c.p)
    return loss


@inlined
def spent(c: Chain, i: int) -> None:
    """End restitution: contact i is inactive and keeps its stiffness for a return."""
    c.phase[i] = INACTIVE
    c.delta[i] = 0.0


@compiled
def unite(c: Chain, n: int, i: int) -> int:
    """Make one body of the two that contact i joins, for good; the number of contacts that are left."""
    c.a[i] = 1 / (1 / c.a[i] + 1 / c.a[i + 1])
    for j in range(i + 1, n):
        c.a[j] = c.a[j + 1]
    for j in range(i, n - 1):
        c.k[j], c.original[j], c.e[j] = c.k[j + 1], c.original[j + 1], c.e[j + 1]
        c.w[j], c.delta[j] = c.w[j + 1], c.delta[j + 1]
        c.phase[j], c.contact[j] = c.phase[j + 1], c.contact[j + 1]
        c.length[j] = c.length[j + 1]
    for ball in range(c.body.size):
        if c.body[ball] > i:
            c.body[ball] -= 1
    return n - 1


@compiled
def ball_values(c: Chain, n: int, rates: Floats, drift: float, out: Floats) -> None:
    """Velocities of the balls of compression rates, or accelerations of their derivatives.

    Parameters
    ----------
    c, n
        The column, and its number of contacts.
    rates : ndarray, shape (n,) or more
    drift : float
        Of the centre of mass; without meaning on a table.
    out : ndarray, shape (N,)
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
