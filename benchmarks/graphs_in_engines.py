"""Compare engines on contact graphs with exact laws: ``python -m benchmarks.graphs_in_engines --engine NAME``.

The graphs are random trees of balls in a plane; some of the balls touch walls. For an engine with springs and dashpots
the script prints how many of its limits dt -> 0 are right. A limit is right if it differs from the exact motion of the
engine's law by at most three times the error that is stated with the limit.

For a rigid engine the script prints the nearest rigid law for each graph, and the distance of the engine's answer from
this law. The distance is the kinetic norm of the difference of velocities, over the kinetic norm of the velocities at
first touch. Some laws depend on the order in which contacts are treated. They are tried in all orders, and the nearest
order is printed with their name.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from itertools import permutations

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.registry import get_solver
from impact_xval.compliant_baselines.rigid.graphs import GRAPH_LAWS, complementary, solve_rigid_graph
from impact_xval.compliant_baselines.rigid.laws import TooManyImpactsError
from impact_xval.compliant_baselines.solver import Convergence, Settings
from impact_xval.model.arrays import Floats
from impact_xval.model.graph import GraphCollision, GraphCollisionOutcome
from impact_xval.model.kinetic import kinetic_norm
from tests.compliant_baselines.plane_graphs import random_graph

#: Newton's law in which only contacts that approach have a restitution. Let P be the impulse of a contact, and u- and
#: u+ its velocity of separation before and after the impact. Then P >= 0 and u+ + e min(u-, 0) >= 0, and one of the two
#: is 0. The law of `rigid.graphs` differs: a contact that parts before the impact may approach after it, and then has
#: another impact.
APPROACHING = "newton-of-approaching"

#: Newton's law, applied in the steps of an engine: bodies move for one step, and then all contacts whose bodies touch
#: have an impact together.
IN_STEPS = "newton-in-steps"

#: Variant of the law plastic-then-restitution. A contact has its restitution only in the first impact in which it
#: approaches. Later impacts leave out the contacts that have parted.
ONCE = "restitution-once"

#: Largest number of steps of `newton_in_steps`, and largest number of impacts of `restitution_once`.
MOST_STEPS = 4000

#: Laws at a distance of at most this number are taken as equally near. The first of them is then named, because in most
#: graphs several laws agree.
NEAR = 1e-4

#: A law explains an engine's answer if their distance is at most this number.
EXPLAINED = 1e-3

#: Laws whose outcome depends on the order in which contacts are treated.
ORDERED = ("sequential", "plastic-then-restitution")


def distance(collision: GraphCollision, velocities: object, others: object) -> float:
    """Return the kinetic norm of a difference of velocities, over the kinetic norm of the velocities at first touch."""
    masses = np.repeat(collision.masses, 2)
    difference = np.ravel(np.asarray(velocities, float)) - np.ravel(np.asarray(others, float))
    return float(kinetic_norm(masses, difference) / kinetic_norm(masses, np.ravel(collision.velocities)))


def newton_of_approaching(collision: GraphCollision) -> Floats:
    """Return the final velocities in m/s by the law `APPROACHING`.

    Impacts are applied one after another until no contact approaches.
    """
    W, rates = collision.delassus, collision.rates
    e = np.array([contact.restitution for contact in collision.contacts])
    total, scale = np.zeros(len(rates)), float(np.abs(rates).max())
    rounding = 1e-12 * scale
    while (rates > rounding).any():
        total += complementary(W, -rates - e * np.maximum(rates, 0), scale)
        rates = collision.rates - W @ total
        rates[np.abs(rates) <= rounding] = 0.0
    return collision.after(total.tolist())[0]


def newton_in_steps(collision: GraphCollision, step: float, gaps: Floats) -> Floats:
    """Return the final velocities in m/s by the law `IN_STEPS`.

    `step` is the length of a step in s, and `gaps` are the gaps of contacts at the start in m, shape (C,).
    """
    W, rates = collision.delassus, collision.rates
    e = np.array([contact.restitution for contact in collision.contacts])
    total, scale = np.zeros(len(rates)), float(np.abs(rates).max())
    rounding = 1e-9 * scale
    for _ in range(MOST_STEPS):
        gaps = gaps - step * rates
        touching = np.flatnonzero(gaps <= 0)
        if len(touching):
            approach = -(1 + e[touching]) * rates[touching]
            impulses = complementary(W[np.ix_(touching, touching)], approach, scale)
            total[touching] += impulses
            rates = collision.rates - W @ total
        if not (rates > rounding).any():
            break
    return collision.after(total.tolist())[0]


def restitution_once(collision: GraphCollision, order: Sequence[int]) -> Floats:
    """Return the final velocities in m/s by the law `ONCE`.

    `order` has the numbers of all contacts, counted from 1, in the order in which they get their restitution.
    """
    W, rates = collision.delassus, collision.rates
    e = np.array([contact.restitution for contact in collision.contacts])
    total, scale = np.zeros(len(rates)), float(np.abs(rates).max())
    rounding = 1e-7 * scale
    acting, has_approached = np.full(len(rates), True), np.full(len(rates), False)
    for _ in range(MOST_STEPS):
        approaching = rates > rounding
        if not approaching.any():
            break
        impulses = np.zeros(len(rates))
        part = np.ix_(acting, acting)
        impulses[acting] = complementary(W[part], -rates[acting], scale)
        for contact in (number - 1 for number in order):
            if approaching[contact]:
                back = 0.0 if has_approached[contact] and e[contact] < 1 else e[contact]
                excess = (1 + back) * rates[contact] - W[contact] @ impulses
                impulses[contact] = max(impulses[contact] + excess / W[contact, contact], 0.0)
        has_approached |= approaching
        total += impulses
        rates = collision.rates - W @ total
        acting = rates > rounding
    return collision.after(total.tolist())[0]


def nearest_law(
    collision: GraphCollision, outcome: GraphCollisionOutcome, in_steps: Floats | None = None
) -> tuple[float, str]:
    """Return the distance from an engine's outcome to the nearest rigid law, and the name of this law.

    `in_steps` are the final velocities by the law `IN_STEPS`. If they are None, this law is not tried.
    """
    restitutions = [contact.restitution for contact in collision.contacts]
    orders = [*permutations(range(1, len(restitutions) + 1))]
    found: list[tuple[float, str]] = []
    for law in GRAPH_LAWS:
        for order in orders if law in ORDERED else orders[:1]:
            try:
                rigid = solve_rigid_graph(law, collision.delassus, restitutions, collision.rates, order=order)
            except (ValueError, TooManyImpactsError):
                continue
            velocities, _ = collision.after(rigid.impulses.tolist())
            found.append((distance(collision, outcome.velocities, velocities), rigid.law))
    found.insert(1, (distance(collision, outcome.velocities, newton_of_approaching(collision)), APPROACHING))
    if in_steps is not None:
        found.append((distance(collision, outcome.velocities, in_steps), IN_STEPS))
    for order in orders:
        once = distance(collision, outcome.velocities, restitution_once(collision, order))
        found.append((once, f"{ONCE} ({', '.join(map(str, order))})"))
    return min(found, key=lambda law: max(law[0], NEAR))


def compare_compliant(
    engine: Engine, graphs: list[GraphCollision], settings: Settings, console: Console
) -> None:
    """Print the limits of an engine with springs and dashpots, and how many of them are right.

    A limit is right if it is within three stated errors of the exact law.
    """
    outcomes = engine.solve_graphs(graphs, settings)
    exact = get_solver(engine.law or "kelvin-voigt").solve_graphs(graphs, settings)
    table = Table("graph", "contacts", "status", "off, m/s", "stated error", "off/error", "at the step, m/s")
    ratios: list[float] = []
    for number, (graph, outcome, reference) in enumerate(zip(graphs, outcomes, exact, strict=True)):
        row = [str(number), str(len(graph.contacts)), outcome.status]
        if outcome.limit_velocities and reference.has_result:
            off = float(np.abs(np.subtract(outcome.limit_velocities, reference.velocities)).max())
            at_step = float(np.abs(np.subtract(outcome.velocities, reference.velocities)).max())
            error = outcome.diagnostics["limit_error"]
            ratios.append(off / error)
            row += [f"{off:.1e}", f"{error:.1e}", f"{off / error:.2f}", f"{at_step:.1e}"]
        else:
            row += [outcome.reason or reference.reason]
        table.add_row(*row)
    console.print(table)
    within = sum(ratio <= 3 for ratio in ratios)
    worst = max(ratios, default=math.nan)
    console.print(
        f"{engine.name}: {within} of {len(graphs)} limits within three stated errors; {len(ratios)} have a limit; "
        f"the furthest is {worst:.2f} stated errors off"
    )


def compare_rigid(engine: Engine, graphs: list[GraphCollision], settings: Settings, console: Console) -> None:
    """Print the rigid law nearest to the engine's answer to each graph, and how often each law is the nearest."""
    table = Table("graph", "contacts", "status", "nearest law", "distance")
    nearest: dict[str, list[float]] = {}
    without = 0
    with engine.running():
        scenes = [engine.plane_scene_or_refusal(graph, settings) for graph in graphs]
        gaps = [
            None
            if isinstance(scene, str)
            else scene.arrangement.jacobian @ np.ravel(engine.world(scene).heights)
            for graph, scene in zip(graphs, scenes, strict=True)
        ]
    for number, (graph, outcome) in enumerate(
        zip(graphs, engine.solve_graphs(graphs, settings), strict=True)
    ):
        row = [str(number), str(len(graph.contacts)), outcome.status]
        if np.isfinite(outcome.velocities).all():
            gap = gaps[number]
            in_steps = None if gap is None else newton_in_steps(graph, outcome.diagnostics["step"], gap)
            off, law = nearest_law(graph, outcome, in_steps)
            nearest.setdefault(law.partition(" (")[0], []).append(off)
            row += [law, f"{off:.1e}"]
        else:
            row += [outcome.reason]
            without += 1
        table.add_row(*row)
    console.print(table)
    for law, distances in sorted(nearest.items()):
        close = sum(off <= EXPLAINED for off in distances)
        console.print(
            f"{engine.name}: {law} is the nearest to {len(distances)} of {len(graphs)} graphs, within {EXPLAINED:g} "
            f"to {close}; median {np.median(distances):.1e}, largest {max(distances):.1e}"
        )
    unexplained = sum(off > EXPLAINED for distances in nearest.values() for off in distances)
    console.print(f"{engine.name}: no law is within {EXPLAINED:g} of {unexplained} graphs")
    if without:
        console.print(f"{engine.name}: no result for {without}")


def main() -> None:
    """Compare the engine that the command line names with exact laws."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--engine", required=True)
    parser.add_argument("--graphs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--max-steps", type=int, default=100_000)
    parser.add_argument("--step-fraction", type=float, default=Settings().step_fraction)
    options = parser.parse_args()
    rng, engine, console = np.random.default_rng(options.seed), get_solver(options.engine), Console(width=118)
    if not isinstance(engine, Engine):
        parser.error(f"{options.engine} is no engine")
    graphs = [random_graph(rng) for _ in range(options.graphs)]
    settings = Settings(
        convergence=Convergence(), max_steps=options.max_steps, step_fraction=options.step_fraction
    )
    compare = compare_rigid if engine.kind == "rigid" else compare_compliant
    compare(engine, graphs, settings, console)


if __name__ == "__main__":
    main()
