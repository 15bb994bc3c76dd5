"""The slowest approach that rebounds in each rigid engine with its defaults.

    python -m benchmarks.thresholds [ENGINE ...]

A ball of 1 kg meets a fixed body with e = 0.4. The speed at which the rebound exceeds half of e is found by bisection,
between 1 mm/s and 3 m/s.
"""

from __future__ import annotations

import sys

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision

ENGINES = ("pybullet:default", "dart:default", "rapier:default", "sapien:default", "pymunk")
RESTITUTION, SLOWEST, FASTEST = 0.4, 1e-3, 3.0


def rebound(engine: str, speed: float) -> float:
    """Return the speed after the impact over the speed before; NaN if the engine has no result."""
    ball = Collision((1.0,), (1e6,), (RESTITUTION,), (-speed,), table=True)
    (outcome,) = get_solver(engine).solve_many([ball], Settings())
    return float(outcome.velocities[0]) / speed


def slowest_rebound(engine: str) -> float:
    """Return the slowest speed in m/s that rebounds, to 1 %; `SLOWEST` if all speeds rebound."""
    if rebound(engine, SLOWEST) > RESTITUTION / 2:
        return SLOWEST
    below, above = SLOWEST, FASTEST
    while above > 1.01 * below:
        middle = float(np.sqrt(below * above))
        if rebound(engine, middle) > RESTITUTION / 2:
            above = middle
        else:
            below = middle
    return above


def main() -> None:
    """Print the slowest approach that rebounds, and the rebound at 0.95, 1.05 and 2 times this speed."""
    for engine in sys.argv[1:] or ENGINES:
        missing = get_solver(engine).unavailable()
        if missing is not None:
            print(f"{engine}: {missing}")
            continue
        speed = slowest_rebound(engine)
        after = ", ".join(f"{rebound(engine, factor * speed):.3f}" for factor in (0.95, 1.05, 2.0))
        words = "rebounds at any speed" if speed == SLOWEST else f"rebounds from {speed:.3g} m/s on"
        print(f"{engine}: {words}; at 0.95, 1.05, 2 times that: {after} of the approach, e = {RESTITUTION:g}")


if __name__ == "__main__":
    main()
