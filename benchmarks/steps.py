"""How far engines are from the law they were asked for, at the steps people run.

A seeded sample of the cells of the default grid is run in scenario ``impact`` by each engine at several steps, given as
fractions of the period of the faster contact, and by the exact solver of the same law. Printed is D, the kinetic norm
of the difference of the final velocities, between the two, over the cells of the sample in which all runs have a
result, so that the rows of an engine are comparable; statuses of the others follow. No step is extrapolated.

    python benchmarks/steps.py --cells 208 --seed 1
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.registry import law_of
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.tables.numbers import number
from impact_xval.model.collision import RESULT_STATUSES, Collision, Outcome

ENGINES = ("mujoco", "pybullet")
FRACTIONS = (1e-3, 1e-2, 0.03, 0.1)


def sample(cells: int, seed: int) -> list[Collision]:
    """Draw cells of the default grid, without replacement and in the order of the grid."""
    grid = experiment_cells(parse_config({}))
    drawn = np.random.default_rng(seed).choice(len(grid), min(cells, len(grid)), replace=False)
    return [grid[int(index)] for index in np.sort(drawn)]


def velocities(collisions: Sequence[Collision], outcomes: Sequence[Outcome]) -> np.ndarray:
    """Return (v1, sqrt(m2/m1) v2) per abs(v0), whose length is the kinetic norm; NaN without a result; shape (n, 2)."""
    rows = [
        (o.v1 / abs(c.v0), np.sqrt(c.mass_ratio) * o.v2 / abs(c.v0))
        if o.status in RESULT_STATUSES
        else (np.nan, np.nan)
        for c, o in zip(collisions, outcomes, strict=True)
    ]
    return np.array(rows)


def distances(
    engine: str, collisions: Sequence[Collision], fractions: Sequence[float]
) -> tuple[np.ndarray, list[Counter[str]]]:
    """Compute D between an engine and the exact solver of its law.

    Returns
    -------
    ndarray, shape (number of fractions, cells)
        NaN where one of the two has no result.
    list of Counter
        Cells without a result of the engine, by status, of each fraction.
    """
    settings = Settings(scenario="impact")
    exact = velocities(collisions, get_solver(law_of(engine)).solve_many(collisions, settings))
    found, failed = [], []
    for fraction in fractions:
        outcomes = get_solver(engine).solve_many(collisions, replace(settings, step_fraction=fraction))
        found.append(np.hypot(*(velocities(collisions, outcomes) - exact).T))
        failed.append(Counter(o.status for o in outcomes if o.status not in RESULT_STATUSES))
    return np.array(found), failed


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=208, help="cells of the default grid")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    options = parser.parse_args(arguments)
    collisions, start = sample(options.cells, options.seed), time.perf_counter()
    print("| engine | step, of the contact period | cells | D, median | 95th percentile | maximum |")
    print("| --- | --- | --- | --- | --- | --- |")
    for engine in ENGINES:
        reason = get_solver(engine).unavailable()
        if reason is not None:
            print(f"{engine}: {reason}")
            continue
        D, failed = distances(engine, collisions, FRACTIONS)
        kept = D[:, np.isfinite(D).all(axis=0)]
        for fraction, row in zip(FRACTIONS, kept, strict=True):
            cuts = (number(float(np.quantile(row, q)), 2) for q in (0.5, 0.95, 1.0))
            print(f"| {engine} | {fraction:g} | {row.size} | {' | '.join(cuts)} |")
        for fraction, counts in zip(FRACTIONS, failed, strict=True):
            if counts:
                print(f"{engine} at {fraction:g}: without a result " + str(dict(counts)))
    print(f"{len(collisions)} cells, seed {options.seed}, {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
