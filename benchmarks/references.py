"""Collisions per second of the engine-free references, beside a plain event integration with scipy.

Run as ``python benchmarks/references.py``. The cells are random: k2/k1 log-uniform in [1e-2, 1e2], m2/m1 log-uniform in
[0.1, 10], e1 and e2 uniform in [0.3, 1]; a drop has g/(|v0| omega1) = 0.05. One run measures

* each reference in bulk, with one and with two threads, as an impact and as a drop;
* solve_ivp as one would write it who knows scipy well: positions and velocities, terminal events with a direction,
  DOP853 at rtol 1e-8, a largest step of a radian of the fastest motion. It looks at signs at the ends of steps only:
  how many of its answers are off by more than 1e-5 is printed too. It runs on the first cells, as impacts;
* a map of 1000 x 1000 cells over k2/k1 and m2/m1 of each reference, and the peak memory.

Times are the best of several repetitions; what was compiled is compiled before.
"""

from __future__ import annotations

import argparse
import math
import platform
import resource
import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp

from tests.compliant_baselines.reference_cells import BATCHES, dampings

GRAVITY_NUMBER = 0.05
REFERENCES = {law: BATCHES[law] for law in ("bistiffness", "kelvin-voigt", "hunt-crossley")}


def random_cells(n: int, seed: int) -> list[np.ndarray]:
    """Draw n cells: k2/k1, m2/m1, e1, e2."""
    rng = np.random.default_rng(seed)
    kappa, mu = 10 ** rng.uniform(-2, 2, n), 10 ** rng.uniform(-1, 1, n)
    return [kappa, mu, rng.uniform(0.3, 1, n), rng.uniform(0.3, 1, n)]


def best_time(run: Callable[[], object], repetitions: int) -> float:
    """Shortest of several run times, in s."""
    times = []
    for _ in range(repetitions):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def watched(stiff: bool, mode: list[int], k: list[float], c: list[float]) -> tuple[list[Any], list[Any]]:
    """Give what ends a segment of `plain`: the name and contact of each event, and its function for solve_ivp."""
    names, events = [], []

    def watch(name, i, direction, f):
        f.terminal, f.direction = True, direction
        names.append((name, i))
        events.append(f)

    for i, rate in ((0, lambda y: y[1] - y[0]), (1, lambda y: -y[1])):
        direction = -1 if mode[i] == 1 else 1
        if mode[i] == 0:
            watch("touch", i, 1, lambda _t, y, i=i: y[2 + i])
        elif stiff:
            watch("turn", i, direction, lambda _t, y, rate=rate: rate(y))
        else:
            watch("spent", i, direction, lambda _t, y, i=i, rate=rate: k[i] * y[2 + i] + c[i] * rate(y))
        if mode[i] == (2 if stiff else 3):
            watch("leave", i, -1, lambda _t, y, i=i: y[2 + i])
    return names, events


def plain(law: str, kappa: float, mu: float, e1: float, e2: float) -> tuple[float, float]:
    """Integrate one impact with solve_ivp, in units m1 = 1, k1 = 1, v0 = -1: its final v1 and v2.

    Modes of a contact: 0 apart, 1 pushing (in compression), 2 in restitution (`bistiffness`), 3 slack (else).
    """
    one = [np.array([x]) for x in (kappa, mu, e1, e2)]
    stiff = law == "bistiffness"
    c = [0.0, 0.0] if stiff else [float(x[0]) for x in dampings("kelvin-voigt", *one)]
    e, k, mode = (e1, e2), [1.0, kappa], [1, 1]
    y = np.array([-1.0, 0.0, 0.0, 0.0])  # v1, v2, compressions
    for _ in range(1000):
        pushing = [m in (1, 2) for m in mode]
        if not any(pushing) and y[0] >= y[1] >= 0:
            return float(y[0]), float(y[1])
        if stiff and all(pushing) and not 1e-5 < k[1] / k[0] < 1e5 and mode[0 if k[0] > k[1] else 1] == 2:
            if k[0] > k[1]:
                v = math.sqrt(k[1] * y[3] ** 2 / (1 + mu) + y[1] ** 2) * (e2 if mode[1] == 1 else 1)
                return v, v
            return math.sqrt(k[0] * y[2] ** 2 + y[0] ** 2) * (e1 if mode[0] == 1 else 1), 0.0
        k1, k2 = (k[i] * pushing[i] for i in (0, 1))
        c1, c2 = (c[i] * pushing[i] for i in (0, 1))

        def motion(_t, y, k1=k1, k2=k2, c1=c1, c2=c2):
            v1, v2, x1, x2 = y
            f1, f2 = k1 * x1 + c1 * (v2 - v1), k2 * x2 - c2 * v2
            return [f1, (f2 - f1) / mu, v2 - v1, -v2]

        names, events = watched(stiff, mode, k, c)
        fastest = math.sqrt((k1 + k2) / mu + k1)
        run = solve_ivp(
            motion,
            (0, 1e6),
            y,
            method="DOP853",
            rtol=1e-8,
            atol=1e-10,
            events=events,
            max_step=1 / fastest if fastest else math.inf,
        )
        if run.status != 1:
            break
        y = run.y[:, -1].copy()
        name, i = next(pair for pair, t in zip(names, run.t_events, strict=True) if t.size)
        if name == "turn":
            y[0 if i == 0 else 1] = y[1] if i == 0 else 0.0
            if mode[i] == 1:
                k[i] /= e[i] ** 2
                y[2 + i] *= e[i] ** 2
            mode[i] = 3 - mode[i]
        elif name == "spent":
            mode[i] = 3 if mode[i] == 1 else 1
        else:
            mode[i], y[2 + i] = (0 if name == "leave" else 1), 0.0
    return math.nan, math.nan


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=50_000, help="cells of a batch")
    parser.add_argument("--plain-cells", type=int, default=60, help="cells of the plain integration")
    parser.add_argument("--side", type=int, default=1000, help="cells along a side of the map; 0: no map")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    console = Console(width=110)
    console.print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}")
    cells = random_cells(arguments.cells, arguments.seed)
    most = numba.config.NUMBA_NUM_THREADS

    table = Table(
        "reference", "scenario", "threads", "cells/s", "against solve_ivp", "solve_ivp off by > 1e-5"
    )
    for name, reference in REFERENCES.items():
        reference(*(x[:4] for x in cells), GRAVITY_NUMBER)
        against, off = math.nan, ""
        if name != "hunt-crossley":
            n = arguments.plain_cells
            answers: list[tuple[float, float]] = []

            def slow(name=name, n=n, answers=answers):
                answers[:] = [plain(name, *(float(x[i]) for x in cells)) for i in range(n)]

            against = n / best_time(slow, 1)
            exact = reference(*(x[:n] for x in cells))
            wrong = np.abs(np.array(answers) - np.column_stack([exact.v1, exact.v2])).max(axis=1)
            off = f"{np.count_nonzero(~(wrong < 1e-5))} of {n}"
        for scenario, number in (("impact", 0.0), ("drop", GRAVITY_NUMBER)):
            for threads in sorted({1, min(2, most)}):
                numba.config.NUMBA_NUM_THREADS = threads
                rate = arguments.cells / best_time(lambda r=reference, g=number: r(*cells, g), 3)
                ratio = f"{rate / against:,.0f} x" if scenario == "impact" and against == against else ""
                table.add_row(name, scenario, str(threads), f"{rate:,.0f}", ratio, off if ratio else "")
    numba.config.NUMBA_NUM_THREADS = most
    console.print(table)

    if arguments.side:
        axis = np.linspace(-1, 1, arguments.side)
        plane = 10.0 ** (2 * axis)[None, :], 10.0 ** axis[:, None]
        for name, reference in REFERENCES.items():
            for scenario, number in (("impact", 0.0), ("drop", GRAVITY_NUMBER)):
                seconds = best_time(lambda r=reference, g=number: r(*plane, 0.9, 0.7, g), 1)
                console.print(f"map of {arguments.side}^2 cells, {name}, {scenario}: {seconds:.1f} s")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        console.print(f"peak memory {peak:.2f} GB")


if __name__ == "__main__":
    main()
