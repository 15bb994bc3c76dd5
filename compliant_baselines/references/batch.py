"""What the engine-free references have in common in bulk: inputs and answers as arrays."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import config
from numpy.typing import ArrayLike, NDArray

from impact_xval.compliant_baselines.contract.trajectory import FREE, STUCK
from impact_xval.compliant_baselines.references.driver import Followed, Law, follow_all
from impact_xval.compliant_baselines.references.ending import TOO_LONG
from impact_xval.model.collision import STATES
from impact_xval.model.inputs import Legal, broadcast_inputs

Floats = NDArray[np.float64]

#: Segments after which a cell of a batch is given up. Only a stiffness ratio beyond 1e10 or so, or a
#: damping next to none in a drop, comes near it; at a third of a microsecond each a cell then still costs
#: less than a second.
MAX_STEPS = 1_000_000

#: How a collision ended, by the code of the driver.
ENDS = np.array(["", "free", "rest", "stuck", *[""] * 6])

#: Collisions that a thread is given at once: one to ten milliseconds of work.
_SHARE = 256

#: What a batch takes for gravity beside the ratios of the collision.
GRAVITY_NUMBER = Legal(
    "gravity_number", 0.0, float(np.finfo(float).max), "a finite number >= 0 (g/(|v0| omega1))"
)


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceBatch:
    r"""What a reference says of many collisions: arrays of the shape the inputs broadcast to.

    Attributes
    ----------
    v1, v2 : ndarray of float
        Velocities per \|v0\| when the collision is over; 0 for a ball at rest (`trajectory`); NaN where
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
        ``free``, ``rest`` or ``stuck`` (`trajectory`), empty without a result.
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
        k2/k1, m2/m1 and the coefficients of restitution; they broadcast. e_i = 0 and k2/k1 = 0 or infinity
        give the status ``unrepresentable``.
    gravity_number : array_like
        g/(\|v0\| omega1), omega1 = sqrt(k1 (1/m1 + 1/m2)); 0 is the scenario `impact`, above it is a `drop`.
    frozen : bool
        Whether positions are frozen (`references.driver`).
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
    n = kappa.size
    followed = Followed(
        v1=np.full(n, np.nan),
        v2=np.full(n, np.nan),
        end=np.full(n, -1, np.int8),
        sequence=np.zeros(n, np.uint64),
        n_states=np.zeros(n, np.int32),
        n_events=np.zeros(n, np.int32),
        n_steps=np.zeros(n, np.int32),
        duration=np.full(n, np.nan),
        fall=np.full(n, np.nan),
        limited=np.zeros(n, np.bool_),
    )
    _share_out(followed, law, kappa, mu, g, frozen, max_steps)
    end, fall = followed.end, followed.fall
    failed = (end < 0) | (end == TOO_LONG)
    v1 = np.where(failed, np.nan, np.where(end == STUCK, 0.0, followed.v1))
    v2 = np.where(failed, np.nan, np.where(end != FREE, 0.0, followed.v2))
    with np.errstate(over="ignore", invalid="ignore"):
        fallen = np.where(g > 0, g * fall, 0.0)  # also where a fall without gravity has no end
    impulse1 = 1 + v1 + fallen
    status = np.where(followed.limited, "limit", "ok")
    columns = {
        "v1": v1,
        "v2": v2,
        "impulse1": impulse1,
        "impulse2": impulse1 + mu * (v2 + fallen),
        "retained_energy": v1 * v1 + mu * v2 * v2,
        "duration": np.where(failed, np.nan, followed.duration),
        "fall": np.where(failed, np.nan, fall),
        "status": np.where(end == TOO_LONG, "timeout", np.where(end < 0, "unrepresentable", status)),
        "end": ENDS[end],
        "sequence": followed.sequence,
        "n_states": followed.n_states,
        "n_events": followed.n_events,
        "n_steps": followed.n_steps,
    }
    return ReferenceBatch(**{name: column.reshape(shape) for name, column in columns.items()})


def _share_out(
    followed: Followed, law: Law, kappa: Floats, mu: Floats, g: Floats, frozen: bool, max_steps: int
) -> None:
    """Follow all collisions, in as many threads as numba would take."""

    def follow(start: int) -> None:
        share = slice(start, start + _SHARE)
        into, columns = (
            [column[share] for column in each] for each in (followed, (kappa, mu, law.a1, law.a2, g))
        )
        arguments: list[Any] = [*into, law.code, *columns, law.cutoff, frozen, max_steps]
        follow_all(*arguments)

    starts = range(0, kappa.size, _SHARE)
    if len(starts) < 2:
        follow(0)
        return
    count: int = vars(config)["NUMBA_NUM_THREADS"]  # numba sets it from the environment
    with ThreadPoolExecutor(count) as threads:
        list(threads.map(follow, starts))
