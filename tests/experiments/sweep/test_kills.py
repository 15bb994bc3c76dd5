"""Runs killed with -9 at random instants, the main process, a worker, or all of them, and resumed.

``KILLS=50 python -m pytest tests/experiments/sweep/test_kills.py -m slow`` kills fifty times.
"""

import contextlib
import os
import random
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.tables.store import TABLES

ROOT = Path(__file__).parents[3]
KILLS = int(os.environ.get("KILLS", "12"))

CONFIG = """
scenario = "impact"
solvers = ["kelvin-voigt", "mujoco"]
step_fraction = 0.005
chunk_size = 6
[grid]
stiffness_ratio = {log = [0.02, 50, 40]}
mass_ratio = [1.0, 2.0]
e1 = [0.7, 0.9]
e2 = [0.6, 0.8]
"""
CELLS = 320


def _start(config, out):
    return subprocess.Popen(
        [sys.executable, "-m", "tests.experiments.runner", str(config), str(out), "--workers", "2"],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )


def _tables(root):
    return {name: (root / name).read_bytes() for name in TABLES}


def _kill(process, whom, rng):
    """Kill the main process, one of its workers, or all; say whether anything was there to kill."""
    with contextlib.suppress(psutil.NoSuchProcess):
        main = psutil.Process(process.pid)
        workers = main.children()
        if whom == "worker":
            if not workers:
                return False
            rng.choice(workers).kill()
            return True
        for each in [main, *(workers if whom == "all" else [])]:
            with contextlib.suppress(psutil.NoSuchProcess):
                each.kill()
        return True
    return False


@pytest.mark.slow
def test_killed_runs_resume_to_the_same_bytes(tmp_path):
    config = tmp_path / "c.toml"
    config.write_text(CONFIG)
    start = time.monotonic()
    first = _start(config, tmp_path / "whole")
    _, error = first.communicate()
    assert first.returncode == 0, error
    length = time.monotonic() - start
    whole = _tables(tmp_path / "whole")
    cells = pq.read_table(tmp_path / "whole/cells.parquet", columns=["cell"]).column("cell").to_pylist()
    assert cells == [i for i in range(CELLS) for _ in range(3)]

    rng = random.Random(6)
    killed, runs = 0, 0
    kinds = Counter()
    while killed < KILLS:
        out = tmp_path / f"run{runs}"
        runs += 1
        for attempt in range(100):
            process = _start(config, out)
            whom = ("main", "worker", "all")[killed % 3]
            # Instants anywhere in a run: while it starts, plans, computes and writes its tables.
            undisturbed = attempt >= 4 or killed >= KILLS
            instant = rng.uniform(0, length)
            try:
                process.wait(None if undisturbed else instant)
                length *= (
                    1.0 if undisturbed or attempt else 0.9
                )  # over too soon: the machine is faster by now
            except subprocess.TimeoutExpired:
                done = _kill(process, whom, rng)
                killed += done
                kinds[whom] += done
            _, error = process.communicate()
            if process.returncode == 0:
                break
            assert process.returncode == -9, error
        assert _tables(out) == whole
        assert len(list((out / "parts").iterdir())) == -(-CELLS // 6)
        assert not list(out.glob(".tmp-*"))
    print(f"{killed} kills {dict(kinds)} in {runs} runs of {length:.0f} s")
