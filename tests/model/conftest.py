"""Numba compiles the kernels of the model here, before the first test that runs them."""

import fcntl
import os
from pathlib import Path
from tempfile import gettempdir

import pytest
from numba import njit

from impact_xval.model import Collision, solve


def compiled(*calls):
    """Make calls that compile, each in one worker at a time: the next one loads from the cache on disk.

    Every second worker begins with the last.
    """
    odd = os.environ.get("PYTEST_XDIST_WORKER", "gw0")[-1] in "13579"
    for call in calls[:: -1 if odd else 1]:
        with Path(gettempdir(), f"impact-xval-{os.getuid()}-{call.__name__}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            call()


def from_python(part):
    """Return a part of a kernel, which only kernels call, as a kernel of its own."""
    return njit(lambda *numbers: part(*numbers))


def pair():
    collision = Collision.from_ratios(2, 1.2, 0.9, 0.7)
    for law in ("jia-mason-erdmann", "liu-zhao-brogliato"):
        solve(collision, law=law, path=True)


def chain():
    column = Collision((1, 1), (1,), (0.9,), (-1, 0))
    solve(column, path=True)


@pytest.fixture(scope="session", autouse=True)
def compiled_model():
    compiled(pair, chain)
