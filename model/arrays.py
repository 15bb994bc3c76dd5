"""Types of arrays. Used wherever a signature names an array."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

#: Indices of rows, or for each row whether it is meant.
Rows = Booleans | NDArray[np.signedinteger]

#: Records whose fields are attributes too.
Records = np.recarray[tuple[int, ...], np.dtype[np.record]]


def zero_records(n: int, fields: np.dtype[np.void]) -> Records:
    """Return n records of given fields, all zero."""
    return np.zeros(n, fields).view(np.recarray)
