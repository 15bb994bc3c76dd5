"""How long a velocity, or a difference of velocities, of N balls is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def kinetic_norm(masses: ArrayLike, velocities: ArrayLike) -> Any:
    """Kinetic norm sqrt(sum m_i v_i^2) over the last axis, in the unit of velocities, per root of the largest mass.

    Only quotients of it are of use: that of a difference of final velocities and of the velocities at first touch is D,
    the velocity divergence. Masses are NaN where a collision has fewer balls.
    """
    m, v = np.asarray(masses, float), np.asarray(velocities, float)
    with np.errstate(over="ignore", invalid="ignore"):
        weighted = np.sqrt(m / np.nanmax(m, axis=-1, keepdims=True)) * v
    return np.hypot.reduce(np.where(np.isnan(m), 0.0, weighted), axis=-1)
