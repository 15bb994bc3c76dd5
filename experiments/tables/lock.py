"""One run a folder: the second refuses, and a run that died blocks nobody.

Two things guard a folder. ``.lock`` is locked by the operating system, which lets go of it the moment the
process is gone, however it went: on one machine that decides. ``.owner.json`` says who writes there, and is
touched every few seconds: where the folder is on a file system shared by machines, whose locks may not reach
from one to the other, its age decides. After a jump of the clock the age may say nothing: then the user decides.
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
from impact_xval.experiments.tables.files import open_regular
from impact_xval.experiments.tables.streams import replacing

LOCK = ".lock"
OWNER = ".owner.json"

#: Seconds between two signs of life, and without any after which a run elsewhere counts as dead.
HEARTBEAT = 10.0
SILENCE = 60.0

#: Bytes that are read of who writes there, at most.
_LONGEST = 10_000


@dataclass(frozen=True, slots=True)
class Owner:
    """Who writes, or wrote, to a folder; `age` is the time since the last sign of life, in s, < 0 if it is ahead."""

    host: str
    pid: int
    since: str
    age: float

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}, since {self.since}"

    @property
    def here(self) -> bool:
        """Whether it is, or was, a process of this machine."""
        return self.host == socket.gethostname()

    @property
    def ahead(self) -> bool:
        """Whether the sign is so far ahead of the clock that its age says nothing."""
        return self.age <= -SILENCE

    def may_live(self, take_over: bool) -> bool:
        """Judge by the age alone; `take_over` is the user's word where that says nothing."""
        return not take_over if self.ahead else self.age < SILENCE


def owner_of(root: Path) -> Owner | None:
    """Read who said last that it writes to a folder, and did not say that it ended."""
    try:
        with open_regular(root / OWNER) as file:
            value = json.loads(file.read(_LONGEST).decode("utf-8"))
            age = _now(root) - os.fstat(file.fileno()).st_mtime
        return Owner(str(value["host"]), int(value["pid"]), str(value["since"]), age)
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None


def running(root: Path, *, take_over: bool = False) -> Owner | None:
    """Return who writes to a folder now, or None; the lock itself is left alone.

    Parameters
    ----------
    root : Path
    take_over : bool
        Whether one of whom the clock does not tell if he lives counts as dead.
    """
    owner = owner_of(root)
    if owner is None:
        return None
    if owner.here:
        try:
            with FileLock(root / LOCK, timeout=0):
                return None
        except NotImplementedError:  # a file system without locks: signs of life must do
            pass
        except (Timeout, OSError):
            return owner
    return owner if owner.may_live(take_over) else None


def check_free(root: Path, *, take_over: bool = False) -> None:
    """Raise a `UserError` if a run writes to a folder now; nothing in it is touched."""
    owner = running(root, take_over=take_over)
    if owner is not None:
        raise UserError(_refusal(root, owner))


@contextlib.contextmanager
def holding(root: Path, *, take_over: bool = False) -> Iterator[str]:
    """Keep a folder to this process.

    Parameters
    ----------
    root : Path
    take_over : bool
        As for `running`.

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
        locks = True
        try:
            stack.enter_context(FileLock(root / LOCK, timeout=0))
        except Timeout:
            raise UserError(_refusal(root, owner_of(root))) from None
        except NotImplementedError:  # a file system without locks: signs of life must do
            locks = False
        before = owner_of(root)
        if before is not None and not (locks and before.here) and before.may_live(take_over):
            raise UserError(_refusal(root, before))
        stack.enter_context(_alive(root))
        yield _taken_over(before) if before is not None else ""


def _taken_over(before: Owner) -> str:
    line = f"taken over from a run that died ({before})"
    if before.here or not before.ahead:
        return line
    return f"warning: {line}, as --take-over says: its {_sign(before)}; if it lives, two runs write to this folder"


def _sign(owner: Owner) -> str:
    if owner.ahead:
        return f"last sign of life is {-owner.age:.0f} s ahead of the clock"
    return f"last sign of life {max(0.0, owner.age):.0f} s ago"


def _refusal(root: Path, owner: Owner | None) -> str:
    who = f"{owner}; {_sign(owner)}" if owner is not None else "just started"
    elsewhere, legal = "", "wait for it, or another folder"
    if owner is not None and not owner.here:
        elsewhere = f"; a run on another machine counts as dead after {SILENCE:.0f} s without a sign of life"
        legal += "; --take-over if it is known to be dead" if owner.ahead else ""
    return f"--out {root}: another run writes there ({who}){elsewhere}; legal: {legal}"


@contextlib.contextmanager
def _alive(root: Path) -> Iterator[None]:
    since = datetime.now(UTC).isoformat(timespec="seconds")
    text = json.dumps({"host": socket.gethostname(), "pid": os.getpid(), "since": since}) + "\n"
    path = root / OWNER
    with replacing(path, sync=False) as temporary:
        temporary.write_text(text, encoding="utf-8")
    ended = threading.Event()

    def ours() -> bool:
        with open_regular(path) as file:
            return file.read(_LONGEST) == text.encode()

    def heartbeat() -> None:
        while not ended.wait(HEARTBEAT):
            with contextlib.suppress(OSError):
                if ours():
                    os.utime(path)

    threading.Thread(target=heartbeat, daemon=True).start()
    try:
        yield
    finally:
        ended.set()
        with contextlib.suppress(OSError):
            if ours():  # it may have been taken over
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
