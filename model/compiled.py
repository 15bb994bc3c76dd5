"""How the kernels of the model are compiled, said once."""

from __future__ import annotations

from numba import njit

#: Options of every kernel. A product and a sum may be fused and a division become a multiplication by a reciprocal,
#: each to within a rounding; nothing that assumes numbers to be finite, for zero and infinity are legal values here.
OPTIONS = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}}

compiled = njit(**OPTIONS)
