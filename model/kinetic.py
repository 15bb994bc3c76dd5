"""The kinetic norm, a mass-weighted norm with which velocities of N balls are compared.

Used by measures of divergence and by outcomes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def kinetic_norm(masses: ArrayLike, velocities: ArrayLike) -> Any:
    """Return the mass-weighted norm sqrt(sum m_i v_i^2/m_max) of velocities, or of their differences.

    The velocity divergence D is the norm of a difference of final velocities, divided by the norm of the velocities at
    first touch. Only a quotient of two norms has a meaning, because the norm is relative to the largest mass m_max.

    Parameters
    ----------
    masses : array_like, shape (..., N)
        Masses in kg; NaN where a collision has fewer than N balls.
    velocities : array_like, shape (..., N)
        Velocities, or differences of velocities, in m/s.

    Returns
    -------
    float or ndarray, shape (...)
        Norm in m/s.
    """
    m, v = np.asarray(masses, float), np.asarray(velocities, float)
    with np.errstate(over="ignore", invalid="ignore"):
        weighted = np.sqrt(m / np.nanmax(m, axis=-1, keepdims=True)) * v
    return np.hypot.reduce(np.where(np.isnan(m), 0.0, weighted), axis=-1)
