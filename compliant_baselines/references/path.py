"""States, events and impulse curve of a collision, from the log that the driver wrote."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from impact_xval.compliant_baselines.references.contact_law import (
    END_OF_COMPRESSION,
    END_OF_RESTITUTION,
    LIMIT,
    LOADED,
    RESTART_OF_COMPRESSION,
    RETURN,
    SLACK,
    carries,
)
from impact_xval.compliant_baselines.references.driver import Law, dampings, fill_motion
from impact_xval.compliant_baselines.references.taylor import ORDER, evaluate
from impact_xval.model.collision import STATES, Collision, Event, ImpulseCurve, in_unit

Floats = NDArray[np.float64]

#: Points of a segment, both ends included. A segment is at most two radians of the fastest motion.
POINTS = 9

KINDS = {
    END_OF_COMPRESSION: "end-of-compression",
    RESTART_OF_COMPRESSION: "restart-of-compression",
    END_OF_RESTITUTION: "end-of-restitution",
    RETURN: "return",
    LIMIT: "limit",
}

#: Phases of an `ImpulseCurve` by mode; that of a LOADED contact is in its rate.
PHASE = np.array([0, 0, -1, 1, 2])


@njit(cache=True, error_model="numpy")
def _sample(log, law, mu, c1, c2, points):
    """Fill in p1, d1, q2, v2 at `points` instants of each segment; shape (segments, points, 4)."""
    table = np.zeros((4, ORDER + 1))
    degree = (
        table.shape[1] - 1
    )  # no literal, for which numba would compile once more what fills in the motion
    out = np.empty((log.shape[0] - 1, points, 4))
    for n in range(log.shape[0] - 1):
        for i in range(4):
            table[i, 0] = log[n, 1 + i]
        on1, on2 = carries(log[n, 8]), carries(log[n, 9])
        k1, k2, g = log[n, 6], log[n, 7], log[n, 11]
        b1, b2 = dampings(law, log[n, 8], log[n, 9], c1, c2)
        fill_motion(table, degree, log[n, 5], law, on1, on2, mu, k1, k2, b1, b2, mu * g / k2, g)
        for j in range(points):
            at = evaluate(table, degree, j / (points - 1))
            for i in range(4):
                out[n, j, i] = at[i]
    return out


def states_of(log: Floats) -> NDArray[np.int64]:
    """State of each row of a log, 1 to 4."""
    return 4 - (log[:, 8:10] > SLACK) @ np.array([1, 2])


def state_names(log: Floats) -> tuple[str, ...]:
    """State sequence of a log, S4 at its end."""
    state = states_of(log)
    changes = state[np.append(True, state[1:] != state[:-1])]
    return tuple(STATES[s] for s in (changes if changes[-1] == 4 else [*changes, 4]))


def _impulses(log: Floats, mu: float, time: Floats, v1: Floats, v2: Floats) -> tuple[Floats, Floats]:
    """Impulses so far, by the balance of momentum. Gravity acts from the start or not at all, and until the flight."""
    falling = log[:, 11] > 0
    fall = math.inf if falling.all() else log[np.argmin(falling), 0]
    fallen = log[0, 11] * np.minimum(time, fall)
    first = 1 + v1 + fallen
    return first, first + mu * (v2 + fallen)


#: What leaves double precision is said where an outcome is checked (`contract.answers`).
_beyond = np.errstate(over="ignore", invalid="ignore")


@_beyond
def events_of(collision: Collision, log: Floats) -> tuple[Event, ...]:
    """Events of a log, in the collision's units."""
    unit, state = collision.units, states_of(log)
    v1, v2 = log[:, 4] - log[:, 2], log[:, 4]
    I1, I2 = _impulses(log, collision.mass_ratio, log[:, 0], v1, v2)
    events = []
    for n in np.flatnonzero(log[:, 10]):
        kind, contact = divmod(int(log[n, 10]), 10)
        at = n if kind == LIMIT else n + 1  # a limit governs its own segment, an event ends it
        scaled = log[at, 0] * unit.time, I1[at] * unit.impulse, I2[at] * unit.impulse
        velocities = v1[at] * unit.velocity, v2[at] * unit.velocity
        events.append(Event(KINDS[kind], contact, STATES[state[at]], *map(float, scaled + velocities)))
    return tuple(events)


@_beyond
def curve_of(collision: Collision, log: Floats, law: Law) -> ImpulseCurve:
    """Impulse curve of a log, in the collision's units. Of a closed-form limit only the ends are known."""
    mu, unit = collision.mass_ratio, collision.units
    points = _sample(log, law.code, mu, *law.dampings, POINTS)
    time = log[:-1, :1] + log[:-1, 5:6] * np.linspace(0, 1, POINTS)
    limited = np.flatnonzero(log[:-1, 10] == LIMIT * 10)
    # A polynomial through both would mean nothing, and may leave double precision.
    points[limited, 0], points[limited, 1:] = log[limited, 1:5], log[limited + 1, None, 1:5]
    time[limited, 1:] = log[limited + 1, :1]

    p1, d1, q2, v2 = (np.append(points[:, :, i].ravel(), log[-1, 1 + i]) for i in range(4))
    time, v1 = np.append(time.ravel(), log[-1, 0]), v2 - d1
    rows = np.append(np.repeat(np.arange(len(log) - 1), POINTS), len(log) - 1)
    k1, k2, mode1, mode2, g = log[rows][:, [6, 7, 8, 9, 11]].T
    energies = [
        # Neither the unit of energy nor the square of a velocity, which may leave double precision.
        np.where(mode > SLACK, 0.5 * (k * (collision.m1 * p * unit.velocity)) * (p * unit.velocity), 0.0)
        for mode, k, p in ((mode1, k1, p1), (mode2, k2, q2 + mu * g / k2))
    ]
    phases = [
        np.where(mode == LOADED, np.where(rate > 0, 1, 2), PHASE[mode.astype(int)])
        for mode, rate in ((mode1, d1), (mode2, -v2))
    ]
    I1, I2 = _impulses(log, mu, time, v1, v2)
    return ImpulseCurve(
        time=in_unit(time, unit.time),
        impulse1=I1 * unit.impulse,
        impulse2=I2 * unit.impulse,
        v1=v1 * unit.velocity,
        v2=v2 * unit.velocity,
        energy1=energies[0],
        energy2=energies[1],
        state=states_of(log)[rows],
        phase1=phases[0],
        phase2=phases[1],
    )
