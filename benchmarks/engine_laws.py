"""Contacts of engines compared with the contacts asked for, and with exact laws.

    python -m benchmarks.engine_laws contact --engine lammps exudyn
    python -m benchmarks.engine_laws law --engine lammps lammps:limit-damping --chains 60 --pairs 60
    python -m benchmarks.engine_laws cradle --engine newton mujoco

``contact`` lets a ball of 1 kg meet a ball of 3 kg, and a ball of 1 kg meet the table, with e = 0.5, 0.8 and 1 at three
speeds. It prints the restitution that results.

``law`` draws pairs on a table, and chains of three to six balls. For an engine with a law it prints the distances of
the limits dt -> 0 from the exact solver, and the numbers of limits that are further off than once and three times their
stated error. An engine without a law is compared with every exact law. D is the kinetic norm of the difference of final
velocities, over the kinetic norm of the velocities before.

``cradle`` lets the first of three and of five equal balls strike the others, which touch or are 1 mm apart.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.chains import random_chain
from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.compliant_baselines.answers import answer
from impact_xval.compliant_baselines.registry import exact_law_names, law_name_of
from impact_xval.compliant_baselines.solver import Convergence
from impact_xval.model import Collision
from impact_xval.model.kinetic import kinetic_norm
from impact_xval.model.outcome import Outcome
from impact_xval.model.status import RESULT_STATUSES

RESTITUTIONS, SPEEDS = (0.5, 0.8, 1.0), (0.1, 1.0, 10.0)

#: Stiffness of the contact in N/m, in the test of a single contact.
STIFFNESS = 1e6


def contact(names: Sequence[str], step: float) -> None:
    """Print the restitution asked for and the restitution that results, for one contact."""
    print(
        "engine".ljust(24), "bodies".ljust(12), "m/s".rjust(5), *(f"e = {e}".rjust(10) for e in RESTITUTIONS)
    )
    for name in names:
        solver = get_solver(name)
        for bodies in ("1 kg, 3 kg", "1 kg, table"):
            for speed in SPEEDS:
                given = []
                for e in RESTITUTIONS:
                    if bodies == "1 kg, 3 kg":
                        c = Collision((1.0, 3.0), (STIFFNESS,), (e,), (-speed, 0.0), table=False)
                    else:
                        # A second ball flies away above, so that the lower one meets the table alone.
                        velocities = (speed, -speed)
                        c = Collision(
                            (1.0, 1.0), (STIFFNESS,) * 2, (e, e), velocities, True, (0.1 * speed, 0.0)
                        )
                    (o,) = answer(solver, [c], Settings(step_fraction=step))
                    parted = o.velocities[0] - o.velocities[1] if not c.table else o.velocities[1]
                    has_result = o.status in RESULT_STATUSES
                    given.append(f"{parted / speed:.5f}" if has_result else o.status)
                print(name.ljust(24), bodies.ljust(12), f"{speed:5g}", *(text.rjust(10) for text in given))


def draw(pairs: int, chains: int, seed: int) -> dict[str, list[Collision]]:
    """Draw pairs on a table, and chains of three to six balls, every second of them with gaps."""
    rng = np.random.default_rng(seed)
    drawn_pairs = [
        Collision.two_balls(
            1.0, 10 ** rng.uniform(-1, 1), 1.0, 10 ** rng.uniform(-2, 2), *rng.uniform(0.3, 1, 2)
        )
        for _ in range(pairs)
    ]
    drawn_chains = []
    for i in range(chains):
        chain = random_chain(rng, int(rng.integers(3, 7)))
        n = len(chain.stiffnesses)
        gaps = tuple(10 ** rng.uniform(-3, 0, n) * rng.integers(2, size=n)) if i % 2 else (0.0,) * n
        drawn_chains.append(replace(chain, gaps=gaps))
    return {"pairs": drawn_pairs, "chains": drawn_chains}


def distance(c: Collision, a: Sequence[float], b: Sequence[float]) -> float:
    """Return D, the kinetic norm of a difference of final velocities over that of the velocities before."""
    return float(kinetic_norm(c.masses, np.subtract(a, b)) / kinetic_norm(c.masses, c.velocities))


def law(names: Sequence[str], options: argparse.Namespace) -> None:
    """Print the distances of engines from exact laws."""
    drawn = draw(options.pairs, options.chains, options.seed)
    for name in names:
        solver, exact = get_solver(name), law_name_of(name)
        settings = Settings(
            step_fraction=options.step,
            convergence=Convergence() if exact else None,
            max_steps=options.max_steps,
        )
        for what, collisions in drawn.items():
            start = time.perf_counter()
            outcomes = list(answer(solver, collisions, settings))
            spent = (time.perf_counter() - start) / len(collisions)
            n_ok = sum(outcome.status == "ok" for outcome in outcomes)
            print(f"{name}: {n_ok} of {len(collisions)} {what} are ok, {spent:.2f} s each")
            reasons = {f"  {o.status}: {o.reason[:150]}" for o in outcomes if o.status != "ok"}
            print(*sorted(reasons)[:4], sep="\n", end="\n" if reasons else "")
            if exact:
                _print_limits(outcomes, list(answer(get_solver(exact), collisions, settings)), exact)
            else:
                _print_distances(outcomes, collisions, settings)


def _print_limits(outcomes: Sequence[Outcome], exact: Sequence[Outcome], law: str) -> None:
    """Print the distances of limits from the exact law, and the numbers of limits beyond their stated errors."""
    off, stated = [], []
    for ours, theirs in zip(outcomes, exact, strict=True):
        balls = range(1, len(theirs.velocities) + 1)
        limit = [ours.diagnostics.get(f"v{ball}_limit", math.nan) for ball in balls]
        off.append(np.abs(np.subtract(limit, theirs.velocities)).max())
        stated.append(ours.diagnostics.get("limit_error", math.nan))
    ratio = np.array(off) / np.array(stated)
    is_ok = np.array([outcome.status == "ok" for outcome in outcomes])
    for title, rows in (("all", np.isfinite(ratio)), ("ok", is_ok & np.isfinite(ratio))):
        if rows.any():
            print(
                f"  {title}: {rows.sum()} limits; from {law} at most {np.array(off)[rows].max():.1e} |v0|, "
                f"{(ratio[rows] > 1).sum()} beyond the stated error, {(ratio[rows] > 3).sum()} beyond three times"
            )


def _print_distances(
    outcomes: Sequence[Outcome], collisions: Sequence[Collision], settings: Settings
) -> None:
    """Print D from every exact law, the nearest first."""
    rows = []
    for exact in exact_law_names():
        theirs = answer(get_solver(exact), collisions, settings)
        d = [
            distance(c, o.velocities, t.velocities)
            for c, o, t in zip(collisions, outcomes, theirs, strict=True)
            if o.status in RESULT_STATUSES and t.status in RESULT_STATUSES
        ]
        if d:
            rows.append((float(np.median(d)), max(d), len(d), exact))
    for median, largest, n, exact in sorted(rows)[:4]:
        print(f"  {exact}: D {median:.2g} in the median, {largest:.2g} at most, of {n}")


def cradle(names: Sequence[str], step: float) -> None:
    """Print the velocities after a cradle, over the speed of the striker, downwards positive."""
    for gap in (0.0, 1e-3):
        for balls in (3, 5):
            contacts = balls - 1
            c = Collision(
                (1.0,) * balls, (1e8,) * contacts, (1.0,) * contacts, (-1.0, *[0.0] * contacts), False,
                (0.0, *[gap] * (contacts - 1)),
            )  # fmt: skip
            print(f"{balls} balls, {gap * 1e3:g} mm apart")
            for name in names:
                (o,) = answer(get_solver(name), [c], Settings(step_fraction=step))
                print(" ", name.ljust(24), *(f"{-v:8.4f}" for v in o.velocities), o.status, o.reason[:90])


def main() -> None:
    """Print the tables that the options ask for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("contact", "law", "cradle"))
    parser.add_argument("--engine", nargs="+", required=True)
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--chains", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--step", type=float, default=1e-3, help="step over the shortest period")
    parser.add_argument("--max-steps", type=int, default=200_000)
    options = parser.parse_args()
    for name in options.engine:
        print(name, get_solver(name).version(), get_solver(name).unavailable() or "")
    if options.what == "law":
        law(options.engine, options)
    else:
        {"contact": contact, "cradle": cradle}[options.what](options.engine, options.step)


if __name__ == "__main__":
    main()
