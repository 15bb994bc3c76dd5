"""Marks: which results a little of anything would change, and are therefore kept apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: A grazing margin below this marks a result. `benchmarks/grazing.py` says how well that tells the cells that jump.
GRAZING_THRESHOLD = 5e-5

#: So does a cut-off that changes (v1, v2) by more than this, in the kinetic norm per sqrt(m1) abs(v0).
CUTOFF_THRESHOLD = 1e-9

GRAZING = (
    "grazing: a compression rate turned around next to zero (grazing_margin), and the outcome jumps where one "
    "reaches zero"
)
CUTOFF = (
    f"cut-off: the outcome without a cut-off differs by more than {CUTOFF_THRESHOLD:g} |v0|, or is not known"
)

#: The sentences, by the sum of 1 (grazing) and 2 (cut-off).
MARKS = ("", GRAZING, CUTOFF, f"{GRAZING}; {CUTOFF}")


def mark_codes(
    grazing_margin: ArrayLike, cutoff_effect: ArrayLike, threshold: float = GRAZING_THRESHOLD
) -> NDArray[np.uint8]:
    """Index of each result's sentence in `MARKS`.

    Parameters
    ----------
    grazing_margin, cutoff_effect : array_like of float
        As in `model.Outcome`; an effect of NaN is one that could not be computed.
    threshold : float
        Of the grazing margin.
    """
    grazing = np.less(grazing_margin, threshold)
    return np.asarray(grazing + 2 * ~np.less_equal(cutoff_effect, CUTOFF_THRESHOLD), dtype=np.uint8)
