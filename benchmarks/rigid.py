"""Which exact rigid law each rigid engine follows, and who throws a striker back: the tables of docs/rigid.md.

python benchmarks/rigid.py
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from impact_xval.compliant_baselines import get_solver, solver_names
from impact_xval.compliant_baselines.registry import kind_of
from impact_xval.compliant_baselines.rigid.laws import LAWS
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.measures.divergence import velocity_divergence
from impact_xval.model.collision import RESULT_STATUSES, Collision

ENGINES = tuple(name for name in solver_names(on_request=True) if kind_of(name) == "rigid")
OTHERS = ("state-transition", "bistiffness", "kelvin-voigt", "mujoco", "pybullet")


def line(
    masses: Sequence[float],
    strike: int,
    e: Sequence[float],
    *,
    table: bool = False,
    gap: float = 0.0,
    k: float = 1.0,
) -> Collision:
    """Make a line of balls, the first of which come at 1 m/s."""
    velocities = (-1.0,) * strike + (0.0,) * (len(masses) - strike)
    n = len(masses) - 1 + table
    return Collision(tuple(masses), (k,) * n, tuple(e), velocities, table, (gap,) * n)


CASES = {
    "1 on 2 on the table, e = 1": line((1, 2), 1, (1, 1), table=True),
    "the same, e = 0.9, 0.7": line((1, 2), 1, (0.9, 0.7), table=True),
    "cradle, 1 on 4, e = 1": line((1,) * 5, 1, (1,) * 4),
    "cradle, 2 on 3, e = 0.9": line((1,) * 5, 2, (0.9,) * 4),
    "stack of 3, e = 0.8": line((1,) * 3, 3, (0.8,) * 3, table=True),
}


def nearest(collision: Collision, engine: str) -> str:
    """Write the velocities of an engine, the exact law they are nearest to, and by how much they miss it, as D."""
    (found,) = get_solver(engine).solve_many([collision], Settings())
    if found.status not in RESULT_STATUSES:
        return f"{found.status}: {found.reason}"
    away: dict[str, float] = {}
    for law in LAWS:
        (exact,) = get_solver(law).solve_many([collision], Settings())
        D = velocity_divergence(collision, exact, found)
        if D is not None:
            away[law] = D
    law = min(away, key=lambda name: away[name])
    velocities = ", ".join(f"{v:.3f}" for v in found.velocities)
    return f"({velocities}): {law}, {away[law]:.1g}"


def main() -> None:
    """Print both tables."""
    for title, collision in CASES.items():
        print(title)
        for engine in ENGINES:
            print(f"    {engine:10} {nearest(collision, engine)}")
    chain = {gap: line((1,) * 3, 1, (1,) * 2, gap=gap, k=1e8) for gap in (0.0, 1e-3)}
    print(
        "three equal balls, e = 1, k = 1e8 N/m: velocity of the striker, -1 before; targets that touch, and 1 mm apart"
    )
    for name in (*OTHERS, *LAWS, *ENGINES):
        struck = [get_solver(name).solve_many([c], Settings())[0] for c in chain.values()]
        said = [f"{o.velocities[0]:8.4f}" if np.isfinite(o.velocities).all() else o.status for o in struck]
        print(f"    {name:26} {'  '.join(said)}")


if __name__ == "__main__":
    main()
