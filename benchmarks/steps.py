"""Distances of engines, at the steps that people use, from the contacts that they were asked for.

A seeded sample of the cells of the default grid is run in scenario ``impact`` by MuJoCo and PyBullet with each of their
settings and by exact Kelvin-Voigt contacts. The script prints D, the kinetic norm of the difference of the final
velocities. It is taken over the cells in which all steps of the calibrated engine have a result, so that their rows are
comparable. The statuses of the other cells follow. No step is extrapolated.

    python benchmarks/steps.py --cells 208 --seed 1

With ``--limits`` the same cells are run as drops to their limits dt -> 0, from several steps h; the number of halvings
is such that all reach the same shortest step. The script prints the number of steps of all runs together, and their
time over the time of the first row; the number of limits that are known, and their distance from the exact Kelvin-Voigt
contacts; and D at h.

    python benchmarks/steps.py --limits
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.stepping import Run
from impact_xval.compliant_baselines.registry import STEPS
from impact_xval.compliant_baselines.solver import KELVIN_VOIGT, Convergence, Settings
from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.tables.numbers import number
from impact_xval.model.collision import Collision
from impact_xval.model.outcome import Outcome
from impact_xval.model.status import RESULT_STATUSES

CALIBRATED = {name: (name, *(f"{name}:step-{step:g}" for step in STEPS)) for name in ("mujoco", "pybullet")}
OTHERS = ("mujoco:documented", "mujoco-naive", "mujoco:default", "pybullet-naive", "pybullet:default")
SETTINGS = Settings(scenario="impact")


def sample(cells: int, seed: int) -> list[Collision]:
    """Draw cells of the default grid, without replacement and in the order of the grid."""
    grid = experiment_cells(parse_config({}))
    drawn = np.random.default_rng(seed).choice(len(grid), min(cells, len(grid)), replace=False)
    return [grid[int(index)] for index in np.sort(drawn)]


def velocities(collisions: Sequence[Collision], outcomes: Sequence[Outcome]) -> np.ndarray:
    """Return (v1, sqrt(m2/m1) v2)/abs(v0), whose length is the kinetic norm; NaN without a result; shape (n, 2)."""
    found = zip(collisions, outcomes, strict=True)
    there = ((c, o) if o.status in RESULT_STATUSES else (c, None) for c, o in found)
    rows = [(o.v1, np.sqrt(c.mass_ratio) * o.v2) if o else (np.nan, np.nan) for c, o in there]
    return np.array(rows) / np.abs([[c.v0] for c in collisions])


def row(name: str, D: np.ndarray) -> None:
    """Print the row of one solver in the table."""
    cuts = (number(float(np.quantile(D, q)), 2) for q in (0.5, 0.95, 1.0))
    print(f"| `{name}` | {D.size} | {' | '.join(cuts)} |")


def limits(collisions: Sequence[Collision]) -> None:
    """Print the cost and the accuracy of limits dt -> 0 of drops, by the step h from which they begin."""
    exact = velocities(collisions, get_solver(KELVIN_VOIGT).solve_many(collisions, Settings("drop")))
    print("| solver | h | steps, millions | time | `ok` | limit: median, maximum | D at h: median |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name in CALIBRATED:
        solver, taken, first = get_solver(name), [], 0.0
        assert isinstance(solver, Engine)
        follow = solver.follow

        def counted(*given: Any, follow: Any = follow, taken: list[int] = taken) -> Run:
            taken.append((run := follow(*given)).n_steps)
            return run

        vars(solver)["follow"] = counted
        for halvings, h in ((4, 1e-3), (5, 2e-3), (6, 4e-3), (7, 8e-3)):
            taken.clear()
            start = time.process_time()
            how = Settings("drop", step_fraction=h, convergence=Convergence(halvings=halvings))
            outcomes = solver.solve_many(collisions, how)
            spent = time.process_time() - start
            first = first or spent
            known = [o.status == "ok" and not o.marked for o in outcomes]
            ends = [
                (o.diagnostics.get("v1_limit", np.nan), o.diagnostics.get("v2_limit", np.nan))
                for o in outcomes
            ]
            found = np.array(ends) / np.abs([[c.v0] for c in collisions])
            found[:, 1] *= np.sqrt([c.mass_ratio for c in collisions])
            limit = np.hypot(*(found - exact)[known].T)
            D = np.nanmedian(np.hypot(*(velocities(collisions, outcomes) - exact).T))
            best = ", ".join(number(float(x), 2) for x in (np.median(limit), limit.max()))
            cost = f"{sum(taken) / 1e6:.2f} | {spent / first:.2f} | {limit.size}"
            print(f"| `{name}` | {h:g} | {cost} | {best} | {number(float(D), 2)} |")


def main() -> None:
    """Measure what the options ask for, and print it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=208, help="cells of the default grid")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random sample of cells")
    parser.add_argument(
        "--limits",
        action="store_true",
        help="measure limits dt -> 0 of drops instead, by the step from which they begin",
    )
    options = parser.parse_args()
    collisions = sample(options.cells, options.seed)
    if options.limits:
        limits(collisions)
        return
    exact = velocities(collisions, get_solver(KELVIN_VOIGT).solve_many(collisions, SETTINGS))
    D, failed = {}, {}
    for name in (*CALIBRATED["mujoco"], *CALIBRATED["pybullet"], *OTHERS):
        outcomes = get_solver(name).solve_many(collisions, SETTINGS)
        D[name] = np.hypot(*(velocities(collisions, outcomes) - exact).T)
        failed[name] = Counter(o.status for o in outcomes if o.status not in RESULT_STATUSES)
    print("| solver | cells | D, median | 95th percentile | maximum |")
    print("| --- | --- | --- | --- | --- |")
    for names in CALIBRATED.values():
        shared = np.isfinite([D[name] for name in names]).all(axis=0)
        for name in names:
            row(name, D[name][shared])
    for name in OTHERS:
        row(name, D[name][np.isfinite(D[name])])
    print("Without a result:", {name: dict(counts) for name, counts in failed.items() if counts})


if __name__ == "__main__":
    main()
