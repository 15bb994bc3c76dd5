"""How long a difference of velocities is."""

from __future__ import annotations

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
