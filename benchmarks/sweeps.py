"""Cost of sweeps: of a cell by solver, of workers, and of a million cells.

``python benchmarks/sweeps.py costs``
    Core-seconds per cell by solver: all work of a worker for a cell (solving, path, measures, rows), on Sobol points of
    the built-in experiment's box; best of several repetitions. Ends with core-hours for 1e6 and 1e8 cells.
``python benchmarks/sweeps.py scaling``
    One and two workers on an engine sweep: wall time from the first task to the last part, and the ratio; best of
    several. The time to start the processes is shown separately.
``python benchmarks/sweeps.py million [--largest N]``
    Engine-free solvers, 1e4, 1e5 and 1e6 cells on all cores, each in a process of its own: wall time a cell of
    solving and of writing tables and summary, and the peak memory of the main process; best of several, the
    largest size once.

Times are wall times; run the script on a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from impact_xval.compliant_baselines import get_solver, solver_names
from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.experiment import REFERENCE, Config, parse_config
from impact_xval.experiments.presentation.report import write_tables
from impact_xval.experiments.sweep.rows import Experiment, solve_all
from impact_xval.experiments.sweep.run import run_sweep

ENGINE_FREE = ["bistiffness", "kelvin-voigt"]

#: Number of cells of a run that does little more than start: two chunks, one for each worker.
_FIRST = 256


def costs(repetitions: int) -> None:
    """Print the core-seconds that each solver needs per cell."""
    names = [name for name in solver_names() if get_solver(name).unavailable() is None]
    best: dict[str, float] = {}
    for name in names:
        config = parse_config({"solvers": [name], "sample": {"n": 64}})
        cells = experiment_cells(config).block(range(64))
        experiment = Experiment(config)
        solve_all(experiment, cells)
        for _ in range(repetitions):
            start = time.process_time()
            solve_all(experiment, cells)
            best[name] = min(best.get(name, math.inf), (time.process_time() - start) / 64)
    # Every solver runs together with the model, with which it is compared.
    best = {name: value - (best[REFERENCE] if name != REFERENCE else 0.0) for name, value in best.items()}
    table = Table("solver", "ms a cell", "core-hours for 1e6 cells", "core-hours for 1e8 cells")
    for name in names:
        hours = best[name] * 1e6 / 3600
        table.add_row(name, f"{1e3 * best[name]:.2f}", f"{hours:.2f}", f"{100 * hours:.0f}")
    Console().print(table)


def scaling(repetitions: int, cells: int) -> None:
    """Print the wall times of a run with one worker and with two."""
    config = parse_config({"solvers": ["mujoco"], "chunk_size": 16, "sample": {"n": cells, "seed": 1}})
    table = Table("workers", "start (s)", "solve (s)", "whole run (s)", "one over this")
    first = 0.0
    for workers in (1, 2):
        stages = min((_stages(config, workers) for _ in range(repetitions)), key=lambda run: run["solve"])
        first = first or stages["solve"]
        table.add_row(
            str(workers),
            f"{stages['start']:.2f}",
            f"{stages['solve']:.2f}",
            f"{stages['whole']:.2f}",
            f"{first / stages['solve']:.2f}",
        )
    Console().print(f"mujoco and the model, {cells} cells, best of {repetitions}")
    Console().print(table)


def _stages(config: Config, workers: int) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as name:
        root = Path(name) / "run"
        folder = run_sweep(config, root, workers=workers).folder
        session = folder.manifest()["sessions"][-1]
        return {**session["stages_s"], "whole": session["wall_time_s"]}


def million(repetitions: int, largest: int) -> None:
    """Print the cost per cell, and the memory, of runs with 1e4, 1e5 and 1e6 cells."""
    table = Table("cells", "solve", "tables, summary", "wall", "over 1e4", "core", "over 1e4", "peak memory")
    first = _best(_FIRST, repetitions)
    table.caption = (
        f"ms a cell, less what a run of {_FIRST} cells takes (it starts the processes and loads the kernels: "
        f"{first['solve'] + first['tables']:.1f} s); core: of all processes"
    )
    walls, cores = [], []
    for cells in (10_000, 100_000, 1_000_000):
        if cells > largest:
            break
        whole = _best(cells, repetitions if cells < 1_000_000 else 1)
        found = {name: 1e3 * (whole[name] - first[name]) / (cells - _FIRST) for name in first} | {
            "peak": whole["peak"]
        }
        walls.append(found["solve"] + found["tables"])
        cores.append(found["core"])
        table.add_row(
            str(cells),
            f"{found['solve']:.3f}",
            f"{found['tables']:.3f}",
            f"{walls[-1]:.3f}",
            f"{walls[-1] / walls[0]:.3f}",
            f"{cores[-1]:.3f}",
            f"{cores[-1] / cores[0]:.3f}",
            f"{found['peak'] / 1e6:.0f} MB",
        )
        Console().print(table)


def _best(cells: int, repetitions: int) -> dict[str, float]:
    return min((_one(cells) for _ in range(repetitions)), key=lambda run: run["core"])


def _one(cells: int) -> dict[str, float]:
    """Run one size in a separate process, so that its peak memory contains no other run."""
    command = [sys.executable, __file__, "one", "--cells", str(cells)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def one(cells: int) -> None:
    """Run one size and print its stages in s, and the peak memory of the main process in bytes."""
    config = parse_config({"solvers": ENGINE_FREE, "scenario": "impact", "sample": {"n": cells}})
    root = Path(tempfile.mkdtemp()) / "run"
    try:
        folder = run_sweep(config, root).folder
        start = time.perf_counter()
        write_tables(folder)
        stages = folder.manifest()["sessions"][-1]["stages_s"]
        main, workers = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        found = {
            "solve": stages["solve"],
            "tables": stages["tables"] + time.perf_counter() - start,
            "core": main.ru_utime + main.ru_stime + workers.ru_utime + workers.ru_stime,
            "peak": 1024 * main.ru_maxrss,
        }
        print(json.dumps(found))
    finally:
        shutil.rmtree(root.parent)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["costs", "scaling", "million", "one"])
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--cells", type=int, default=1024)
    parser.add_argument("--largest", type=int, default=1_000_000)
    asked = parser.parse_args()
    if asked.what == "costs":
        costs(asked.repetitions)
    elif asked.what == "scaling":
        scaling(asked.repetitions, asked.cells)
    elif asked.what == "million":
        million(asked.repetitions, asked.largest)
    else:
        one(asked.cells)


if __name__ == "__main__":
    main()
