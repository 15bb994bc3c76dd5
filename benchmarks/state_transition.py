"""Collisions per second of the state transition model, beside the ways it could have been computed instead.

Run as ``python benchmarks/state_transition.py``. One run measures, on the same random cells (k2/k1 log-uniform in
[1e-2, 1e2], m2/m1 log-uniform in [0.1, 10], e1 and e2 uniform in [0.3, 1]):

* `solve_batch` with one and with two threads, and `solve`;
* a plain event integration in time with scipy's solve_ivp, as one would write it who knows scipy well: positions and
  velocities, terminal events with a direction, rtol 1e-8, RK45 and DOP853, a largest step of a radian of the fastest
  motion. It looks at signs at the ends of steps only, so it misses some events; how often is printed too.

The slow ways run on the first cells of the batch. Then: what a cut-off costs and changes, in three boxes (`--only
cutoffs`); how the time grows with the number of cells, and with the number of events of a collision. Times are the best
of several repetitions; what was compiled is compiled before.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path

import numba
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp

from impact_xval.model import (
    SUPPLEMENT_CUTOFF,
    Collision,
    Cutoff,
    Outcome,
    solve,
    solve_batch,
)
from impact_xval.model.pair.kernel import EXACT
from impact_xval.model.solving import MAX_EVENTS, _diagrams

#: What numba has from its environment, and what a batch takes.
THREADS = numba.config.NUMBA_NUM_THREADS

#: Decades of k2/k1 and of m2/m1, and the least e: the box of all the rest, that of the default run, and a wide one, in
#: which cut-offs are compared.
BOXES = {
    "k2/k1 1e-2 to 1e2, m2/m1 0.1 to 10, e 0.3 to 1": ((-2, 2), (-1, 1), 0.3),
    "k2/k1 1e-3 to 1e3, m2/m1 0.5 to 2, e 0.5 to 1": ((-3, 3), (math.log10(0.5), math.log10(2)), 0.5),
    "k2/k1 1e-6 to 1e6, m2/m1 0.01 to 100, e 0.05 to 1": ((-6, 6), (-2, 2), 0.05),
}
CUTOFFS: tuple[Cutoff, ...] = (SUPPLEMENT_CUTOFF, "exact", 1e10, math.inf)


def random_cells(n: int, seed: int, box: str = next(iter(BOXES))) -> np.ndarray:
    """Draw n cells: rows k2/k1, m2/m1, e1, e2."""
    rng = np.random.default_rng(seed)
    ratio, mass, least = BOXES[box]
    return np.array(
        [
            10 ** rng.uniform(ratio[0], ratio[1], n),
            10 ** rng.uniform(mass[0], mass[1], n),
            rng.uniform(least, 1, n),
            rng.uniform(least, 1, n),
        ]
    )


def plain(
    kappa: float, mu: float, e1: float, e2: float, method: str, rtol: float = 1e-8
) -> tuple[float, float]:
    """Integrate one collision in time with solve_ivp, in units m1 = 1, k1 = 1, v0 = -1: its final v1 and v2.

    `max_step` is a radian of the fastest motion: without it steps jump over whole events.
    """
    k, e = [1.0, kappa], (e1, e2)
    y = [-1.0, 0.0, 0.0, 0.0]  # v1, v2, and the compressions of contacts 1 and 2
    active, compressing = [True, True], [True, True]
    while any(active):
        ratio = k[1] / k[0]
        if all(active) and not 1 / SUPPLEMENT_CUTOFF <= ratio <= SUPPLEMENT_CUTOFF:
            if ratio < 1:
                v = math.sqrt(k[1] * y[3] ** 2 / (1 + mu) + y[1] ** 2) * (e2 if compressing[1] else 1)
                return v, v
            return math.sqrt(k[0] * y[2] ** 2 + y[0] ** 2) * (e1 if compressing[0] else 1), 0.0
        c1, c2 = (k[i] if active[i] else 0.0 for i in (0, 1))
        a1, a2 = (float(a) for a in active)

        def motion(t, y, c1=c1, c2=c2, a1=a1, a2=a2):
            v1, v2, x1, x2 = y
            f1, f2 = c1 * x1, c2 * x2
            return [f1, (f2 - f1) / mu, a1 * (v2 - v1), -a2 * v2]

        names, events = [], []
        for i in (0, 1):
            sign = 1.0 if active[i] and compressing[i] else -1.0
            names.append("end" if sign > 0 else "start")
            events.append(lambda t, y, i=i, sign=sign: sign * (y[1] - y[0] if i == 0 else -y[1]))
            if active[i] and not compressing[i]:
                names.append("spent")
                events.append(lambda t, y, i=i: y[2 + i])
        contacts = [i for i in (0, 1) for _ in range(2 if active[i] and not compressing[i] else 1)]
        for event in events:
            event.terminal, event.direction = True, -1
        fastest = math.sqrt(k[0] * (1 + 1 / mu) + k[1] / mu)
        run = solve_ivp(
            motion,
            (0.0, 100 * math.sqrt((1 + mu) / min(k))),
            y,
            method=method,
            rtol=rtol,
            atol=1e-2 * rtol,
            events=events,
            max_step=1 / fastest,
        )
        y = run.y[:, -1].tolist()
        fired = next((j for j, at in enumerate(run.t_events) if at.size), None)
        if fired is None:
            return math.nan, math.nan
        i = contacts[fired]
        if names[fired] == "spent":
            active[i], y[2 + i] = False, 0.0
            continue
        # the rate that triggered the event is zero: make it so, or rounding triggers the event again
        y[i] = y[1] if i == 0 else 0.0
        if names[fired] == "end":
            compressing[i] = False
            y[2 + i] *= e[i] ** 2
            k[i] /= e[i] ** 2
        elif active[i]:
            compressing[i] = True
        else:
            active[i], compressing[i], y[2 + i] = True, True, 0.0
    return y[0], y[1]


def best_time(action: Callable[[], object], repeats: int) -> float:
    """Shortest wall time of an action, in s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)


def compare(console: Console, options: argparse.Namespace) -> None:
    """Print the rates of all ways on the same cells, and how far the slow ones are off."""
    cells = random_cells(options.cells, options.seed)
    exact = solve_batch(*cells)
    cut = solve_batch(*cells[:, : options.slow], stiffness_ratio_cutoff=SUPPLEMENT_CUTOFF)
    table = Table(
        "way", "cells", "collisions/s", "solve_batch is faster by", "off by, median", "off by > 1e-6"
    )
    rates: dict[tuple[str, int], float] = {}
    threads = range(1, min(2, THREADS) + 1)
    for n in threads:
        numba.config.NUMBA_NUM_THREADS = n
        rates["solve_batch", n] = options.cells / best_time(lambda: solve_batch(*cells), options.repeats)
        rates["the kernel alone", n] = options.cells / best_time(
            lambda: _kernel_only(cells, "exact"), options.repeats
        )
    fastest = max(rate for (way, _), rate in rates.items() if way == "solve_batch")
    for (way, n), rate in rates.items():
        table.add_row(
            f"{way}, {n} thread{'s' * (n > 1)}",
            f"{options.cells:,}",
            f"{rate:,.0f}",
            _times(fastest / rate),
        )

    def from_model(way: Callable[[Collision], Outcome]) -> Callable[..., tuple[float, float]]:
        def answer(*cell: float) -> tuple[float, float]:
            outcome = way(Collision.from_ratios(*cell))
            return outcome.v1, outcome.v2

        return answer

    ways = [
        ("solve", options.single, from_model(solve)),
        ("solve_ivp, RK45, rtol 1e-8", options.slow, lambda *cell: plain(*cell, method="RK45")),
        ("solve_ivp, DOP853, rtol 1e-8", options.slow, lambda *cell: plain(*cell, method="DOP853")),
    ]
    for name, n, way in ways:
        batch = exact if way is ways[0][2] else cut
        some = cells[:, :n].T.tolist()
        answers: list[tuple[float, float]] = []
        start = time.perf_counter()
        answers.extend(way(*cell) for cell in some)
        rate = len(some) / (time.perf_counter() - start)
        off = np.abs(np.array(answers).T - [batch.v1[:n], batch.v2[:n]]).max(axis=0)
        wrong = np.mean(~(off <= 1e-6))
        table.add_row(
            name,
            f"{len(some):,}",
            f"{rate:,.1f}",
            _times(fastest / rate),
            f"{np.nanmedian(off):.1e}",
            f"{wrong:.1%}",
        )
    console.print(table)


def compare_cutoffs(console: Console, options: argparse.Namespace) -> None:
    """Print what each cut-off costs and changes, in three boxes; processor time of one thread, counted in turns."""
    numba.config.NUMBA_NUM_THREADS = 1
    table = Table(
        "box", "cut-off", "collisions/s", "per that of 1e5", "events", "off by > 1e-9", "off, largest"
    )
    for box in BOXES:
        cells = random_cells(max(1000, options.cells // 10), options.seed, box)
        without = solve_batch(*cells, stiffness_ratio_cutoff=math.inf)
        times: dict[Cutoff, float] = dict.fromkeys(CUTOFFS, math.inf)
        for _ in range(options.repeats):
            for cutoff in CUTOFFS:
                start = time.process_time()
                _kernel_only(cells, cutoff)
                times[cutoff] = min(times[cutoff], time.process_time() - start)
        for cutoff in CUTOFFS:
            outcome = solve_batch(*cells, stiffness_ratio_cutoff=cutoff)
            off = np.maximum(abs(outcome.v1 - without.v1), abs(outcome.v2 - without.v2))
            table.add_row(
                box,
                cutoff if isinstance(cutoff, str) else f"{cutoff:g}",
                f"{cells.shape[1] / times[cutoff]:,.0f}",
                f"{times[SUPPLEMENT_CUTOFF] / times[cutoff]:.2f}",
                f"{outcome.n_events.mean():.1f}",
                f"{np.mean(off > 1e-9):.2%}",
                f"{off.max():.1e}",
            )
    console.print(table)
    numba.config.NUMBA_NUM_THREADS = THREADS


def _kernel_only(cells: np.ndarray, cutoff: Cutoff) -> None:
    # `solve_batch` solves cells twice that a finite cut-off changed; its time is not that of the cut-off.
    _diagrams(list(cells), EXACT if cutoff == "exact" else float(cutoff), MAX_EVENTS, True, False)


def grow(console: Console, options: argparse.Namespace) -> None:
    """Print the time over the number of cells, and over the number of events."""
    table = Table(
        *("cells", "time in s", "collisions/s", "memory of inputs and outputs, MB"),
        title=f"{THREADS} threads",
    )
    for power in range(2, int(math.log10(options.largest)) + 1):
        n = 10**power
        cells = random_cells(n, options.seed)
        outcome = solve_batch(*cells)
        arrays = (getattr(outcome, name) for name in outcome.__dataclass_fields__)
        size = cells.nbytes + sum(array.nbytes for array in arrays if array is not None)
        spent = best_time(lambda cells=cells: solve_batch(*cells), 1 if n > 10**6 else options.repeats)
        table.add_row(f"{n:,}", f"{spent:.2e}", f"{n / spent:,.0f}", f"{size / 1e6:,.1f}")
        del cells, outcome
    console.print(table)

    numba.config.NUMBA_NUM_THREADS = 1
    cells = random_cells(options.cells, options.seed)
    events = solve_batch(*cells).n_events
    table = Table(
        "events of a collision", "share of the cells", "us a collision", "ns an event", title="one thread"
    )
    edges = [0, 4, 6, 8, 10, 15, 20, 30, 50, 10**9]
    for low, high in pairwise(edges):
        chosen = (events > low) & (events <= high)
        if chosen.sum() < 100:
            continue
        part = cells[:, chosen]
        each = best_time(lambda part=part: solve_batch(*part), options.repeats) / chosen.sum()
        label = f"{low + 1} to {high}" if high < 10**9 else f"more than {low}"
        table.add_row(
            label, f"{chosen.mean():.1%}", f"{1e6 * each:.2f}", f"{1e9 * each / events[chosen].mean():.0f}"
        )
    console.print(table)


def _times(ratio: float) -> str:
    return f"{ratio:,.2f}" if ratio < 10 else f"{ratio:,.0f}"


def machine() -> str:
    """Say what this runs on."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("impact-xval", "numpy", "numba", "scipy"))
    return (
        f"{platform.machine()}, {platform.system()}, {os.cpu_count()} processors ({_processor()}); "
        f"Python {platform.python_version()}, {packages}"
    )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or "unknown"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--cells", type=int, default=1_000_000, help="cells of solve_batch (default: %(default)s)"
    )
    parser.add_argument("--single", type=int, default=10_000, help="of them, by solve (default: %(default)s)")
    parser.add_argument("--slow", type=int, default=100, help="by the integrators (default: %(default)s)")
    parser.add_argument(
        "--largest", type=int, default=10_000_000, help="largest batch (default: %(default)s)"
    )
    parser.add_argument(
        "--repeats", type=int, default=3, help="the best of so many counts (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")
    parser.add_argument("--only", choices=("cutoffs",), help="a part of it")
    options = parser.parse_args()
    console = Console(width=max(110, Console().width))
    console.print(machine(), highlight=False)
    solve(Collision.from_ratios(1, 1, 0.5, 0.5))
    solve_batch(*random_cells(1000, options.seed))
    if options.only is None:
        compare(console, options)
    compare_cutoffs(console, options)
    if options.only is None:
        grow(console, options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
