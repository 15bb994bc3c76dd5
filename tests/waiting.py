"""Waiting for what another process does."""

import time

import psutil


def wait_until(holds, seconds=300.0):
    """Return once something holds; the limit is for what hangs, and no measure of how fast anything is."""
    until = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > until:
            raise TimeoutError(f"nothing after {seconds:g} s")
        time.sleep(0.02)


def gone(number):
    """Whether a process has ended, waited for by its parent or not."""
    try:
        return psutil.Process(number).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True
