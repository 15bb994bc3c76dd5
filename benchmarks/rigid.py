"""Distances of rigid engines from exact rigid laws, which show the law that an engine follows.

    python -m benchmarks.rigid [--chains 200]

Random chains have 2 to 5 balls that all touch, with or without a table, and masses from 0.3 to 3 kg. Each contact
approaches at 1 to 20 m/s, or rests. e is from 0.3 to 1; in every second chain all contacts have the same e. D is the
kinetic norm of the difference of final velocities, over the kinetic norm of the initial velocities. A law with one e
for all contacts solves half of the chains. A second table has the collisions that docs/scoreboard.md quotes.
"""

from __future__ import annotations

import argparse

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.answers import answer
from impact_xval.compliant_baselines.registry import kind_of, solver_names
from impact_xval.compliant_baselines.rigid.laws import LAWS
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision
from impact_xval.model.status import RESULT_STATUSES

ENGINES = [name for name in solver_names(on_request=True) if kind_of(name) == "rigid"]
STEP = Settings(step_fraction=1e-3)


def line(*velocities: float, e: float = 1.0, gap: float = 0.0, table: bool = False) -> Collision:
    """Return a collision of equal balls in a line, with ball 1 on top, from their velocities in m/s."""
    n = len(velocities)
    contacts = n - 1 + table
    return Collision((1.0,) * n, (1.0,) * contacts, (e,) * contacts, velocities, table, (gap,) * contacts)


def drawn(n: int) -> list[Collision]:
    """Return n random chains in which the bodies of at least one contact approach each other."""
    rng, found = np.random.default_rng(1), []
    while len(found) < n:
        balls, table = int(rng.integers(2, 6)), bool(rng.integers(2))
        contacts = balls - 1 + table
        e = rng.uniform(0.3, 1, contacts if len(found) % 2 else 1) * np.ones(contacts)
        # Rates of approach by contact from the bottom, up to the top; half of the contacts rest.
        rates = np.where(rng.random(contacts) < 0.5, 0.0, rng.uniform(1, 20, contacts))
        v = -np.cumsum([*([] if table else [0.0]), *rates])[::-1]
        masses = tuple(np.exp(rng.uniform(-1.2, 1.2, balls)).tolist())
        if rates.any():
            found.append(Collision(masses, (1.0,) * contacts, tuple(e.tolist()), tuple(v.tolist()), table))
    return found


def distances(name: str, law: str, collisions: list[Collision]) -> np.ndarray:
    """Return D between an engine and a law; NaN if the engine or the law has no result."""
    theirs, exact = (list(answer(get_solver(each), collisions, STEP)) for each in (name, law))
    found = []
    for c, a, b in zip(collisions, theirs, exact, strict=True):
        there = a.status in RESULT_STATUSES and b.status in RESULT_STATUSES
        m = np.array(c.masses)
        off = np.subtract(a.velocities, b.velocities) if there else np.full(len(m), np.nan)
        found.append(np.sqrt(m @ off**2 / (m @ np.square(c.velocities))))
    return np.array(found)


def main() -> None:
    """Print the distances of every engine from every law, and the velocities of some collisions."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--chains", type=int, default=200)
    chains = drawn(parser.parse_args().chains)
    engines = [name for name in ENGINES if not get_solver(name).unavailable()]
    print("D to law, median / largest".ljust(28), *(name.rjust(26) for name in engines))
    for law in LAWS:
        found = [distances(name, law, chains) for name in engines]
        cells = (f"{np.nanmedian(d):.1e} / {np.nanmax(d):.1e} ({np.isfinite(d).sum()})" for d in found)
        print(law.ljust(28), *(cell.rjust(26) for cell in cells))
    cases = {
        "one contact, e = 0.5": line(-1.0, 0.0, e=0.5),
        "basic": Collision.two_balls(1.0, 2.0, 1.0, 1.0, 1.0, 1.0),
        "1 on 4": line(-1.0, 0.0, 0.0, 0.0, 0.0),
        "1 on 2, touching": line(-1.0, 0.0, 0.0),
        "1 on 2, 1e-3 radii apart": line(-1.0, 0.0, 0.0, gap=1e-3 * 4),  # rigid.lines makes radii of 4 m
    }
    for title, c in cases.items():
        print(title)
        for name in (*LAWS, *engines):
            (o,) = answer(get_solver(name), [c], STEP)
            print("  ", name.ljust(26), *(f"{v:9.5f}" for v in o.velocities), o.reason)


if __name__ == "__main__":
    main()
