"""Numba options shared by all kernels, and arrays shared out to threads."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

from numba import config, njit

#: Options of every kernel. A product and a sum may be fused and a division become a multiplication by a reciprocal,
#: each to within a rounding; nothing that assumes numbers to be finite, for zero and infinity are legal values here.
OPTIONS = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}}

compiled = njit(**OPTIONS)

_compile: Any = njit  # whose stubs lack some options

#: Force-inlined variant for parts of a kernel. Python cannot call them: wrappers, and a cache of each part, would add
#: half to the time that the kernel of two balls takes to compile.
inlined = _compile(
    forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, **(OPTIONS | {"cache": False})
)

#: Of functions that only kernels of chains call: no references are counted and no way in from Python is compiled, each
#: of which would cost more than the work; nothing is kept, for the cache of a kernel holds all that it calls. `merged`
#: becomes a part of its caller before types are inferred: for functions that are called at one place.
_UNCOUNTED: dict[str, Any] = {**OPTIONS, "_nrt": False}
_INNER = {**_UNCOUNTED, "cache": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
uncounted = _compile(**_INNER)
merged = _compile(inline="always", **_INNER)

#: A kernel of these, which Python calls: it holds no lock, so that threads can be given parts of arrays.
entry = _compile(nogil=True, **_UNCOUNTED)

_Found = TypeVar("_Found")


def in_threads(function: Callable[[slice], _Found], n: int, share: int) -> list[_Found]:
    """Call a function with the slices of n items, `share` items each, in as many threads as numba would take.

    A kernel that holds no lock of Python is compiled once so; a loop that numba shares out takes four times as long.
    """
    parts = [slice(start, start + share) for start in range(0, max(n, 1), share)]
    if len(parts) == 1:
        return [function(parts[0])]
    count: int = vars(config)["NUMBA_NUM_THREADS"]  # numba sets it from the environment
    with ThreadPoolExecutor(count) as threads:
        return list(threads.map(function, parts))


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
