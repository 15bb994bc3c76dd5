"""The limits of a sweep on many workers: measured overheads, a simulation with them, and its check.

Each chunk of a sweep visits three stations: a worker (many; the time of the chunk), the Dask scheduler, and the main
process (one each; a few milliseconds a chunk, which submit, receive and write its part). The scheduler and the main
process are measured together, with a real scheduler and real parts: workers that do nothing show the rate at which both
saturate. A simulation of the queue (a closed network: as many chunks in flight as the main process hands out) then
predicts the share of their time for which W workers work. Its chunk times are drawn from measured ones.

The simulation is checked against the same scheduler with threads that sleep for those times: a hundred, and
a thousand, cost no processor time, and the overheads are the real ones. Run as ``python
benchmarks/scheduler.py``.
"""

from __future__ import annotations

import argparse
import heapq
import tempfile
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from distributed import Client, LocalCluster
from rich.console import Console
from rich.table import Table

from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.sweep.pool import answers_in_flight
from impact_xval.experiments.sweep.rows import Experiment, solve_all
from impact_xval.experiments.tables.folder import RunFolder, part_bytes

CHUNK = 16


def chunk_times(solvers: Sequence[str], n_chunks: int) -> tuple[np.ndarray, bytes]:
    """Measure times of chunks of `CHUNK` cells in s, and return them with the content of one part."""
    config = parse_config({"solvers": list(solvers), "sample": {"n": CHUNK * n_chunks}})
    experiment, cells = Experiment(config), experiment_cells(config)
    times, data = [], b""
    for chunk in [0, *range(n_chunks)]:
        start = time.process_time()
        data = part_bytes(solve_all(experiment, cells.block(range(CHUNK * chunk, CHUNK * (chunk + 1)))))
        times.append(time.process_time() - start)
    return np.array(times[1:]), data


def simulate(times: Sequence[float], workers: int, service: float, ahead: int) -> float:
    """Return the wall time in s of chunks on many workers and one server.

    Parameters
    ----------
    times : sequence of float
        Chunk times in s, in the order in which they are handed out.
    workers : int
        Number of workers.
    service : float
        Time in s for which a chunk occupies the scheduler and the main process together, half when it is
        handed out and half when it comes back.
    ahead : int
        Number of chunks in flight.
    """
    clock, server_free = 0.0, 0.0
    todo = deque(times)
    idle, waiting = workers, deque[float]()
    events: list[tuple[float, int, str, float]] = []
    count = 0

    def serve(now: float, kind: str, chunk: float) -> None:
        nonlocal server_free, count
        server_free = max(server_free, now) + service / 2
        heapq.heappush(events, (server_free, count, kind, chunk))
        count += 1

    for _ in range(min(ahead, len(todo))):
        serve(0.0, "out", todo.popleft())
    while events:
        clock, _, kind, chunk = heapq.heappop(events)
        if kind == "out":
            waiting.append(chunk)
        elif kind == "worked":
            idle += 1
            serve(clock, "back", chunk)
        elif todo:
            serve(clock, "out", todo.popleft())
        while idle and waiting:
            idle -= 1
            chunk = waiting.popleft()
            heapq.heappush(events, (clock + chunk, count, "worked", chunk))
            count += 1
    return clock


def _nap(seconds: float, data: bytes) -> bytes:
    time.sleep(seconds)
    return data


def run_real(client: Any, workers: int, times: Sequence[float], data: bytes) -> tuple[float, float]:
    """Run sleeping chunks on a real scheduler and write their parts.

    Returns
    -------
    wall, core : float
        Wall time, and processor time of this process (which holds the scheduler too), in s.
    """
    executor = client.get_executor(pure=False)
    with tempfile.TemporaryDirectory() as name:
        folder = RunFolder(Path(name))
        folder.parts.mkdir()
        wall, core = time.perf_counter(), time.process_time()
        answers = answers_in_flight(
            lambda seconds: executor.submit(_nap, seconds, data), list(times), lambda: 2 * workers
        )
        for number, answer in enumerate(answers):
            folder.write_part(number, f"{0:032x}", answer)
        return time.perf_counter() - wall, time.process_time() - core


def check(console: Console, workers: int, measured: np.ndarray, data: bytes, empty: int) -> float:
    """Compare the simulation with sleeping workers; return the core-seconds of service per chunk."""
    rng = np.random.default_rng(0)
    table = Table("workers", "chunk (s)", "chunks", "measured (s)", "simulated (s)", "workers busy", "N s/T")
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=workers // 2, dashboard_address="", memory_limit=0
        ) as cluster,
        Client(cluster) as client,
    ):
        run_real(client, workers, [0.0] * 100, data)
        saturated = [run_real(client, workers, [0.0] * empty, data) for _ in range(3)]
        service = min(wall for wall, _ in saturated) / empty
        core = min(core for _, core in saturated) / empty
        console.print(
            f"{workers} workers: a chunk takes {1e3 * service:.2f} ms of the scheduler and the main process, "
            f"{1e3 * core:.2f} ms of them on a processor"
        )
        for load in (0.5, 1, 2):
            # Chunk times are scaled so that the workers ask for `load` times the rate of the server.
            want = workers * service / load
            times = (rng.choice(measured, 2 * workers) / measured.mean() * want).tolist()
            real, _ = run_real(client, workers, times, data)
            table.add_row(
                str(workers),
                f"{want:.2f}",
                str(len(times)),
                f"{real:.2f}",
                f"{simulate(times, workers, service, 2 * workers):.2f}",
                f"{sum(times) / workers / real:.0%}",
                f"{load:g}",
            )
    console.print(table)
    return core


def predict(console: Console, measured: np.ndarray, service: dict[int, float]) -> None:
    """Print the share of their time for which workers work, by chunk size, in a sweep of 20 chunks per worker."""
    rng = np.random.default_rng(1)
    table = Table("workers", "cells a chunk", "chunk (s)", "workers busy", "cells a second")
    for workers, each in service.items():
        for size in (1, 4, 16, 32, 64, 256):
            times = (rng.choice(measured, 20 * workers) * size / CHUNK).tolist()
            wall = simulate(times, workers, each, 2 * workers)
            table.add_row(
                str(workers),
                str(size),
                f"{np.mean(times):.3f}",
                f"{sum(times) / workers / wall:.0%}",
                f"{size * len(times) / wall:.0f}",
            )
    console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--solvers", nargs="+", default=["mujoco", "kelvin-voigt"])
    parser.add_argument("--workers", nargs="+", type=int, default=[100, 1000])
    parser.add_argument(
        "--empty", type=int, default=1000, help="chunks of no length by which overheads are measured"
    )
    asked = parser.parse_args()
    console = Console(width=120)
    measured, data = chunk_times(asked.solvers, 12)
    console.print(
        f"chunks of {CHUNK} cells by {', '.join(asked.solvers)}: {measured.mean():.3f} s (from "
        f"{measured.min():.3f} to {measured.max():.3f}, on a processor), a part of {len(data)} bytes"
    )
    service = {workers: check(console, workers, measured, data, asked.empty) for workers in asked.workers}
    predict(console, measured, service)


if __name__ == "__main__":
    main()
