"""How the kernels of the model are compiled, said once."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from numba import config, njit

#: Options of every kernel. A product and a sum may be fused and a division become a multiplication by a reciprocal,
#: each to within a rounding; nothing that assumes numbers to be finite, for zero and infinity are legal values here.
OPTIONS = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}}

compiled = njit(**OPTIONS)

#: For what is called within a search: passing a dozen numbers to it would cost as much as it does.
inlined = njit(forceinline=True, **OPTIONS)

#: For what is handed many arrays and makes none: no references are counted, which would cost more than the work.
_compile: Any = njit  # whose stubs know nothing of this option
uncounted = _compile(_nrt=False, **OPTIONS)


def cache_folder(kernel: Any) -> Path:
    """Return the folder in which the machine code of a kernel is kept from one process to the next."""
    # That of numba's cache, which the dispatcher knows and does not make public.
    return Path(kernel._cache.cache_path)


def is_compiled(kernel: Any) -> bool:
    """Tell whether an earlier process left the machine code of a kernel, as its source is now, in the cache."""
    if vars(config)["DISABLE_JIT"]:
        return True  # nothing is compiled
    python = "{}{}".format(*sys.version_info)
    function = kernel.py_func
    name = f"{function.__module__.rpartition('.')[2]}.{function.__name__}-*.py{python}*.nbi"
    changed = Path(function.__code__.co_filename).stat().st_mtime
    return any(index.stat().st_mtime >= changed for index in cache_folder(kernel).glob(name))
