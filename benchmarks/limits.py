"""Accuracy of the engines' limits dt -> 0, jumps of exact solvers, and marks that are lost by solving fewer collisions.

    python benchmarks/limits.py engines --cells 2000      # some fifteen minutes on one core
    python benchmarks/limits.py engines --cells 200 --box '{"stiffness_ratio": {"log": [100, 1000]}}'
    python benchmarks/limits.py jumps --cells 200000      # a minute
    python benchmarks/limits.py screens --cells 100000    # a minute

**engines** draws cells of the default box (`config.axes.Sample`), or of `--box`, runs both engines with convergence
estimates, and compares every unmarked limit of status ok with the exact Kelvin-Voigt solution. It prints the share of
limits that are further from it than three times the stated error, and the largest distance. **jumps** solves every cell
by an exact reference, then again with k2/k1, k1 and both stiffnesses changed by a relative amount. It prints the
numbers of marked and of unmarked cells whose velocities change by more than given amounts. **screens** counts the jumps
that are not found because screens skip collisions that seem far from a jump.
"""

from __future__ import annotations

import argparse
import math
import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from impact_xval.compliant_baselines import get_solver, marks, references
from impact_xval.compliant_baselines.solver import Convergence, Settings
from impact_xval.experiments.config.axes import Sample
from impact_xval.model.collision import Collision
from impact_xval.model.collisions import Collisions
from impact_xval.model.outcomes import Outcomes

LAWS = ("kelvin-voigt", "bistiffness")
ENGINES = ("mujoco", "pybullet")

#: A limit counts as wrong if its error is more than this many times the error that the engine states.
HONEST = 3.0


def draw(n: int, seed: int, box: Sample) -> np.ndarray:
    """Return k2/k1, m2/m1, e1 and e2 of n random cells of a box, shape (4, n)."""
    return box.place(np.random.default_rng(seed).random((n, len(box.free())))).T


def solve(cells: np.ndarray, settings: Settings, k1: float) -> list[list[tuple[str, str, float, float]]]:
    """Return, for each engine and cell: status, mark, distance of the limit from the exact solution, stated error."""
    collisions = [Collision.two_balls(1.0, mu, k1, k1 * kappa, e1, e2, -1.0) for kappa, mu, e1, e2 in cells.T]
    exact = get_solver("kelvin-voigt").solve_many(collisions, settings)
    rows = []
    for name in ENGINES:
        outcomes = get_solver(name).solve_many(collisions, settings)
        row = []
        for outcome, true in zip(outcomes, exact, strict=True):
            d = outcome.diagnostics
            v1, v2 = d.get("v1_limit", math.nan), d.get("v2_limit", math.nan)
            away = max(abs(v1 - true.v1), abs(v2 - true.v2))
            row.append((outcome.status, outcome.mark, away, d.get("limit_error", math.nan)))
        rows.append(row)
    return rows


def engines(options: argparse.Namespace) -> None:
    """Compare the limits of both engines with exact Kelvin-Voigt contacts."""
    cells = draw(options.cells, options.seed, options.box)
    settings = Settings(
        scenario=options.scenario,
        step_fraction=options.step_fraction,
        convergence=Convergence(tolerance=options.tolerance),
    )
    chunks = np.array_split(cells, max(1, options.cells // 25), axis=1)
    with ProcessPoolExecutor(options.workers) as pool:
        done = list(pool.map(partial(solve, settings=settings, k1=options.k1), chunks))
    for i, name in enumerate(ENGINES):
        rows = [row for chunk in done for row in chunk[i]]
        away, error = (np.array([row[j] for row in rows]) for j in (2, 3))
        marked = np.array([bool(row[1]) for row in rows])
        judged = np.array([row[0] == "ok" for row in rows]) & ~marked
        wrong = judged & (away > HONEST * error)
        statuses = ", ".join(f"{n} {status}" for status, n in Counter(row[0] for row in rows).items())
        print(f"{name}: {statuses}; {marked.sum()} marked of {len(rows)}")
        print(
            f"  ok and unmarked: {judged.sum()}, of which {wrong.sum()} ({wrong.sum() / judged.sum():.2%}) further "
            f"than {HONEST:g} stated errors from exact; furthest {away[judged].max():.2e}, "
            f"most stated errors {np.max((away / error)[judged]):.1f}"
        )
        for j in np.flatnonzero(judged)[np.argsort(-(away / error)[judged])][: options.show]:
            cell = ", ".join(repr(float(x)) for x in cells[:, j])
            print(f"    {away[j]:.2e}, stated {error[j]:.2e}: {cell}")


def jumps(options: argparse.Namespace) -> None:
    """Change stiffnesses a little, and print the number of cells whose velocities change much."""
    kappa, mu, e1, e2 = draw(options.cells, options.seed, options.box)
    number = 9.81 / np.sqrt(options.k1 * (1 + 1 / mu)) * (options.scenario == "drop")
    c = 1 + options.change
    collisions, gravity = Collisions.from_ratios(kappa, mu, e1, e2), number * np.sqrt(1 + 1 / mu)
    for name in LAWS:
        law, moved = references.law_at(name), np.zeros(options.cells)
        base = law(collisions, gravity)
        for ratio, weight in ((kappa * c, 1.0), (kappa / c, math.sqrt(c)), (kappa, math.sqrt(c))):
            other = law(Collisions.from_ratios(ratio, mu, e1, e2), gravity / weight)
            moved = np.fmax(moved, np.maximum(abs(other.v1 - base.v1), abs(other.v2 - base.v2)))
        marked = marks.find_jumps(law, collisions, base, gravity).excess > 1
        print(
            f"{name}, {options.scenario}: {marked.sum()} of {options.cells} marked; unmarked cells that "
            f"{options.change:g} in k2, k1 or both moves by more than "
            + ", ".join(f"{a:g}: {np.sum(~marked & (moved > a))}" for a in (0.02, 5e-3, 1e-3))
            + f" (marked: {np.sum(marked & (moved > 0.02))} beyond 0.02); furthest {moved[~marked].max():.2e}"
        )


def screens(options: argparse.Namespace) -> None:
    """Print the number of jumps that are not found with screens, and the number of collisions solved with screens."""
    unit = np.random.default_rng(options.seed).random((options.cells, 4))
    cells = 10 ** (6 * unit[:, 0] - 3), 10 ** (2 * unit[:, 1] - 1), *(0.1 + 0.9 * unit[:, 2:].T)
    collisions = Collisions.from_ratios(*cells)
    gravity = np.full(options.cells, 9.81 / math.sqrt(options.k1) * (options.scenario == "drop"))
    for name in LAWS:
        law, solves = references.law_at(name), 0

        def counted(some: Collisions, g: np.ndarray, law: marks.Law = law) -> Outcomes:
            nonlocal solves
            solves += len(some)
            return law(some, g)

        exact = law(collisions, gravity)
        found = marks.find_jumps(counted, collisions, exact, gravity).excess > 1
        marked = marks.find_jumps(law, collisions, exact, gravity, everywhere=True).excess > 1
        print(
            f"{name}, {options.scenario}: {marked.sum()} of {options.cells} marked, {np.sum(marked & ~found)} of them "
            f"lost, with {solves / options.cells:.2f} solves a cell beside its own"
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("engines", "jumps", "screens"))
    parser.add_argument("--cells", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scenario", choices=("drop", "impact"), default="drop")
    parser.add_argument("--k1", type=float, default=1e8, help="N/m, at m1 = 1 kg and v0 = -1 m/s")
    parser.add_argument(
        "--box", type=Sample.model_validate_json, default=Sample(), help="JSON of `config.axes.Sample`"
    )
    parser.add_argument(
        "--step-fraction",
        type=float,
        default=1e-3,
        help="time step over the period of the faster contact (engines)",
    )
    parser.add_argument(
        "--tolerance", type=float, default=1e-3, help="largest accepted error of limits, per |v0| (engines)"
    )
    parser.add_argument("--change", type=float, default=1e-3, help="relative change of stiffnesses (jumps)")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes (engines)")
    parser.add_argument("--show", type=int, default=0, help="cells to list, the least honest first (engines)")
    options = parser.parse_args()
    options.cells = options.cells or {"engines": 2000, "jumps": 200_000, "screens": 100_000}[options.what]
    {"engines": engines, "jumps": jumps, "screens": screens}[options.what](options)


if __name__ == "__main__":
    main()
