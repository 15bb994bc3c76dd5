"""One run a folder: the second refuses, and a run that died blocks nobody.

Two things guard a folder. ``.lock`` is locked by the operating system, which lets go of it the moment the
process is gone, however it went: on one machine that decides. ``.owner.json`` says who writes there, and is
touched every few seconds: where the folder is on a file system shared by machines, whose locks may not reach
from one to the other, its age decides.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout

from impact_xval.experiments.config.errors import UserError

LOCK = ".lock"
OWNER = ".owner.json"

#: Seconds between two signs of life, and without any after which a run elsewhere counts as dead.
HEARTBEAT = 10.0
SILENCE = 60.0


@dataclass(frozen=True, slots=True)
class Owner:
    """Who writes, or wrote, to a folder; `age` is the time since the last sign of life, in s."""

    host: str
    pid: int
    since: str
    age: float

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}, since {self.since}"


def owner_of(root: Path) -> Owner | None:
    """Read who said last that it writes to a folder, and did not say that it ended."""
    path = root / OWNER
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
        age = _now(root) - path.stat().st_mtime
        return Owner(str(value["host"]), int(value["pid"]), str(value["since"]), max(0.0, age))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def running(root: Path) -> Owner | None:
    """Return who writes to a folder now, or None; the lock itself is left alone."""
    owner = owner_of(root)
    if owner is None:
        return None
    if owner.host != socket.gethostname():
        return owner if owner.age < SILENCE else None
    try:
        with FileLock(root / LOCK, timeout=0):
            return None
    except (Timeout, OSError, NotImplementedError):
        return owner


def check_free(root: Path) -> None:
    """Raise a `UserError` if a run writes to a folder now; nothing in it is touched."""
    owner = running(root)
    if owner is not None:
        raise UserError(_refusal(root, owner))


@contextlib.contextmanager
def holding(root: Path) -> Iterator[str]:
    """Keep a folder to this process.

    Yields
    ------
    str
        A line worth saying, or "": that a run died here, and who it was.

    Raises
    ------
    UserError
        If another run writes there.
    """
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(FileLock(root / LOCK, timeout=0))
        except Timeout:
            raise UserError(_refusal(root, owner_of(root))) from None
        except NotImplementedError:  # a file system without locks: signs of life must do
            pass
        before = owner_of(root)
        if before is not None and before.host != socket.gethostname() and before.age < SILENCE:
            raise UserError(_refusal(root, before))
        stack.enter_context(_alive(root / OWNER))
        yield f"taken over from a run that died ({before})" if before is not None else ""


def _refusal(root: Path, owner: Owner | None) -> str:
    who = f"{owner}; last sign of life {owner.age:.0f} s ago" if owner is not None else "just started"
    elsewhere = ""
    if owner is not None and owner.host != socket.gethostname():
        elsewhere = f"; a run on another machine counts as dead after {SILENCE:.0f} s without a sign of life"
    return f"--out {root}: another run writes there ({who}){elsewhere}; legal: wait for it, or another folder"


@contextlib.contextmanager
def _alive(path: Path) -> Iterator[None]:
    since = datetime.now(UTC).isoformat(timespec="seconds")
    text = json.dumps({"host": socket.gethostname(), "pid": os.getpid(), "since": since})
    path.write_text(text + "\n", encoding="utf-8")
    ended = threading.Event()

    def heartbeat() -> None:
        while not ended.wait(HEARTBEAT):
            with contextlib.suppress(OSError):
                os.utime(path)

    threading.Thread(target=heartbeat, daemon=True).start()
    try:
        yield
    finally:
        ended.set()
        with contextlib.suppress(OSError):
            path.unlink()


def _now(root: Path) -> float:
    """Time by the clock of the file system, which stamps the signs of life."""
    try:
        with tempfile.TemporaryFile(dir=root) as file:
            file.write(b"0")
            file.flush()
            return os.fstat(file.fileno()).st_mtime
    except OSError:
        return time.time()
