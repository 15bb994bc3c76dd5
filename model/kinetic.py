"""How long a difference of velocities is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def kinetic_norm(mass_ratio: ArrayLike, dv1: ArrayLike, dv2: ArrayLike) -> Any:
    r"""Kinetic norm sqrt(dv1^2 + (m2/m1) dv2^2) of differences of final velocities.

    Its square is the kinetic energy of the difference over that of the impact where velocities are per \|v0\|; D, the
    velocity divergence, is the norm of solver minus model.

    Parameters
    ----------
    mass_ratio : array_like
        m2/m1.
    dv1, dv2 : array_like
        Differences of v1 and v2, in one unit; the arrays broadcast.

    Returns
    -------
    float or ndarray
        In that unit.
    """
    return np.hypot(dv1, np.sqrt(mass_ratio) * np.asarray(dv2))


def column_norm(masses: Sequence[float], velocities: Sequence[float]) -> float:
    """Kinetic norm sqrt(sum m_i v_i^2) of velocities of N balls, per root of the largest mass.

    Only quotients of it are of use: that of a difference and of the velocities at first touch is D of N balls.

    Parameters
    ----------
    masses : sequence of float, length N
        In kg, positive.
    velocities : sequence of float, length N

    Returns
    -------
    float
        In the unit of the velocities.
    """
    largest = max(masses)
    return math.hypot(*(math.sqrt(m / largest) * v for m, v in zip(masses, velocities, strict=True)))
