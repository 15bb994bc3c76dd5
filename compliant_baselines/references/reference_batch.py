"""What the engine-free references have in common in bulk: inputs and answers as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_xval.compliant_baselines.contract.trajectory import FREE, STUCK
from impact_xval.compliant_baselines.references.piecewise import TOO_LONG
from impact_xval.model.collision import STATES
from impact_xval.model.inputs import Legal, broadcast_inputs

Floats = NDArray[np.float64]

#: Stretches after which a cell of a batch is given up. Only a stiffness ratio beyond 1e10 or so, or a
#: damping next to none in a drop, comes near it; at a third of a microsecond each a cell then still costs
#: less than a second.
MAX_STEPS = 1_000_000

#: How a collision ended, by the codes of the kernels.
ENDS = np.array(["", "free", "rest", "stuck", *[""] * 6])

#: What a batch takes for gravity beside the ratios of the collision.
GRAVITY_NUMBER = Legal(
    "gravity_number", 0.0, float(np.finfo(float).max), "a finite number >= 0 (g/(|v0| omega1))"
)


class Followed(NamedTuple):
    """What a kernel returns, in scaled units: numbers of one collision, or arrays (n,) of many.

    Attributes
    ----------
    v1, v2
        Velocities at the end, those of balls at rest as they are.
    end
        How it ended, by the constants of `trajectory` and `piecewise`; -1 of a batch: unrepresentable.
    sequence, n_states, n_events, n_steps, duration
        As in `ReferenceBatch`.
    fall
        For how long of the duration gravity acted.
    limited
        Whether a closed-form limit finished the collision.
    """

    v1: Any
    v2: Any
    end: Any
    sequence: Any
    n_states: Any
    n_events: Any
    n_steps: Any
    duration: Any
    fall: Any
    limited: Any


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
        How long it took, and for how long of that gravity acted (`piecewise`), per sqrt(m1/k1).
    status : ndarray of str
        ``ok``, ``limit`` (a closed-form limit finished the collision), ``timeout`` or ``unrepresentable``.
    end : ndarray of str
        ``free``, ``rest`` or ``stuck`` (`trajectory`), empty without a result.
    sequence : ndarray of uint64
        The states, two bits each (S1 is 0), the last lowest: those of all sequences of up to 32 states, the
        last 32 of a longer one.
    n_states, n_events, n_steps : ndarray of int
        Length of the sequence (S4 included), number of events, number of stretches.
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


def scaled_inputs(
    stiffness_ratio: ArrayLike, mass_ratio: ArrayLike, e1: ArrayLike, e2: ArrayLike, gravity_number: ArrayLike
) -> tuple[tuple[int, ...], list[Floats]]:
    r"""Check and broadcast the inputs of a batch, gravity in the units of the kernels.

    Returns
    -------
    shape : tuple of int
        What they broadcast to.
    arrays : list of five ndarray, shape (n,)
        kappa, mu, e1, e2 and gravity per \|v0\| sqrt(k1/m1), flat.

    Raises
    ------
    ValueError
        If any value is illegal; the message names the parameter, the first such value and the legal range.
    """
    shape, (kappa, mu, first, second, number) = broadcast_inputs(
        stiffness_ratio, mass_ratio, e1, e2, (GRAVITY_NUMBER, gravity_number)
    )
    return shape, [kappa, mu, first, second, number * np.sqrt(1 + 1 / mu)]


def batch_of(shape: tuple[int, ...], mu: Floats, g: Floats, results: Followed) -> ReferenceBatch:
    """Turn what a kernel returned, cell by cell, into a `ReferenceBatch`.

    Parameters
    ----------
    shape : tuple of int
        Of the answer.
    mu, g : ndarray, shape (n,)
        As from `scaled_inputs`.
    results : Followed
        Arrays of shape (n,).
    """
    v1, v2, end, sequence, n_states, n_events, n_steps, duration, fall, limited = results
    failed = (end < 0) | (end == TOO_LONG)
    v1 = np.where(failed, np.nan, np.where(end == STUCK, 0.0, v1))
    v2 = np.where(failed, np.nan, np.where(end != FREE, 0.0, v2))
    impulse1 = 1 + v1 + g * fall
    impulse2 = impulse1 + mu * (v2 + g * fall)
    status = np.where(limited, "limit", "ok")
    status = np.where(end == TOO_LONG, "timeout", np.where(end < 0, "unrepresentable", status))
    return ReferenceBatch(
        v1=v1.reshape(shape),
        v2=v2.reshape(shape),
        impulse1=impulse1.reshape(shape),
        impulse2=impulse2.reshape(shape),
        retained_energy=(v1 * v1 + mu * v2 * v2).reshape(shape),
        duration=np.where(failed, np.nan, duration).reshape(shape),
        fall=np.where(failed, np.nan, fall).reshape(shape),
        status=status.reshape(shape),
        end=ENDS[end].reshape(shape),
        sequence=sequence.reshape(shape),
        n_states=n_states.reshape(shape),
        n_events=n_events.reshape(shape),
        n_steps=n_steps.reshape(shape),
    )
