"""Functions that wait for other processes."""

import time

import psutil


def wait_until(holds, seconds=300.0):
    """Return as soon as a condition is true. The time limit only catches processes that hang."""
    until = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > until:
            raise TimeoutError(f"nothing after {seconds:g} s")
        time.sleep(0.02)


def gone(number):
    """Return whether a process has ended, even if its parent has not waited for it."""
    try:
        return psutil.Process(number).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True
