"""What the engine-free references have in common in bulk: inputs and answers as arrays."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import config
from numpy.typing import ArrayLike, NDArray

from impact_xval.model.chain.kernel import COLLAPSE, RUNAWAY, Followed, collide_all
from impact_xval.model.chain.laws import STATE_TRANSITION
from impact_xval.model.chain.power_law import TOLERANCE
from impact_xval.model.chain.rest import FREE, GOING, STUCK
from impact_xval.model.collision import STATES
from impact_xval.model.inputs import MASS_PRECISION, Legal, broadcast_inputs

Floats = NDArray[np.float64]

#: Segments after which a cell of a batch is given up. Only a stiffness ratio beyond 1e10 or so, or a
#: damping next to none in a drop, comes near it: such a cell costs some three seconds.
MAX_STEPS = 1_000_000

#: How a collision ended, by the code of the kernel.
ENDS = np.array(["", "free", "rest", "stuck"])

#: Collisions that a thread is given at once: some ten milliseconds of work.
_SHARE = 512

#: What a batch takes for gravity beside the ratios of the collision.
GRAVITY_NUMBER = Legal(
    "gravity_number", 0.0, float(np.finfo(float).max), "a finite number >= 0 (g/(|v0| omega1))"
)


class Law(NamedTuple):
    """A contact law with its numbers for one collision, in the units of `follow_all`, or for many: arrays (n,).

    Attributes
    ----------
    code : int
        One of `model.chain.laws`.
    a1, a2
        What the law has of each contact: e, greater than 0; c per sqrt(k1 m1); or a times abs(v0). NaN or infinite:
        unrepresentable.
    """

    code: int
    a1: Any
    a2: Any


def follow_all(
    law: Law,
    kappa: Floats,
    mu: Floats,
    g: Floats,
    frozen: bool,
    max_steps: int,
    points: int = 1,
    log: Floats | None = None,
) -> tuple[Floats, Floats, NDArray[np.uint64]]:
    """Follow two balls on a table, in units of m1, k1 and abs(v0), in as many threads as numba would take.

    Parameters
    ----------
    law : Law
        Of arrays (n,).
    kappa, mu, g : ndarray, shape (n,)
        k2/k1, m2/m1, and gravity: 0 is the scenario `impact`, anything else `drop`.
    frozen : bool
        Whether a contact that carries no force returns as soon as its bodies approach.
    max_steps : int
        Pieces of segments after which a collision is given up.
    points, log
        As of `chain.kernel.collide`, for the first one.

    Returns
    -------
    velocities : ndarray, shape (n, 2)
    numbers : ndarray, shape (n, 11)
        As of `chain.kernel.collide_all`; NaN where a parameter is not finite, or too far from 1.
    sequences : ndarray of uint64, shape (n,)
        The states, as of `chain.kernel.Followed`.
    """
    n = kappa.size
    a = np.stack([law.a1, law.a2], axis=-1)
    least, most = 1 / MASS_PRECISION, MASS_PRECISION
    there = (least <= kappa) & (kappa <= most) & (least <= mu) & (mu <= most) & np.isfinite(a).all(axis=1)
    masses, stiffnesses = (np.stack([np.ones(n), each], axis=-1) for each in (mu, kappa))
    masses[~there] = np.nan
    impacts = law.code == STATE_TRANSITION
    restitutions, dampings = (a, np.zeros((n, 2))) if impacts else (np.ones((n, 2)), a)
    rates, zeros = np.tile([1.0, 0.0], (n, 1)), np.zeros((n, 2))
    cells = masses, stiffnesses, restitutions, dampings, rates, np.zeros(n), zeros, g
    into = np.full((n, 2), np.nan), np.full((n, 11), np.nan), np.zeros(n, np.uint64)
    log = np.empty((0, 0)) if log is None else log

    def follow(start: int) -> None:
        share = slice(start, start + _SHARE)
        some: list[Any] = [each[share] for each in cells]
        out: list[Any] = [each[share] for each in into]
        arguments = [law.code, 1.0, frozen, *some, TOLERANCE, max_steps, points, log, *out]
        collide_all(*arguments)

    starts = range(0, n, _SHARE)
    if len(starts) < 2:
        follow(0)
        return into
    count: int = vars(config)["NUMBA_NUM_THREADS"]  # numba sets it from the environment
    with ThreadPoolExecutor(count) as threads:
        list(threads.map(follow, starts))
    return into


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceBatch:
    r"""What a reference says of many collisions: arrays of the shape the inputs broadcast to.

    Attributes
    ----------
    v1, v2 : ndarray of float
        Velocities per \|v0\| when the collision is over; 0 for a ball at rest (`chain.rest`); NaN where
        `status` says why.
    impulse1, impulse2 : ndarray of float
        Total impulses per m1 \|v0\|.
    retained_energy : ndarray of float
        Kinetic energy of v1, v2 over that of B1 before the collision.
    duration, fall : ndarray of float
        How long it took, and for how long of that gravity acted, per sqrt(m1/k1).
    status : ndarray of str
        ``ok``, ``limit`` (a closed-form limit finished the collision), ``timeout`` or ``unrepresentable``.
    end : ndarray of str
        ``free``, ``rest`` or ``stuck`` (`chain.rest`), empty without a result.
    sequence : ndarray of uint64
        The states, two bits each (S1 is 0), the last lowest: those of all sequences of up to 32 states, the
        last 32 of a longer one.
    n_states, n_events, n_steps : ndarray of int
        Length of the sequence (S4 included), number of events, number of segments.
    """

    v1: Floats
    v2: Floats
    impulse1: Floats
    impulse2: Floats
    retained_energy: Floats
    duration: Floats
    fall: Floats
    status: NDArray[np.str_]
    end: NDArray[np.str_]
    sequence: NDArray[np.uint64]
    n_states: NDArray[np.int64]
    n_events: NDArray[np.int64]
    n_steps: NDArray[np.int64]

    def states(self, index: tuple[int, ...] | int) -> tuple[str, ...]:
        """State sequence of one cell, such as ``("S1", "S3", "S4")``; at most its last 32 states."""
        code, n = int(self.sequence[index]), min(int(self.n_states[index]), 32)
        return tuple(STATES[1 + (code >> 2 * (n - 1 - i) & 3)] for i in range(n))


def follow_batch(
    law_of: Callable[[Floats, Floats, Floats, Floats], Law],
    stiffness_ratio: ArrayLike,
    mass_ratio: ArrayLike,
    e1: ArrayLike,
    e2: ArrayLike,
    gravity_number: ArrayLike,
    *,
    frozen: bool,
    max_steps: int,
) -> ReferenceBatch:
    r"""Follow many collisions under a law.

    Parameters
    ----------
    law_of : callable
        The law of the collisions, given k2/k1, m2/m1, e1 and e2: arrays of shape (n,).
    stiffness_ratio, mass_ratio, e1, e2 : array_like
        k2/k1, m2/m1 and the coefficients of restitution; they broadcast. e_i = 0, and k2/k1 or m2/m1
        beyond `MASS_PRECISION`, give the status ``unrepresentable``.
    gravity_number : array_like
        g/(\|v0\| omega1), omega1 = sqrt(k1 (1/m1 + 1/m2)); 0 is the scenario `impact`, above it is a `drop`.
    frozen : bool
        Whether positions are frozen (`model.chain.laws`).
    max_steps : int
        Segments after which a cell is given up (status ``timeout``).

    Raises
    ------
    ValueError
        If any value is illegal; the message names the parameter, the first such value and the legal range.
    """
    shape, (kappa, mu, first, second, number) = broadcast_inputs(
        stiffness_ratio, mass_ratio, e1, e2, (GRAVITY_NUMBER, gravity_number)
    )
    g = number * np.sqrt(1 + 1 / mu)
    with np.errstate(invalid="ignore", over="ignore"):
        law = law_of(kappa, mu, first, second)
    velocities, numbers, sequences = follow_all(law, kappa, mu, g, frozen, max_steps)
    found = dict(zip(Followed._fields, numbers.T, strict=False))
    with np.errstate(invalid="ignore"):
        code, end = (found[name].astype(np.int64) for name in ("code", "end"))
    followed = ~np.isnan(found["end"])
    failed = ~followed | (end == GOING)
    fall = found["fall"]
    v1 = np.where(failed, np.nan, np.where(end == STUCK, 0.0, velocities[:, 0]))
    v2 = np.where(failed, np.nan, np.where(end != FREE, 0.0, velocities[:, 1]))
    with np.errstate(over="ignore", invalid="ignore"):
        fallen = np.where(g > 0, g * fall, 0.0)  # also where a fall without gravity has no end
    impulse1 = 1 + v1 + fallen
    status = np.where(followed, np.where(failed, "timeout", "ok"), "unrepresentable")
    status[~failed & (code & (RUNAWAY | COLLAPSE) != 0)] = "limit"
    counts = {"n_states": "n_states", "n_events": "events", "n_steps": "pieces"}
    columns = {
        "v1": v1,
        "v2": v2,
        "impulse1": impulse1,
        "impulse2": impulse1 + mu * (v2 + fallen),
        "retained_energy": v1 * v1 + mu * v2 * v2,
        "duration": np.where(failed, np.nan, found["time"]),
        "fall": np.where(failed, np.nan, fall),
        "status": status,
        "end": ENDS[np.where(failed, GOING, end)],
        "sequence": sequences,
        **{name: np.where(followed, found[field], 0).astype(np.int64) for name, field in counts.items()},
    }
    return ReferenceBatch(**{name: column.reshape(shape) for name, column in columns.items()})
