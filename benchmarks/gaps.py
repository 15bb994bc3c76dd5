"""Limits of engines on chains whose balls are apart: numbers of limits that are `ok`, withheld, right and wrong.

    python -m benchmarks.gaps [--chains 200] [--engine rapier] [--seed 0] [--show]

Random chains have 2 to 4 balls with or without a table, masses from 0.3 to 3 kg, and gaps from 2e-4 to 6e-3 m. The
first ball strikes the others, which are at rest, at 20 m/s. In every second chain e is 1, in the others each contact
has an e from 0.5 to 1. The limit of a rigid engine is compared with single impacts, one after the other, and the limit
of a compliant engine with exact Kelvin-Voigt contacts. A limit is wrong if it is further off than three stated errors,
and right if it is within the tolerance, 1e-3 |v0|. Collisions that an engine refuses, or that are not over, have no
limit.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.registry import kind_of
from impact_xval.compliant_baselines.solver import Convergence, Settings
from impact_xval.model.collision import Collision
from impact_xval.model.outcome import Outcome

ENGINES = ("mujoco", "pybullet", "dart", "rapier", "pymunk", "pybullet-restitution")

#: A limit is wrong if its error exceeds this multiple of the error that the engine states, plus an error for rounding.
HONEST, ROUNDING = 3.0, 1e-9

#: Speed of the first ball in m/s: below 0.1 m/s DART drops restitution.
SPEED = 20.0

SETTINGS = Settings(convergence=Convergence(), max_steps=100_000)


def draw_chains(n: int, seed: int) -> list[Collision]:
    """Return random chains whose first ball strikes other balls that do not touch each other."""
    rng, chains = np.random.default_rng(seed), []
    for i in range(n):
        balls, table = int(rng.integers(2, 5)), bool(rng.integers(2))
        contacts = balls - 1 + table
        masses, gaps = np.exp(rng.uniform(-1.2, 1.2, balls)), 10 ** rng.uniform(-3.7, -2.2, contacts)
        restitutions = rng.uniform(0.5, 1, contacts) if i % 2 else np.ones(contacts)
        velocities = (-SPEED, *[0.0] * (balls - 1))
        numbers = tuple(masses.tolist()), (1e8,) * contacts, tuple(restitutions.tolist()), velocities
        chains.append(Collision(*numbers, table, tuple(gaps.tolist())))
    return chains


def judge(outcome: Outcome, exact: Outcome) -> tuple[str, float, float]:
    """Return a limit's status with the verdict, its distance from exact, and its stated error, both in m/s."""
    numbers = outcome.diagnostics
    limit = [numbers.get(f"v{i}_limit", np.nan) for i in range(1, len(exact.velocities) + 1)]
    off, stated = (
        float(np.abs(np.subtract(limit, exact.velocities)).max()),
        numbers.get("limit_error", np.nan),
    )
    status = f"{outcome.status}{', marked' if outcome.marked else ''}"
    if np.isnan(off):
        return f"{status}, without a limit", off, stated
    if outcome.status == "ok":
        return f"{status}, {'wrong' if off > HONEST * stated + ROUNDING else 'right'}", off, stated
    return f"{status}, {'right' if off <= 1e-3 * SPEED else 'not right'}", off, stated


def main() -> None:
    """Print the numbers of limits of each kind for each engine."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--chains", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--engine", action="append", choices=ENGINES)
    parser.add_argument("--show", action="store_true", help="print every chain that is not `ok` and right")
    options = parser.parse_args()
    chains = draw_chains(options.chains, options.seed)
    for name in options.engine or ENGINES:
        engine = get_solver(name)
        law = "newton-restitution" if kind_of(name) == "rigid" else "kelvin-voigt"
        found: Counter[str] = Counter()
        worst = 0.0
        for chain in chains:
            (outcome,) = engine.solve_many([chain], SETTINGS)
            (exact,) = get_solver(law).solve_many([chain], Settings())
            kind, off, stated = judge(outcome, exact)
            found[kind] += 1
            if outcome.status == "ok" and not outcome.marked:
                worst = max(worst, off)
            if options.show and kind != "ok, right":
                print(f"  {kind}: off {off:.1e}, stated {stated:.1e}; {outcome.reason} {chain}", flush=True)
        text = "; ".join(f"{n} {kind}" for kind, n in sorted(found.items()))
        print(f"{name}: {text}; furthest ok and unmarked {worst:.1e}", flush=True)


if __name__ == "__main__":
    main()
