"""Chains per second of the model for N balls, the growth of its cost with N, and the cost of an integration in time.

Run as ``python -m benchmarks.chains``. The chains are random: rows without a table, and piles and stacks on a table.
Masses are log-uniform over one decade, stiffnesses log-uniform over two decades, and restitutions uniform in [0.5, 1].
The integration in time is scipy's solve_ivp with events, on the first of the same chains
(tests/model/chain_reference.py). It runs at rtol 1e-12 and 0.1 rad a step, so that it misses few events. With
``--independent COUNT`` the model is compared with the integration on COUNT chains, N from 2 to 10, and nothing is
timed. Times are the best of several repetitions, and contain no compilation.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.state_transition import best_time, machine
from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.model import Collision, solve
from impact_xval.model.solving import LAWS
from tests.model.chain_reference import integrate

#: Names of solvers by the law that they solve.
SOLVERS = dict(zip(LAWS, ("state-transition", "liu-zhao-brogliato"), strict=True))

#: Number of balls, and number of chains with this many balls.
SIZES = {2: 20_000, 5: 4000, 10: 1000, 20: 400, 50: 40, 100: 10}

#: Difference above which an outcome is integrated again at a finer resolution: an event can be missed between the ends
#: of a step.
BOUND, FINER = 1e-8, 0.02


def random_chain(rng: np.random.Generator, balls: int) -> Collision:
    """Return a random chain: a row, a pile or a stack."""
    table = bool(rng.integers(2))
    contacts = balls - 1 + table
    velocities = np.zeros(balls)
    velocities[: balls if table and rng.integers(3) == 0 else 1] = -1
    return Collision(
        tuple(10 ** rng.uniform(-0.5, 0.5, balls)),
        tuple(10 ** rng.uniform(-1, 1, contacts)),
        tuple(rng.uniform(0.5, 1, contacts)),
        tuple(velocities),
        table,
    )


def speed(console: Console, options: argparse.Namespace) -> None:
    for law in LAWS:
        table = Table(
            "balls",
            "chains/s",
            "events",
            "us an event",
            "solve_ivp, chains/s",
            "ratio",
            title=law,
        )
        for balls, count in SIZES.items():
            rng = np.random.default_rng(options.seed)
            chains = [random_chain(rng, balls) for _ in range(count)]
            solver = get_solver(SOLVERS[law])
            events = [outcome.n_events for outcome in solver.solve_many(chains, Settings())]
            spent = best_time(
                lambda solver=solver, chains=chains: solver.solve_many(chains, Settings()), options.repeats
            )
            slow, ratio = "", ""
            if balls <= options.slow:
                some = chains[:10]
                plain = best_time(lambda some=some, law=law: [integrate(c, law) for c in some], 1)
                slow, ratio = f"{len(some) / plain:.2f}", f"{count / spent * plain / len(some):,.0f}"
            table.add_row(
                str(balls),
                f"{count / spent:,.0f}",
                f"{np.mean(events):.0f}",
                f"{1e6 * spent / np.sum(events):.1f}",
                slow,
                ratio,
            )
        console.print(table)


def compare(console: Console, count: int, exponent: float, law: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    worst, again, beyond, compared = 0.0, 0, 0, 0
    for i in range(count):
        chain = replace(random_chain(rng, int(rng.integers(2, 11))), exponent=exponent)
        ours = solve(chain, law=law)
        if "infinitely many" in ours.reason:
            continue
        compared += 1
        difference = _difference(ours.velocities, integrate(chain, law).velocities)
        if difference > BOUND:
            again += 1
            finer = integrate(chain, law, resolution=FINER)
            difference = _difference(ours.velocities, finer.velocities)
        if difference > BOUND:
            beyond += 1
            console.print(f"{i}: {difference:.1e}, grazing margin {ours.grazing_margin:.1e}", highlight=False)
        else:
            worst = max(worst, difference)
    console.print(
        f"{law}, p = {exponent:g}: {compared} of {count} chains end after finitely many events; {beyond} differ "
        f"by more than {BOUND:g}, the others by at most {worst:.1e}; {again} integrated again at {FINER:g} rad a step",
        highlight=False,
    )


def _difference(one, other) -> float:
    return float(np.abs(np.subtract(one, other)).max())


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--repeats",
        type=int,
        default=3,
        help="repetitions, of which the fastest counts (default: %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")
    parser.add_argument("--slow", type=int, default=20, help="largest N of solve_ivp (default: %(default)s)")
    parser.add_argument(
        "--independent",
        type=int,
        default=0,
        metavar="COUNT",
        help="compare this number of chains with the integration instead",
    )
    parser.add_argument(
        "--exponent",
        type=float,
        default=1.0,
        help="exponent of the contacts in the comparison (default: %(default)s)",
    )
    parser.add_argument(
        "--law", choices=list(LAWS), default="jia-mason-erdmann", help="law of the comparison"
    )
    options = parser.parse_args()
    console = Console(width=max(110, Console().width))
    console.print(machine(), highlight=False)
    if options.independent:
        compare(console, options.independent, options.exponent, options.law, options.seed)
    else:
        speed(console, options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
