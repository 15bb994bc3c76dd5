"""State paths of the model in bulk, in the code of `ReferenceBatch`, to be compared with a reference's.

Both are exact and complete, so they are compared as they are: without an engine there is nothing that the filter of
`contract.state_runs` would have to make up for. A path that parts in a state of any duration parts.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from impact_xval.model.compiled import OPTIONS
from impact_xval.model.diagram import LOG_WIDTH, collide
from impact_xval.model.inputs import Cutoff
from impact_xval.model.law import IMPACT_LAWS
from impact_xval.model.solve import check_cutoff

Floats = NDArray[np.float64]

#: Stretches of a collision that are followed; a longer one has no path here.
_STRETCHES = 4096


@njit(parallel=True, **OPTIONS)
def _paths(kappa, mu, e1, e2, cutoff, max_events, law):
    n = kappa.size
    sequence, n_states = np.zeros(n, np.uint64), np.zeros(n, np.int64)
    for block in prange((n + 255) // 256):
        log = np.empty((_STRETCHES, LOG_WIDTH))
        for i in range(256 * block, min(n, 256 * block + 256)):
            rows = collide(kappa[i], mu[i], e1[i], e2[i], cutoff, max_events, law, log)[5] + 1
            if rows > _STRETCHES:
                continue
            before = 0
            for j in range(rows):
                state = int(log[j, 0])
                if state != before:
                    sequence[i] = (sequence[i] << np.uint64(2)) | np.uint64(state - 1)
                    n_states[i] += 1
                before = state
    return sequence, n_states


def model_paths(
    stiffness_ratio: Floats,
    mass_ratio: Floats,
    e1: Floats,
    e2: Floats,
    stiffness_ratio_cutoff: Cutoff,
    max_events: int = 100_000,
) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Follow the model's state paths.

    Parameters
    ----------
    stiffness_ratio, mass_ratio, e1, e2 : ndarray, shape (n,)
        k2/k1, m2/m1 and the coefficients of restitution, legal values.
    stiffness_ratio_cutoff : float or "exact"
        As for `model.solve`.
    max_events : int
        As for `model.solve`.

    Returns
    -------
    sequence : ndarray of uint64, shape (n,)
        The states, two bits each (S1 is 0), the last lowest; the last 32 of a longer path.
    n_states : ndarray of int, shape (n,)
        Length of the path, S4 included; 0 where it was not followed to its end.
    """
    cutoff, law = check_cutoff(stiffness_ratio_cutoff), IMPACT_LAWS["jia-mason-erdmann"]
    return _paths(stiffness_ratio, mass_ratio, e1, e2, cutoff, max_events, law)
