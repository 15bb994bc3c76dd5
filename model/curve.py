"""A collision along its impulse curve: the log of `pair.kernel.collide` filled in with the exact motion.

Inside S1 the points are equally spaced in time. In every other segment one contact works against one mass, a sinusoid
in which the compression rate is d = W cos(theta) and the strain energy m W^2 sin^2(theta)/2; the points are equally
spaced in theta, with a break where compression ends and W drops to e W.
"""

from __future__ import annotations

from itertools import pairwise
from math import atan2, ceil, inf, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.collision import (
    STATES,
    Collision,
    Event,
    ImpulseCurve,
    in_unit,
)
from impact_xval.model.compiled import compiled
from impact_xval.model.pair.kernel import (
    RATE1,
    RATE2,
    RETURN1,
    RETURN2,
    S1,
    S3,
    S4,
    SPENT1,
    SPENT2,
)
from impact_xval.model.pair.law import COMPRESSION, RESTITUTION, ImpactLaw
from impact_xval.model.pair.motion import (
    amplitudes,
    modal,
    modes_of,
    motion,
)

#: Points per half period of the fastest sinusoid of a segment.
POINTS = 48

#: Most points of one segment; a segment of thousands of oscillations is then undersampled, its ends stay exact.
MOST_POINTS = 4000


class Row(NamedTuple):
    """One row of the log: a segment, in the scaled units of the kernel (`pair.kernel.LOG_COLUMNS`)."""

    state: int
    phase1: int
    phase2: int
    d1: float
    v2: float
    E1: float
    E2: float
    k1: float
    k2: float
    duration: float
    cause: int
    limit: bool


class Piece(NamedTuple):
    """Points of one smooth piece of the path: d1, v2, E1, E2 scaled, time in s since its start."""

    state: int
    phase1: int
    phase2: int
    d1: NDArray[np.float64]
    v2: NDArray[np.float64]
    E1: NDArray[np.float64]
    E2: NDArray[np.float64]
    time: NDArray[np.float64]


def trace(
    collision: Collision, log: NDArray[np.float64], law: ImpactLaw
) -> tuple[ImpulseCurve, tuple[Event, ...]]:
    """Fill in the path between the rows of a complete log, and name its events.

    Parameters
    ----------
    collision : Collision
        Whose units the result is in.
    log : ndarray, shape (n, LOG_WIDTH)
        As written by `collide`; the last row is the end.
    law : ImpactLaw
        As given to `collide`.

    Returns
    -------
    ImpulseCurve, tuple of Event
        Times are infinite from where a contact without stiffness has to finish.
    """
    rows = [Row(*map(int, r[:3]), *r[3:10], int(r[10]), bool(r[11])) for r in log.tolist()]  # type: ignore[call-arg]
    pieces, happened = _pieces(collision, rows, law)
    starts = np.cumsum([0.0, *(s.time[-1] for s in pieces)])
    first = np.cumsum([0, *(s.time.size for s in pieces)])
    c, speed = collision, -collision.v0
    v2 = np.concatenate([s.v2 for s in pieces])
    v1 = v2 - np.concatenate([s.d1 for s in pieces])
    unit = c.units

    def per_piece(name: str) -> NDArray[np.int64]:
        return np.concatenate([np.full(s.time.size, getattr(s, name)) for s in pieces])

    path = ImpulseCurve(
        time=np.concatenate([start + s.time for start, s in zip(starts, pieces, strict=False)]),
        impulse1=(1 + v1) * unit.impulse,
        impulse2=(1 + v1 + c.mass_ratio * v2) * unit.impulse,
        v1=v1 * speed,
        v2=v2 * speed,
        energy1=in_unit(np.concatenate([s.E1 for s in pieces]), unit.energy),
        energy2=in_unit(np.concatenate([s.E2 for s in pieces]), unit.energy),
        state=per_piece("state"),
        phase1=per_piece("phase1"),
        phase2=per_piece("phase2"),
    )
    events = []
    for kind, contact, before in happened:
        i = first[before]
        numbers = (float(x[i]) for x in (path.time, path.impulse1, path.impulse2, path.v1, path.v2))
        events.append(Event(kind, contact, STATES[path.state[i]], *numbers))
    return path, tuple(events)


def _pieces(
    collision: Collision, rows: list[Row], law: ImpactLaw
) -> tuple[list[Piece], list[tuple[str, int, int]]]:
    """All pieces, the end included, and the events: kind, contact, number of pieces before it."""
    pieces: list[Piece] = []
    events: list[tuple[str, int, int]] = []
    ends = [0, 0]  # ends of compression that either contact's stiffness keeps
    for row, after in pairwise(rows):
        if row.limit and not any(kind == "limit" for kind, _, _ in events):
            events.append(("limit", 0, len(pieces)))
        if row.state == S1 and not row.limit:
            pieces.append(_both_contacts(collision, row))
            for bit, contact, phase in ((RATE1, 1, row.phase1), (RATE2, 2, row.phase2)):
                if row.cause & bit and phase == COMPRESSION:
                    ends[contact - 1] += 1
                    events.append(("end-of-compression", contact, len(pieces)))
                elif row.cause & bit:
                    ends[contact - 1] *= law.stiffens
                    events.append(("restart-of-compression", contact, len(pieces)))
        else:
            made, contact = _one_contact(collision, row, after, ends)
            pieces.append(made[0])
            if len(made) == 2:
                ends[contact - 1] += 1
                events.append(("end-of-compression", contact, len(pieces)))
                pieces.append(made[1])
        for bit, kind, contact in (
            (SPENT1, "end-of-restitution", 1),
            (SPENT2, "end-of-restitution", 2),
            (RETURN1, "return", 1),
            (RETURN2, "return", 2),
        ):
            if row.cause & bit:
                events.append((kind, contact, len(pieces)))
                if kind == "return":
                    ends[contact - 1] *= law.stiffens
    last = rows[-1]
    pieces.append(Piece(S4, 0, 0, *(np.array([x]) for x in (last.d1, last.v2, 0.0, 0.0, 0.0))))
    return pieces, events


def _both_contacts(collision: Collision, row: Row) -> Piece:
    """S1: the two modes, over the duration that the search for the first event found."""
    t, d1, v2, E1, E2 = _points(
        collision.mass_ratio, row.k1, row.k2, row.d1, row.v2, row.E1, row.E2, row.duration
    )
    return Piece(1, row.phase1, row.phase2, d1, v2, E1, E2, in_unit(t, collision.units.time))


@compiled
def _points(mu, k1, k2, d1, v2, E1, E2, duration):
    """Rows t, d1, v2, E1, E2 at the points of a segment of S1; shape (5, n)."""
    modes = modes_of(mu, k1, k2)
    a, b = amplitudes(d1, v2, sqrt(2 * E1 / k1), sqrt(2 * E2 / k2), modes)
    n = min(MOST_POINTS, 3 + ceil(POINTS * modes.omega[1] * duration / pi))
    out = np.empty((5, n))
    for i in range(n):
        t = duration * i / (n - 1)
        q, r = modal(t, modes.omega, a, b)
        rate, v, f1, f2 = motion(q, r, modes)
        out[0, i], out[1, i], out[2, i] = t, rate, v
        out[3, i], out[4, i] = f1 * f1 / (2 * k1), f2 * f2 / (2 * k2)
    return out


def _one_contact(collision: Collision, row: Row, after: Row, ends: list[int]) -> tuple[list[Piece], int]:
    """Any other segment: the contact at work and its one or two sinusoids (compression, restitution)."""
    mu = collision.mass_ratio
    M = mu / (1 + mu)
    # Which contact works, against which mass (per m1), and what it does to d1 and v2 per unit of its rate.
    if row.state == S3 or (row.state == S1 and row.cause == SPENT1):
        contact, mass, on_d1, on_v2 = 1, M, 1.0, M / mu  # B1 against B2, both free
    elif row.d1 == after.d1 == 0:
        contact, mass, on_d1, on_v2 = 2, 1 + mu, 0.0, -1.0  # both as one body
    elif row.v2 == after.v2 == 0:
        contact, mass, on_d1, on_v2 = 1, 1.0, 1.0, 0.0  # B1 against B2 as part of the table
    else:
        contact, mass, on_d1, on_v2 = 2, mu, -1.0, -1.0  # B2 against the table
    if row.state == S3 and row.v2 == after.v2 == 0:
        mass, on_v2 = 1.0, 0.0
    k, e, phase = (
        (collision.k1, collision.e1, row.phase1) if contact == 1 else (collision.k2, collision.e2, row.phase2)
    )
    rate, E = (row.d1, row.E1) if contact == 1 else (-row.v2, row.E2)
    rate_after, E_after = (after.d1, after.E1) if contact == 1 else (-after.v2, after.E2)
    # Of e below 1e-162 the square is 0: rigid from the end of compression on, as with e = 0.
    softness, square = e ** (2 * ends[contact - 1]), e * e
    stiffness = k / softness if softness > 0 else inf

    pieces: list[Piece] = []

    def add(start: float, stop: float, W: float, stiffness: float, phase: int) -> None:
        theta = np.linspace(start, stop, 3 + ceil(POINTS * abs(stop - start) / pi))
        d = W * np.cos(theta)
        energy = 0.5 * mass * (W * np.sin(theta)) ** 2
        unit = sqrt(mass * collision.m1 / stiffness) if stiffness > 0 else inf
        # A segment may end before it starts, to a rounding; an infinite time does not pass back.
        turned = theta - start if unit < inf else np.maximum(theta - start, 0.0)
        time = in_unit(turned, unit)
        still = np.full_like(theta, 1.0)
        shift = d - rate
        pieces.append(
            Piece(
                row.state,
                phase if contact == 1 else row.phase1,
                phase if contact == 2 else row.phase2,
                row.d1 + on_d1 * shift,
                row.v2 + on_v2 * shift,
                energy if contact == 1 else row.E1 * still,
                energy if contact == 2 else row.E2 * still,
                time,
            )
        )

    W = sqrt(rate * rate + 2 * E / mass)
    start = atan2(sqrt(2 * E / mass), rate)
    stop = atan2(sqrt(2 * E_after / mass), rate_after) if E_after > 0 or rate_after > 0 else pi
    if phase == COMPRESSION and not (rate_after > 0 and E_after > 0):
        add(start, pi / 2, W, stiffness, COMPRESSION)
        add(pi / 2, stop, e * W, stiffness / square if square > 0 else inf, RESTITUTION)
    else:
        add(start, stop, W, stiffness, phase)
    return pieces, contact
