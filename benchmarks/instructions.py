"""Instructions a collision of `solve_batch` costs: a figure that does not depend on how busy the machine is.

Run as ``python benchmarks/instructions.py`` where valgrind is installed. Cachegrind counts the instructions, the
conditional branches and those that its simple predictor would have missed, of two processes that solve different
numbers of the same random cells as `state_transition.py`; their difference is the kernel's, start and compilation
left out. The kernels are compiled for a processor that valgrind knows (AVX2 and FMA, no AVX-512), in a cache of
their own. Beside them stand the events.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile

import numpy as np
from state_transition import random_cells

from impact_xval.model import solve_batch

#: What valgrind can run, and one thread.
PROCESSOR = {
    "NUMBA_CPU_NAME": "haswell",
    "NUMBA_CPU_FEATURES": "+sse4.2,+avx,+avx2,+fma,+bmi,+bmi2,+popcnt,+lzcnt",
    **dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"),
}
#: Lines of cachegrind's report, and how each is called here.
COUNTS = {
    "instructions": r"I\s+refs:\s+([\d,]+)",
    "conditional branches": r"Branches:.*\(\s*([\d,]+) cond",
    "of them mispredicted": r"Mispredicts:.*\(\s*([\d,]+) cond",
}


CACHEGRIND = (
    "valgrind",
    "--tool=cachegrind",
    "--cache-sim=no",
    "--branch-sim=yes",
    "--cachegrind-out-file=/dev/null",
)


def counts(cells: int, seed: int, cache: str, tool: tuple[str, ...] = CACHEGRIND) -> dict[str, int]:
    """Count what a process does that solves so many cells."""
    command = [*tool, sys.executable, __file__, "--solve", str(cells), "--seed", str(seed)]
    environment = os.environ | PROCESSOR | {"NUMBA_CACHE_DIR": cache}
    report = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stderr
    found = {name: re.search(pattern, report) for name, pattern in COUNTS.items()}
    return {name: int(match[1].replace(",", "")) for name, match in found.items() if match}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--cells", type=int, default=20_000, help="(default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")
    parser.add_argument("--solve", type=int, help="solve so many cells and print nothing: what is counted")
    options = parser.parse_args()
    if options.solve:
        solve_batch(*random_cells(options.solve, options.seed))
        return 0
    if shutil.which("valgrind") is None:
        print("valgrind is not installed", file=sys.stderr)
        return 1
    few = 1000
    with tempfile.TemporaryDirectory() as cache:
        counts(few, options.seed, cache, ())  # compiles
        start, end = (counts(n, options.seed, cache) for n in (few, few + options.cells))
    cells = random_cells(options.cells, options.seed)
    print(f"{np.mean(solve_batch(*cells).n_events):12,.1f} events a collision")
    for name in start:
        print(f"{(end[name] - start[name]) / options.cells:12,.0f} {name} a collision")
    return 0


if __name__ == "__main__":
    sys.exit(main())
