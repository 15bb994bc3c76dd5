"""Test of the grazing margin as a sign of cells whose outcome jumps.

Random cells (k2/k1 log-uniform in [1e-2, 1e2], m2/m1 log-uniform in [0.1, 10], e uniform in [0.3, 1]) are solved, and
solved again with each parameter changed by a relative amount either way. A cell jumps if its velocities change by more
than `--amount`. For each threshold of the margin the script prints two shares: the share of jumping cells with a margin
below it, and the share of cells below it that jump.

    python benchmarks/grazing.py --cells 2000000 --change 1e-6 --amount 1e-3
"""

from __future__ import annotations

import argparse

import numpy as np

from impact_xval.model import solve_batch


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=1_000_000)
    parser.add_argument("--change", type=float, default=1e-6, help="relative change of each parameter")
    parser.add_argument(
        "--amount", type=float, default=1e-3, help="change of (v1, v2) per |v0| that counts as a jump"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    rng = np.random.default_rng(options.seed)
    n = options.cells
    cells = [
        10 ** rng.uniform(-2, 2, n),
        10 ** rng.uniform(-1, 1, n),
        rng.uniform(0.3, 1, n),
        rng.uniform(0.3, 1, n),
    ]
    base = solve_batch(*cells)
    change = np.zeros(n)
    for i in range(4):
        for sign in (1, -1):
            moved = [c * (1 + sign * options.change) if j == i else c for j, c in enumerate(cells)]
            moved[2:] = [np.minimum(1, e) for e in moved[2:]]
            other = solve_batch(*moved)
            change = np.maximum(change, np.hypot(other.v1 - base.v1, other.v2 - base.v2))
    jumps = change > options.amount
    print(
        f"{n} cells, each parameter changed by {options.change:g}: {jumps.sum()} jump by more than {options.amount:g}"
    )
    print(f"median change of the others: {np.median(change[~jumps]):.2g}")
    print(f"{'margin below':>14} {'flagged':>9} {'of jumps, flagged':>18} {'of flagged, jump':>17}")
    for factor in (0.3, 1, 3, 10, 30, 100):
        flagged = base.grazing_margin < factor * options.change
        both = np.sum(jumps & flagged)
        recall = both / jumps.sum() if jumps.any() else float("nan")
        precision = both / flagged.sum() if flagged.any() else float("nan")
        print(f"{factor * options.change:14.1e} {flagged.sum():9d} {recall:18.1%} {precision:17.1%}")


if __name__ == "__main__":
    main()
