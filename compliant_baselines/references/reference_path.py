"""The path and the events of a reference, from the log its kernel wrote."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from impact_xval.compliant_baselines.references.piecewise import (
    END_OF_COMPRESSION,
    END_OF_RESTITUTION,
    LIMIT,
    RESTART_OF_COMPRESSION,
    RETURN,
)
from impact_xval.compliant_baselines.references.taylor import (
    LINEAR,
    ORDER,
    evaluate,
    expand,
    expand_product,
)
from impact_xval.model.collision import (
    STATES,
    Collision,
    Event,
    ImpulseCurve,
)

Floats = NDArray[np.float64]

#: Points of a stretch, both ends included. A stretch is at most two radians of the fastest motion.
POINTS = 9

KINDS = {
    END_OF_COMPRESSION: "end-of-compression",
    RESTART_OF_COMPRESSION: "restart-of-compression",
    END_OF_RESTITUTION: "end-of-restitution",
    RETURN: "return",
    LIMIT: "limit",
}


class KernelLaw(NamedTuple):
    """What a log does not say of itself.

    Attributes
    ----------
    force : int
        `taylor.LINEAR` or `taylor.PRODUCT`.
    c1, c2 : float
        Damping, scaled, as the kernel took it.
    carries : tuple of int
        Phases in which a contact carries force.
    phases : tuple of int
        For each phase of the log, that of an `ImpulseCurve`; empty where it is to be told from the rate.
    """

    force: int
    c1: float
    c2: float
    carries: tuple[int, ...]
    phases: tuple[int, ...] = ()


@njit(cache=True, error_model="numpy")
def _sample(log, law, mu, c1, c2, loaded1, loaded2, points):
    """Fill in p1, d1, q2, v2 at `points` instants of each stretch; shape (stretches, points, 4)."""
    table = np.zeros((4, ORDER + 1))
    out = np.empty((log.shape[0] - 1, points, 4))
    for n in range(log.shape[0] - 1):
        table[:] = 0.0
        for i in range(4):
            table[i, 0] = log[n, 1 + i]
        k1, a1 = (log[n, 6], c1) if loaded1[n] else (0.0, 0.0)
        k2, a2 = (log[n, 7], c2) if loaded2[n] else (0.0, 0.0)
        g = log[n, 11]
        carried = g if loaded2[n] else 0.0
        if law == LINEAR:
            expand(table, ORDER, log[n, 5], mu, k1, k2, a1, a2, carried, carried - g)
        else:
            r2 = mu * g / log[n, 7]
            expand_product(table, ORDER, log[n, 5], mu, k1, k2, a1, a2, r2, carried, carried - g)
        for j in range(points):
            at = evaluate(table, ORDER, j / (points - 1))
            for i in range(4):
                out[n, j, i] = at[i]
    return out


def trace(
    collision: Collision,
    log: Floats,
    law: KernelLaw,
    with_path: bool,
) -> tuple[ImpulseCurve | None, tuple[Event, ...], tuple[str, ...]]:
    """Read a log.

    Parameters
    ----------
    collision : Collision
        Whose units the result is in.
    log : ndarray, shape (n, LOG_WIDTH)
        As written by a kernel (`piecewise.LOG_COLUMNS`); the last row is the end.
    law : KernelLaw
        How to read it.
    with_path : bool
        Whether the path is wanted.

    Returns
    -------
    ImpulseCurve or None, tuple of Event, tuple of str
        ImpulseCurve, events, states. A closed-form limit is one stretch of which only the ends are known.
    """
    c, mu = collision, collision.mass_ratio
    phase = log[:, 8:10].astype(int)
    loaded = np.isin(phase, law.carries)
    state = np.where(loaded[:, 0], np.where(loaded[:, 1], 1, 3), np.where(loaded[:, 1], 2, 4))
    sequence = [int(s) for i, s in enumerate(state) if i == 0 or s != state[i - 1]]
    names = tuple(STATES[s] for s in (sequence if sequence[-1] == 4 else [*sequence, 4]))

    unit, speed = math.sqrt(c.m1 / c.k1), -c.v0
    momentum, energy = c.m1 * speed, c.m1 * speed**2

    # Gravity acts from the start or not at all, and until the first flight.
    falling = log[:, 11] > 0
    g = log[0, 11]
    fall = math.inf if falling.all() else log[np.argmin(falling), 0]

    def impulses(time: Floats, v1: Floats, v2: Floats) -> tuple[Floats, Floats]:
        fallen = g * np.minimum(time, fall)
        first = 1 + v1 + fallen
        return first, first + mu * (v2 + fallen)

    v2 = log[:, 4]
    v1 = v2 - log[:, 2]
    I1, I2 = impulses(log[:, 0], v1, v2)
    events = []
    for n in np.flatnonzero(log[:, 10]):
        kind, contact = divmod(int(log[n, 10]), 10)
        at = n if kind == LIMIT else n + 1  # a limit governs its own stretch, an event ends it
        numbers = (log[at, 0] * unit, I1[at] * momentum, I2[at] * momentum, v1[at] * speed, v2[at] * speed)
        events.append(Event(KINDS[kind], contact, STATES[state[at]], *map(float, numbers)))
    if not with_path:
        return None, tuple(events), names

    points = _sample(log, law.force, mu, law.c1, law.c2, loaded[:, 0], loaded[:, 1], POINTS)
    time = log[:-1, :1] + log[:-1, 5:6] * np.linspace(0, 1, POINTS)
    limited = np.flatnonzero(log[:-1, 10] == LIMIT * 10)
    points[limited, 1:] = log[limited + 1, None, 1:5]
    time[limited, 1:] = log[limited + 1, :1]

    def flat(rows: NDArray) -> NDArray:
        return np.append(np.repeat(rows[:-1], POINTS), rows[-1])

    p1, d1, q2, w2 = (np.append(points[:, :, i].ravel(), log[-1, 1 + i]) for i in range(4))
    time = np.append(time.ravel(), log[-1, 0])
    w1 = w2 - d1
    I1, I2 = impulses(time, w1, w2)
    p2 = q2 + mu * flat(log[:, 11]) / flat(log[:, 7])
    named = []
    for i, rate in ((0, d1), (1, -w2)):
        told = flat(phase[:, i])
        named.append(
            np.array(law.phases)[told]
            if law.phases
            else np.where(flat(loaded[:, i]), np.where(rate > 0, 1, 2), 0)
        )
    path = ImpulseCurve(
        time=time * unit,
        impulse1=I1 * momentum,
        impulse2=I2 * momentum,
        v1=w1 * speed,
        v2=w2 * speed,
        energy1=np.where(flat(loaded[:, 0]), 0.5 * flat(log[:, 6]) * p1**2, 0.0) * energy,
        energy2=np.where(flat(loaded[:, 1]), 0.5 * flat(log[:, 7]) * p2**2, 0.0) * energy,
        state=flat(state),
        phase1=named[0],
        phase2=named[1],
    )
    return path, tuple(events), names
