"""The packages that are engines: imported without a word, why one cannot be, and a substitute in its place."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from platform import python_version
from threading import Lock
from typing import Any

_importing = Lock()


def import_quietly(module: str) -> Any:
    """Import a module, without the line "pybullet build time: ..." that PyBullet's C code writes at the first import.

    Raises
    ------
    ImportError
        If it is not installed.
    """
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


def why_not(engine: str, distribution: str, module: str, way_out: str) -> str | None:
    """Say why the package of an engine cannot be imported, and the way out; None if it can.

    Parameters
    ----------
    engine, distribution : str
        Its name as its makers spell it, and as it is distributed.
    module : str
        What is imported.
    way_out : str
        What to run.
    """
    try:
        import_quietly(module)
    except Exception as error:  # of a package that is there but broken, any
        if isinstance(error, ModuleNotFoundError) and "." not in (error.name or ""):
            return f"{engine} is not installed: {way_out}"
        said = " ".join(str(error).split()) or type(error).__name__
        here = f"Python {python_version()} and NumPy {version('numpy')}"
        return f"{engine} {version_of(distribution)} cannot be imported by {here} ({said}): {way_out}"
    return None


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


@contextmanager
def standing_in(name: str, substitute: Any) -> Iterator[None]:
    """Let ``import name`` find a substitute, and the module that was imported before again afterwards."""
    before = sys.modules[name]
    sys.modules[name] = substitute
    try:
        yield
    finally:
        sys.modules[name] = before
