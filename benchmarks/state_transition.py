"""Collisions per second of the state transition model and of an integration in time.

Run as ``python -m benchmarks.state_transition``. On the same random cells (k2/k1 log-uniform in [1e-2, 1e2], m2/m1
log-uniform in [0.1, 10], e1 and e2 uniform in [0.3, 1]) it times `solve_batch` with one thread and with two, and
`solve`. On the first cells it also times the integration with events by scipy's DOP853 with which the tests compare the
model (tests/model/chain_reference.py). Times are the best of several repetitions, and contain no compilation.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections.abc import Callable
from importlib.metadata import version

import numba
import numpy as np
from rich.console import Console
from rich.table import Table

from impact_xval.model import Collision, solve, solve_batch
from tests.model.chain_reference import JME, integrate


def random_cells(n: int, seed: int) -> np.ndarray:
    """Return n random cells, shape (4, n): the rows are k2/k1, m2/m1, e1 and e2."""
    rng = np.random.default_rng(seed)
    ratios = [10 ** rng.uniform(-2, 2, n), 10 ** rng.uniform(-1, 1, n)]
    return np.array([*ratios, rng.uniform(0.3, 1, n), rng.uniform(0.3, 1, n)])


def best_time(action: Callable[[], object], repeats: int) -> float:
    """Return the shortest wall time of an action in s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)


def machine() -> str:
    """Return a description of this machine."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("impact-xval", "numpy", "numba", "scipy"))
    system = f"{platform.machine()}, {platform.system()}, {os.cpu_count()} processors"
    return f"{system}; Python {platform.python_version()}, {packages}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--cells",
        type=int,
        default=1_000_000,
        help="number of collisions for solve_batch (default: %(default)s)",
    )
    parser.add_argument(
        "--single", type=int, default=10_000, help="number of collisions for solve (default: %(default)s)"
    )
    parser.add_argument(
        "--slow",
        type=int,
        default=50,
        help="number of collisions for the integration in time (default: %(default)s)",
    )
    parser.add_argument(
        "--repeats",
        type=int,
        default=3,
        help="repetitions, of which the fastest counts (default: %(default)s)",
    )
    asked = parser.parse_args()
    cells = random_cells(asked.cells, seed=0)
    collisions = [Collision.from_ratios(*cell) for cell in cells[:, : max(asked.single, asked.slow)].T]
    ways: dict[str, tuple[int, Callable[[], object]]] = {
        "solve": (asked.single, lambda: [solve(each) for each in collisions[: asked.single]]),
        "DOP853": (asked.slow, lambda: [integrate(each, JME) for each in collisions[: asked.slow]]),
    }
    solve_batch(*cells[:, :1000])
    table = Table("way", "cells", "collisions/s")
    for threads in (1, 2):
        numba.config.NUMBA_NUM_THREADS = threads  # number of threads that a batch uses
        spent = best_time(lambda: solve_batch(*cells), asked.repeats)
        table.add_row(f"solve_batch, threads: {threads}", f"{asked.cells:,}", f"{asked.cells / spent:,.0f}")
    for way, (n, action) in ways.items():
        table.add_row(way, f"{n:,}", f"{n / best_time(action, asked.repeats):,.0f}")
    console = Console(width=110)
    console.print(machine(), table, sep="\n", highlight=False)


if __name__ == "__main__":
    main()
