"""The model's impact law in real time, with positions: energetic restitution by a second, higher stiffness.

See `model.chain.laws` for where the surface of a contact is after an end of compression, and `model.chain.kernel` for
when a contact becomes rigid. It differs from the state-transition model in one thing: a contact that has opened
returns when its gap has closed, not when its bodies begin to approach.

In a `drop` the strain energy of contact 2 holds what carries the weight, and an end of compression takes 1
- e2^2 of all of it: the permanent indentation is of the contact, whatever presses it.

e = 0 would need an infinite stiffness of unloading. Its limit exists (the bodies stick as long as the
contact is pushed), but it is the state-transition model's closed form and would not be a motion in time:
refused, as k2/k1 = 0 or infinity.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from impact_xval.compliant_baselines.references.batch import (
    MAX_STEPS,
    Floats,
    Law,
    ReferenceBatch,
    follow_batch,
)
from impact_xval.compliant_baselines.references.solver import ReferenceSolver
from impact_xval.model.chain.laws import STATE_TRANSITION
from impact_xval.model.collision import Collision


def bistiffness_batch(
    stiffness_ratio: ArrayLike,
    mass_ratio: ArrayLike,
    e1: ArrayLike,
    e2: ArrayLike,
    gravity_number: ArrayLike = 0.0,
    *,
    frozen: bool = False,
    max_steps: int = MAX_STEPS,
) -> ReferenceBatch:
    """Follow many collisions under the bistiffness law at once.

    Parameters
    ----------
    stiffness_ratio, mass_ratio, e1, e2, gravity_number, max_steps
        As for `batch.follow_batch`.
    frozen : bool
        Whether a contact that has opened returns as soon as its bodies approach, as in the state-transition model
        (which this is, without gravity).

    Returns
    -------
    ReferenceBatch

    Raises
    ------
    ValueError
        If any value is illegal; the message names the parameter, the first such value and the legal range.
    """

    def law_of(kappa: Floats, mu: Floats, e1: Floats, e2: Floats) -> Law:
        return Law(STATE_TRANSITION, np.where(e1 > 0, e1, np.nan), np.where(e2 > 0, e2, np.nan))

    cells = stiffness_ratio, mass_ratio, e1, e2, gravity_number
    return follow_batch(law_of, *cells, frozen=frozen, max_steps=max_steps)


class BistiffnessSolver(ReferenceSolver):
    """The bistiffness law."""

    name = "bistiffness"

    def batch(self, *cells: Floats) -> ReferenceBatch:
        """Follow many collisions at once."""
        return bistiffness_batch(*cells)

    def law(self, collision: Collision) -> Law:
        """Give the law its restitutions."""
        return Law(STATE_TRANSITION, collision.e1, collision.e2)
