"""One run a folder: the operating system's lock, let go of the moment its process is gone, however it went."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from impact_xval.experiments.config.errors import UserError

LOCK = ".lock"


def running(root: Path) -> bool:
    """Whether a run writes to a folder now; one that may not be written to is left alone."""
    if not (root / LOCK).exists():
        return False
    try:
        with FileLock(root / LOCK, timeout=0):
            return False
    except Timeout:
        return True
    except OSError:
        return False


def check_free(root: Path) -> None:
    """Raise a `UserError` if a run writes to a folder now; nothing in it is touched."""
    if running(root):
        raise UserError(f"--out {root}: another run writes there; legal: wait for it, or another folder")


@contextlib.contextmanager
def holding(root: Path) -> Iterator[None]:
    """Keep a folder to this process.

    Raises
    ------
    UserError
        If another run writes there.
    """
    lock = FileLock(root / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise UserError(f"--out {root}: another run has just begun there; legal: wait for it") from None
    try:
        yield
    finally:
        lock.release()
