"""Decorators of all functions that Numba compiles, and a loop that runs a compiled function in threads.

A kernel is a compiled function that Python calls. `kernel_entry` and `strict_float` decorate kernels. `force_inlined`,
`inlined_helper`, `kernel_helper` and `strict_float_helper` decorate functions that only other compiled functions call.
`run_in_threads` calls a kernel on parts of its arrays. `kernel_cache_folder` and `is_compiled` inspect Numba's cache.

Needs numba. Used by every module with compiled code, in all three packages, and by the sweeps, which compile kernels
before they start.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numba import config, njit
from numpy.typing import NDArray

#: Type of a decorator of kernels. Numba infers the argument types of the decorated function, so they are not stated.
Decorator = Callable[[Callable[..., Any]], Any]

#: Type variable: type of the entries of a log.
Entry = TypeVar("Entry", bound=np.generic)

#: Options of every kernel. The compiler may fuse a product and a sum, and may multiply by a reciprocal instead of
#: dividing. Both change results by rounding errors. It may not assume that numbers are finite, because zero and
#: infinity are legal.
_OPTIONS: Mapping[str, object] = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract", "arcp", "nsz"},
}

#: Options of helpers, which only compiled functions call. They need no Python wrapper, and no cache of their own.
_HELPER: Mapping[str, object] = {"cache": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def kernel_decorator(**options: object) -> Decorator:
    """Return numba's decorator with the options of every kernel, updated by further options."""
    compile_: Any = njit  # the type stubs of njit lack some options
    return compile_(**{**_OPTIONS, **options})


#: Decorator of kernels. A kernel releases Python's global lock, so that threads can work on parts of arrays, and counts
#: no references.
kernel_entry = kernel_decorator(nogil=True, _nrt=False)

#: Decorators of kernels and helpers whose operations are all rounded one by one, exactly as they are written.
strict_float = kernel_decorator(fastmath=False)
strict_float_helper = kernel_decorator(fastmath=False, **_HELPER)

#: Decorator of helpers that the compiler always copies into their callers. The kernel of two balls consists of such
#: helpers.
force_inlined = kernel_decorator(forceinline=True, **_HELPER)

#: Decorator of helpers without reference counting, which would take longer than their work. The kernels of chains and
#: graphs consist of such helpers.
kernel_helper = kernel_decorator(_nrt=False, **_HELPER)

#: Decorator of helpers that become part of their callers before types are inferred. It suits a function that makes up
#: nearly all of its caller: compiled separately, the function would be optimised twice.
inlined_helper = kernel_decorator(_nrt=False, inline="always", **_HELPER)

#: Number of rows per collision for which a log of states has room at first.
STATE_ROWS = 32


def run_in_threads(
    follow: Callable[[slice, NDArray[Entry]], int],
    n: int,
    *,
    share: int,
    log_rows: int,
    row_shape: tuple[int, ...],
    log_type: np.dtype[Entry],
) -> NDArray[Entry]:
    """Follow n collisions in threads, and return the rows that they logged, in the order of the collisions.

    This loop needs only a kernel that releases Python's lock. Numba's own parallel loop takes four times as long to
    compile.

    Parameters
    ----------
    follow
        Function that follows a slice of the collisions. Its arguments are the slice and a log, an array of zeros. It
        returns the number of rows that the log needs. If the log has fewer rows, it is called once more with a log of
        this size.
    n
        Number of collisions.
    share
        Number of collisions that one call of `follow` follows.
    log_rows
        Number of rows per collision that a log has in the first call.
    row_shape, log_type
        Shape of a row of the log, and type of its entries.
    """

    def follow_share(start: int) -> NDArray[Entry]:
        part = slice(start, min(start + share, n))
        rows = log_rows * (part.stop - part.start)
        while True:
            log = np.zeros((rows, *row_shape), log_type)
            needed = follow(part, log)
            if needed <= rows:
                return log[:needed]
            rows = needed

    starts = range(0, max(n, 1), share)
    if len(starts) == 1:
        return follow_share(0)
    threads: int = vars(config)["NUMBA_NUM_THREADS"]  # numba sets it from the environment
    with ThreadPoolExecutor(threads) as pool:
        return np.concatenate(list(pool.map(follow_share, starts)))


def kernel_cache_folder(kernel: Any) -> Path:
    """Return the folder in which numba keeps the machine code of a kernel between processes."""
    # Numba has no public function that returns this folder.
    return Path(kernel._cache.cache_path)


def is_compiled(kernel: Any) -> bool:
    """Return whether the cache holds machine code of a kernel for its present source.

    Numba compares the bytes of the source. Time stamps would differ in every copy of an installation.
    """
    if vars(config)["DISABLE_JIT"]:
        return True  # Numba is switched off, so nothing has to be compiled
    return bool(kernel._cache._cache_file._load_index())
