"""Run the model over the extremes of its parameters, with the cut-off off, and count what fails.

Random cells: k2/k1 log-uniform in [1e-12, 1e12], m2/m1 log-uniform in [1e-6, 1e6], e uniform in [0, 1]; of a hundred
contacts one is exactly plastic and one has 1 - e log-uniform in [1e-4, 1e-1].
For each cell: a status that is one of the three, finite velocities with v1 >= v2 >= 0, no more energy than there was,
an energy balance that closes. Of every block, a share is solved again with k2/k1 changed in its last bit, which shows
where double precision ends.

    nice python benchmarks/extremes.py --cells 10000000
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np

from impact_xval.model import solve_batch

BLOCK = 100_000


def cells(n: int, seed: int) -> list[np.ndarray]:
    """Return k2/k1, m2/m1, e1, e2 of n cells."""
    rng = np.random.default_rng(seed)

    def restitution() -> np.ndarray:
        e, kind = rng.uniform(0, 1, n), rng.uniform(0, 1, n)
        e[kind < 0.01] = 0
        nearly = kind > 0.99
        e[nearly] = 1 - 10 ** rng.uniform(-4, -1, nearly.sum())
        return e

    return [10 ** rng.uniform(-12, 12, n), 10 ** rng.uniform(-6, 6, n), restitution(), restitution()]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    statuses: dict[str, int] = {}
    worst = {
        "not finite": 0,
        "v1 < v2": 0,
        "v2 < 0": 0,
        "energy gained": 0.0,
        "energy balance": 0.0,
        "events": 0,
    }
    moved, repeated = [], 0
    start = time.perf_counter()
    for block in range(math.ceil(options.cells / BLOCK)):
        n = min(BLOCK, options.cells - block * BLOCK)
        kappa, mu, e1, e2 = cells(n, options.seed + block)
        b = solve_batch(kappa, mu, e1, e2, stiffness_ratio_cutoff=math.inf)
        for name, count in zip(*np.unique(b.statuses, return_counts=True), strict=True):
            statuses[str(name)] = statuses.get(str(name), 0) + int(count)
        worst["not finite"] += int(np.sum(~np.isfinite(b.v1) | ~np.isfinite(b.v2)))
        for i in np.flatnonzero(b.statuses == "unconverged"):
            print(f"unconverged: {', '.join(repr(float(x[i])) for x in (kappa, mu, e1, e2))}", flush=True)
        worst["v1 < v2"] += int(np.sum(b.v1 < b.v2))
        worst["v2 < 0"] += int(np.sum(b.v2 < 0))
        worst["energy gained"] = max(worst["energy gained"], float(np.max(b.v1**2 + mu * b.v2**2 - 1)))
        worst["energy balance"] = max(
            worst["energy balance"], float(np.max(np.abs(b.diagnostics["energy_residual"])))
        )
        worst["events"] = max(worst["events"], int(np.max(b.n_events)))
        m = n // 50
        again = solve_batch(
            np.nextafter(kappa[:m], np.inf), mu[:m], e1[:m], e2[:m], stiffness_ratio_cutoff=math.inf
        )
        moved.append(np.hypot(again.v1 - b.v1[:m], np.sqrt(mu[:m]) * (again.v2 - b.v2[:m])))
        repeated += m
        if block % 10 == 9:
            print(f"{(block + 1) * BLOCK:10d} cells, {time.perf_counter() - start:6.0f} s", flush=True)
    print(f"{sum(statuses.values())} cells: " + ", ".join(f"{k} {v}" for k, v in sorted(statuses.items())))
    for name, value in worst.items():
        print(f"{name:16s} {value:g}")
    change = np.concatenate(moved)
    quantiles = ", ".join(f"{q:g}: {np.quantile(change, q):.1e}" for q in (0.5, 0.9, 0.99, 0.999, 1))
    print(
        f"k2/k1 changed in its last bit, {repeated} cells, kinetic norm of the change, quantiles: {quantiles}"
    )


if __name__ == "__main__":
    main()
