"""Files of a run's folder: regular ones only; no link is followed."""

from __future__ import annotations

import errno
import io
import os
import stat
from pathlib import Path

#: Windows has neither flag, nor what they are against.
_FLAGS = (
    os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
)


def open_regular(path: Path) -> io.BufferedReader:
    """Open a regular file for reading.

    Raises
    ------
    OSError
        If it is anything else: a link is not followed, a pipe or a device not waited for.
    """
    refusal = OSError(errno.EINVAL, "not a regular file", str(path))
    try:
        descriptor = os.open(path, _FLAGS)
    except OSError as error:
        raise (refusal if error.errno in (errno.ELOOP, errno.ENXIO) else error) from None
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    raise refusal


def is_regular(path: Path) -> bool:
    """Whether a path is that of a regular file, and no link to one."""
    return path.is_file() and not path.is_symlink()
