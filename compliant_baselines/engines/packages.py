"""The packages that are engines, imported without a word."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from threading import Lock
from typing import Any

_importing = Lock()


def import_quietly(module: str) -> Any:
    """Import a module, without the line "pybullet build time: ..." of PyBullet's C code at the first import."""
    with _importing:
        if module in sys.modules or module != "pybullet":
            return import_module(module)
        with standard_error_without(b"pybullet build time"):
            return import_module(module)


def version_of(distribution: str) -> str:
    """Version of an installed package, by the name it is distributed under; ``""`` if it is not installed."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""


@contextmanager
def standard_error_without(beginning: bytes) -> Iterator[None]:
    """Hold back what is written to the descriptor of standard error; write it afterwards, but for some lines."""
    try:
        terminal = os.dup(2)
    except OSError:  # closed: there is nothing to keep clean
        yield
        return
    with tempfile.TemporaryFile() as held:
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(terminal, 2)
            os.close(terminal)
            held.seek(0)
            os.write(2, b"".join(line for line in held if not line.startswith(beginning)))
