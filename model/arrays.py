"""Names for the types of arrays, which signatures of all packages use, and `zero_records`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

#: Selection of rows of an array: the indices of the rows, or one flag for each row.
Rows = Booleans | NDArray[np.signedinteger]

#: Array of records whose fields can also be read as attributes.
Records = np.recarray[tuple[int, ...], np.dtype[np.record]]


def zero_records(n: int, fields: np.dtype[np.void]) -> Records:
    """Return n records of a structured type, with all fields zero."""
    return np.zeros(n, fields).view(np.recarray)
