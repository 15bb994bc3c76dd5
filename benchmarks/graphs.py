"""Time contact graphs of 4 contacts against chains of 4 contacts, both by the model.

Run as ``python -m benchmarks.graphs``. The same chains are solved by the kernel of chains, and as graphs by the kernel
of graphs. Then come random graphs with dense Delassus matrices, a third of them singular. Times are the best of several
repetitions, and contain no compilation. With ``--windows`` the script measures the time of a window for several numbers
of contacts.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from rich.console import Console

from benchmarks.state_transition import best_time, machine
from impact_xval.model import Collisions, solve_many
from impact_xval.model.arrays import Floats
from impact_xval.model.graph.solving import solve_graphs, window_work

CONTACTS = 4


def random_chains(rng: np.random.Generator, count: int) -> Collisions:
    """Draw rows of `CONTACTS` + 1 balls, of which the first strikes the others."""
    velocities = np.zeros((count, CONTACTS + 1))
    velocities[:, 0] = -1
    return Collisions(
        masses=10 ** rng.uniform(-0.5, 0.5, velocities.shape),
        stiffnesses=10 ** rng.uniform(-1, 1, (count, CONTACTS)),
        restitutions=rng.uniform(0.5, 1, (count, CONTACTS)),
        velocities=velocities,
        table=False,
        gaps=np.zeros((count, CONTACTS)),
    )


def delassus_of(chains: Collisions) -> Floats:
    """Return the Delassus matrices of the contacts of rows of balls (docs/glossary.md)."""
    J = np.eye(CONTACTS, CONTACTS + 1) - np.eye(CONTACTS, CONTACTS + 1, 1)
    return (J / chains.masses[:, None, :]) @ J.T


def random_graphs(
    rng: np.random.Generator, count: int, contacts: int = CONTACTS
) -> tuple[Floats, Floats, Floats, Floats]:
    """Draw W = J J^T of J with random entries, stiffnesses, restitutions and rates; all contacts can open together.

    The number of directions of motion is from one below the number of contacts to one above it.
    """
    directions = contacts + 1
    J = rng.normal(size=(count, contacts, directions))
    kept = rng.integers(contacts - 1, directions + 1, count)
    J *= np.arange(directions) < kept[:, None, None]
    opening = rng.normal(size=(count, directions, 1))
    J *= np.sign(J @ opening)
    rates = -(J @ rng.normal(size=(count, directions, 1)))[..., 0]
    rates *= np.where(rates.max(axis=1, keepdims=True) > 0, 1.0, -1.0)
    return (
        J @ np.swapaxes(J, 1, 2),
        10 ** rng.uniform(-1, 1, (count, contacts)),
        rng.uniform(0.5, 1, (count, contacts)),
        rates,
    )


def compare(console: Console, options: argparse.Namespace) -> None:
    rng = np.random.default_rng(options.seed)
    chains = random_chains(rng, options.count)
    laid = delassus_of(chains), chains.stiffnesses, chains.restitutions, chains.compression_rates
    graphs = random_graphs(rng, options.count)
    outcomes = solve_graphs(*graphs)
    for name, values in (("chains laid as graphs", solve_graphs(*laid)), ("random graphs", outcomes)):
        console.print(
            f"{name}: {values.n_events.mean():.1f} events, {values.has_result.mean():.2%} with a result",
            highlight=False,
        )
    seconds = {
        "chains": best_time(lambda: solve_many(chains), options.repeats),
        "chains laid as graphs": best_time(lambda: solve_graphs(*laid), options.repeats),
        "random graphs": best_time(lambda: solve_graphs(*graphs), options.repeats),
    }
    for name, time in seconds.items():
        ratio = time / seconds["chains"]
        console.print(f"{options.count} {name}: {time:.3f} s, {ratio:.2f} times the chains", highlight=False)


def windows(console: Console, options: argparse.Namespace) -> None:
    rng = np.random.default_rng(options.seed)
    for contacts in (2, 4, 8, 16, 32, 60):
        graphs = random_graphs(rng, max(2, 2000 // contacts**2), contacts)
        outcomes = solve_graphs(*graphs)
        time = best_time(lambda graphs=graphs: solve_graphs(*graphs), options.repeats)
        window = 1e9 * time / outcomes.n_windows.sum()
        console.print(
            f"{contacts} contacts: {window:.0f} ns a window, {window / window_work(contacts):.0f} ns a unit of work, "
            f"{outcomes.n_windows.mean():.0f} windows",
            highlight=False,
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=10_000, help="(default: %(default)s)")
    parser.add_argument(
        "--repeats",
        type=int,
        default=3,
        help="repetitions, of which the fastest counts (default: %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")
    parser.add_argument(
        "--windows", action="store_true", help="time windows by the number of contacts instead"
    )
    options = parser.parse_args()
    console = Console(width=max(110, Console().width))
    console.print(machine(), highlight=False)
    if options.windows:
        windows(console, options)
    else:
        compare(console, options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
