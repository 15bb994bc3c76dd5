"""The model's impact law in real time, with positions: energetic restitution by a second, higher stiffness.

`references.bistiffness_kernel` follows it, exactly; see there for where the surface of a contact
is after an end of compression, and for when a contact becomes rigid. It differs from the state-transition
model in one thing: a contact that has opened returns when its gap has closed, not when its bodies begin to
approach.

In a `drop` the strain energy of contact 2 holds what carries the weight, and an end of compression takes 1
- e2^2 of all of it: the permanent indentation is of the contact, whatever presses it.

e = 0 would need an infinite stiffness of unloading. Its limit exists (the bodies stick as long as the
contact is pushed), but it is the state-transition model's closed form and would not be a motion in time:
refused, as k2/k1 = 0 or infinity.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike

from impact_xval.compliant_baselines.references.bistiffness_kernel import COMPRESSION, RESTITUTION, collide
from impact_xval.compliant_baselines.references.piecewise import LOG_WIDTH, OPEN
from impact_xval.compliant_baselines.references.reference_batch import (
    MAX_STEPS,
    Floats,
    Followed,
    ReferenceBatch,
    batch_of,
    scaled_inputs,
)
from impact_xval.compliant_baselines.references.reference_path import KernelLaw
from impact_xval.compliant_baselines.references.reference_solver import ReferenceSolver
from impact_xval.compliant_baselines.references.taylor import LINEAR
from impact_xval.model.collision import Collision

#: Ratio from which a contact counts as rigid (`bistiffness_kernel`). It moves velocities by about 1e-3 of its
#: inverse, measured over random collisions; this one hides in rounding.
RIGID_RATIO = 1e10


def bistiffness_batch(
    stiffness_ratio: ArrayLike,
    mass_ratio: ArrayLike,
    e1: ArrayLike,
    e2: ArrayLike,
    gravity_number: ArrayLike = 0.0,
    *,
    rigid_ratio: float = RIGID_RATIO,
    frozen: bool = False,
    max_steps: int = MAX_STEPS,
) -> ReferenceBatch:
    r"""Follow many collisions under the bistiffness law at once.

    Parameters
    ----------
    stiffness_ratio, mass_ratio, e1, e2 : array_like
        k2/k1, m2/m1 and the coefficients of restitution; they broadcast. e_i = 0 and k2/k1 = 0 or infinity
        give the status ``unrepresentable``.
    gravity_number : array_like
        g/(\|v0\| omega1), omega1 = sqrt(k1 (1/m1 + 1/m2)); 0 is the scenario `impact`, above it is a
        `drop`.
    rigid_ratio : float
        Where a contact counts as rigid; greater than 1.
    frozen : bool
        Whether a contact that has opened returns as soon as its bodies approach, as in the state-transition model
        (which this is, without gravity).
    max_steps : int
        Stretches after which a cell is given up (status ``timeout``).

    Returns
    -------
    ReferenceBatch

    Raises
    ------
    ValueError
        If any value is illegal; the message names the parameter, the first such value and the legal range.
    """
    if not rigid_ratio > 1:
        raise ValueError(f"rigid_ratio = {rigid_ratio!r}; legal: greater than 1, up to inf")
    shape, (kappa, mu, first, second, g) = scaled_inputs(stiffness_ratio, mass_ratio, e1, e2, gravity_number)
    results = _follow_all(kappa, mu, first, second, g, float(rigid_ratio), frozen, max_steps)
    return batch_of(shape, mu, g, Followed(*results))


@njit(cache=True, parallel=True, error_model="numpy")
def _follow_all(kappa, mu, e1, e2, g, rigid_ratio, frozen, max_steps):
    n = kappa.size
    v1, v2 = np.full(n, np.nan), np.full(n, np.nan)
    duration, fall = np.full(n, np.nan), np.full(n, np.nan)
    end, sequence = np.full(n, -1, np.int8), np.zeros(n, np.uint64)
    n_states, n_events, n_steps = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n, np.int32)
    limited = np.zeros(n, np.bool_)
    no_log = np.empty((0, LOG_WIDTH))
    for i in prange(n):
        if 0 < kappa[i] < np.inf and e1[i] > 0 and e2[i] > 0:
            result = collide(kappa[i], mu[i], e1[i], e2[i], g[i], rigid_ratio, frozen, max_steps, no_log)
            v1[i], v2[i], end[i], sequence[i], n_states[i], n_events[i], n_steps[i] = result[:7]
            duration[i], fall[i], limited[i] = result[7:]
    return v1, v2, end, sequence, n_states, n_events, n_steps, duration, fall, limited


class BistiffnessSolver(ReferenceSolver):
    """The bistiffness law."""

    name = "bistiffness"

    def follow(self, collision: Collision, g: float, max_steps: int, log: Floats) -> Followed:
        """Call the kernel, in scaled units."""
        c = collision
        return Followed(
            *collide(c.stiffness_ratio, c.mass_ratio, c.e1, c.e2, g, RIGID_RATIO, False, max_steps, log)
        )

    def batch(self, *cells: Floats) -> ReferenceBatch:
        """Follow many collisions at once."""
        return bistiffness_batch(*cells)

    def law(self, collision: Collision) -> KernelLaw:
        """Springs without damping; phases as in an `ImpulseCurve`."""
        return KernelLaw(LINEAR, 0.0, 0.0, (COMPRESSION, RESTITUTION), (OPEN, COMPRESSION, RESTITUTION))
