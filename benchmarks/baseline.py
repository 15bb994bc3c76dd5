"""What the solvers cost, in units of the machine that runs them, beside what is recorded in `baseline.json`.

A unit is the processor time in which numpy sorts a million random numbers, measured beside each call; a cost is that of
a call over it, the least of several, on one thread. So a faster or a busy machine changes little, and a change of the
code shows. Exit code 1 where a cost is more than `--factor` times the recorded one.

    python benchmarks/baseline.py               # compare
    python benchmarks/baseline.py --record      # write benchmarks/baseline.json, with the machine described
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numba import set_num_threads

from impact_xval.compliant_baselines import get_solver
from impact_xval.model import Collision, Column, solve, solve_batch, solve_column

FILE = Path(__file__).with_name("baseline.json")
CELL = Collision.from_ratios(stiffness_ratio=40.0, mass_ratio=1.1547, e1=0.9, e2=0.7)
CRADLE = Column((1.0,) * 5, (1.0,) * 4, (0.95,) * 4, (-1.0, 0.0, 0.0, 0.0, 0.0))


def best(call: Callable[[], object], seconds: float) -> float:
    """Least processor time in s of as many calls as fit into some seconds; the first compiles, and does not count."""
    call()
    times, end = [], time.perf_counter() + seconds
    while len(times) < 3 or time.perf_counter() < end:
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def costs(seconds: float) -> dict[str, float]:
    """Cost of each call, in units of the machine."""
    random = np.random.default_rng(1)
    numbers = random.random(1_000_000)
    n = 20_000
    cells = (
        10 ** random.uniform(-2, 2, n),
        10 ** random.uniform(-1, 1, n),
        random.uniform(0.3, 1, n),
        random.uniform(0.3, 1, n),
    )
    calls: dict[str, Callable[[], object]] = {
        "solve_batch, 20 000 cells": lambda: solve_batch(*cells),
        "solve, a hundred times": lambda: [solve(CELL) for _ in range(100)],
        "solve_column, five balls, a hundred times": lambda: [solve_column(CRADLE) for _ in range(100)],
        "solve_column, five balls, exponent 1.5": lambda: solve_column(CRADLE, exponent=1.5),
    }
    for name in ("kelvin-voigt", "mujoco", "pybullet"):
        solver = get_solver(name)
        if solver.unavailable() is None:
            calls[name] = lambda solver=solver: solver.solve(CELL)
    set_num_threads(1)

    def unit() -> float:
        return best(lambda: np.sort(numbers), seconds / 2)

    found: dict[str, float] = {}
    for name, call in calls.items():
        before = unit()
        least = best(call, seconds)
        found[name] = 2 * least / (before + unit())
    return found


def main() -> int:
    """Measure, and compare or record."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--record", action="store_true", help="write the baseline")
    parser.add_argument("--factor", type=float, default=2.0, help="that is too much (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=2.0, help="for each call (default: %(default)s)")
    options = parser.parse_args()
    found = costs(options.seconds)
    if options.record:
        machine = {
            "processor": platform.machine(),
            "cores": os.cpu_count(),
            "python": platform.python_version(),
            **{name: version(name) for name in ("numpy", "numba", "mujoco")},
        }
        text = json.dumps(
            {"machine": machine, "costs": {k: float(f"{v:.3g}") for k, v in found.items()}}, indent=2
        )
        FILE.write_text(text + "\n", encoding="utf-8")
    recorded = json.loads(FILE.read_text(encoding="utf-8"))["costs"]
    slower = 0
    for name, cost in found.items():
        ratio = cost / recorded[name] if name in recorded else float("nan")
        slower += ratio > options.factor
        print(f"{name:44} {cost:10.4g} units, {ratio:.2f} times the recorded")
    return 1 if slower else 0


if __name__ == "__main__":
    sys.exit(main())
