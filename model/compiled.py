"""How the kernels of the model are compiled, said once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numba import njit

#: Options of every kernel. A product and a sum may be fused and a division become a multiplication by a reciprocal,
#: each to within a rounding; nothing that assumes numbers to be finite, for zero and infinity are legal values here.
OPTIONS = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}}

compiled = njit(**OPTIONS)

#: For what is called within a search: passing a dozen numbers to it would cost as much as it does.
inlined = njit(forceinline=True, **OPTIONS)


def is_compiled(kernel: Any) -> bool:
    """Tell whether an earlier process left the machine code of a kernel in the cache."""
    # The folder is that of numba's cache, which the dispatcher knows and does not make public.
    folder = Path(kernel._cache.cache_path)
    return any(folder.glob(f"{kernel.py_func.__module__.rpartition('.')[2]}.{kernel.py_func.__name__}-*.nbi"))
