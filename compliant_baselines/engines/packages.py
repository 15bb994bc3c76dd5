"""The packages that are engines: PyBullet imported without a word, and a substitute in a package's place."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from threading import Lock
from typing import Any

_importing = Lock()


def import_pybullet() -> Any:
    """Import PyBullet, without the line that its C code prints at the first import ("pybullet build time").

    What stands in its place at the moment (`standing_in`) is taken as it is.

    Raises
    ------
    ImportError
        If it is not installed.
    """
    with _importing:
        if os.name != "posix" or "pybullet" in sys.modules:
            return import_module("pybullet")
        with _c_output_dropped():
            return import_module("pybullet")


@contextmanager
def _c_output_dropped() -> Iterator[None]:
    """Drop what C code writes to standard output; what another thread prints in this moment is lost with it."""
    libc = ctypes.CDLL(None)
    libc.fflush(None)
    try:
        terminal = os.dup(1)
    except OSError:  # closed: there is nothing to keep clean
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    try:
        yield
    finally:
        libc.fflush(None)  # it buffers what it prints where standard output is a file
        os.dup2(terminal, 1)
        os.close(terminal)


@contextmanager
def standing_in(name: str, substitute: Any) -> Iterator[None]:
    """Let ``import name`` find a substitute, and the module that was imported before again afterwards."""
    before = sys.modules[name]
    sys.modules[name] = substitute
    try:
        yield
    finally:
        sys.modules[name] = before
