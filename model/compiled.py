"""How the kernels of the model are compiled, said once."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numba import config, njit
from numpy.typing import NDArray

#: Options of every kernel. A product and a sum may be fused and a division become a multiplication by a reciprocal,
#: each to within a rounding; nothing that assumes numbers to be finite, for zero and infinity are legal values here.
OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}}

#: What kernels are given and return: an array; a value for each of two modes or contacts; a function with its first two
#: derivatives; d1, v2, F1, F2; and a flag for each of these.
Floats = NDArray[np.float64]
Pair = tuple[float, float]
Jet = tuple[float, float, float]
State = tuple[float, float, float, float]
Flags = tuple[bool, bool, bool, bool]

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


#: Whether kernels are left to the interpreter (NUMBA_DISABLE_JIT=1), for a debugger, or for the coverage of branches.
INTERPRETED = bool(vars(config)["DISABLE_JIT"])


def compiled(kernel: Kernel, **options: Any) -> Kernel:
    """Compile a kernel; to its callers, and to a type checker, it stays the function that it was."""
    return interpreted(kernel) if INTERPRETED else cast(Kernel, njit(**options, **OPTIONS)(kernel))


def inlined(kernel: Kernel) -> Kernel:
    """Compile what is called within a search: passing a dozen numbers to it would cost as much as it does."""
    return compiled(kernel, forceinline=True)


def compiled_in_parallel(kernel: Kernel) -> Kernel:
    """Compile a kernel whose loop over cells is shared by threads."""
    return compiled(kernel, parallel=True)


def interpreted(kernel: Kernel) -> Kernel:
    """Leave a kernel to the interpreter; it divides by zero as compiled ones do, without a word, as IEEE 754 says."""

    @wraps(kernel)
    def as_compiled(*arguments: Any) -> Any:
        if np.geterr()["divide"] == "ignore":  # called by a kernel
            return kernel(*arguments)
        with np.errstate(all="ignore"):
            return kernel(*map(in_numpy, arguments))

    return cast(Kernel, as_compiled)


def in_numpy(value: Any) -> Any:
    """Return an argument of a kernel with the scalars of numpy, which know infinity, in the place of floats."""
    if isinstance(value, tuple):
        parts = cast(tuple[Any, ...], value)
        return getattr(parts, "_make", tuple)(map(in_numpy, parts))
    return np.float64(value) if type(value) is float else value


def cache_folder(kernel: Any) -> Path:
    """Return the folder in which the machine code of a kernel is kept from one process to the next."""
    # That of numba's cache, which the dispatcher knows and does not make public.
    return Path(kernel._cache.cache_path)


def is_compiled(kernel: Any) -> bool:
    """Tell whether an earlier process left the machine code of a kernel, as its source is now, in the cache."""
    if not hasattr(kernel, "py_func"):
        return True  # nothing is compiled
    python = "{}{}".format(*sys.version_info)
    function = kernel.py_func
    name = f"{function.__module__.rpartition('.')[2]}.{function.__name__}-*.py{python}*.nbi"
    changed = Path(function.__code__.co_filename).stat().st_mtime
    return any(index.stat().st_mtime >= changed for index in cache_folder(kernel).glob(name))
