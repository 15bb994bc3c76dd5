"""Numba options shared by all kernels, and collisions shared out to threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numba import config, njit
from numpy.typing import DTypeLike, NDArray

#: A decorator; types of what it makes a kernel are numba's to infer.
Decorator = Callable[[Callable[..., Any]], Any]

#: Options of every kernel. A product and a sum may be fused and a division become a multiplication by a reciprocal,
#: each to within a rounding; nothing that assumes numbers to be finite, for zero and infinity are legal values here.
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}}


def compiled_with(**more: Any) -> Decorator:
    """Return numba's decorator with the options of every kernel, and more."""
    compile_: Any = njit  # whose stubs lack some options
    return compile_(**(_OPTIONS | more))


#: Kernels that are rounded as they are written, and parts of these: only kernels call them.
rounded = compiled_with(fastmath=False)
rounded_part = compiled_with(fastmath=False, cache=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)

#: Force-inlined variant for parts of a kernel. Python cannot call them: wrappers, and a cache of each part, would add
#: half to the time that the kernel of two balls takes to compile.
inlined = compiled_with(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, cache=False)

#: Of functions that only kernels call, those of chains above all: no references are counted and no way in from Python
#: is compiled, each of which would cost more than the work; nothing is kept, for the cache of a kernel holds all that
#: it calls. `merged` becomes a part of its caller before types are inferred: for one that is as large as all of its
#: caller, which would be optimised once more with that.
_INNER: dict[str, Any] = {"_nrt": False, "cache": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
uncounted = compiled_with(**_INNER)
merged = compiled_with(inline="always", **_INNER)

#: A kernel of these, which Python calls: it holds no lock, so that threads can be given parts of arrays.
entry = compiled_with(nogil=True, _nrt=False)

#: States of a collision for which a log has room at first.
FEW_STATES = 32


def in_shares(
    follow: Callable[[slice, Any], int], n: int, share: int, few: int, width: int, kind: DTypeLike
) -> NDArray[Any]:
    """Follow n collisions, `share` of them at once, in as many threads as numba would take; the rows of their log.

    A kernel that holds no lock of Python is compiled once so; a loop that numba shares out takes four times as long.
    `follow` is given a slice of the collisions and a log of that width and type, and returns how many rows it has.
    There is room for `few` a collision; a share with more is followed once more.
    """

    def logged(start: int) -> NDArray[Any]:
        part, room = slice(start, min(start + share, n)), few * (min(start + share, n) - start)
        while True:
            log: NDArray[Any] = np.zeros((room, width), kind)
            used = follow(part, log)
            if used <= room:
                return log[:used]
            room = used

    starts = range(0, max(n, 1), share)
    count: int = vars(config)["NUMBA_NUM_THREADS"]  # numba sets it from the environment
    with ThreadPoolExecutor(count) as threads:
        parts = [logged(0)] if len(starts) == 1 else list(threads.map(logged, starts))
    return np.concatenate(parts)


def cache_folder(kernel: Any) -> Path:
    """Return the folder in which the machine code of a kernel is kept from one process to the next."""
    # That of numba's cache, which the dispatcher knows and does not make public.
    return Path(kernel._cache.cache_path)


def is_compiled(kernel: Any) -> bool:
    """Tell whether an earlier process left the machine code of a kernel, as its source is now, in the cache.

    Numba says so, which tells a source by its bytes: its time changes with every copy of an installation.
    """
    if vars(config)["DISABLE_JIT"]:
        return True  # nothing is compiled
    return bool(kernel._cache._cache_file._load_index())
