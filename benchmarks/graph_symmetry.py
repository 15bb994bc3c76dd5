"""Measure how far engines break the symmetry of symmetric impacts: ``python -m benchmarks.graph_symmetry NAME ...``.

The scenes are `bernoulli` and `bridge` at 30, 45 and 60 degrees, `corner` at 60, 90 and 120 degrees with a ball that
moves along the bisector, and `rack` with 3 and 6 balls. Each scene is solved with the restitutions e = 1, 0.7 and 0.5.
The asymmetry of an answer is the largest difference between a velocity and the mirrored velocity of the body's mirror
image, over |v0|.

Each scene is also solved with its bodies in other orders, and with its contacts in other orders. There are two other
orders: the reversed order, and the order that begins with the second number and ends with the first. The script prints
the largest change of a velocity in all scenes, over |v0|: once for orders of bodies, and once for orders of contacts.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_xval.compliant_baselines.registry import get_solver
from impact_xval.compliant_baselines.solver import Settings, Solver
from impact_xval.experiments.config.graphs import GRAPH_SPECS
from impact_xval.model.arrays import Floats
from impact_xval.model.graph import GraphCollision, corner
from tests.compliant_baselines.plane_graphs import renumbered, with_stiffness

RESTITUTIONS = (1.0, 0.7, 0.5)

#: Stiffness of the contacts in N/m. It is so large that balls move little while they collide.
STIFFNESS = 1e8


class SymmetricScene(NamedTuple):
    """A symmetric collision at 1 m/s, and its axis of symmetry."""

    name: str
    collision: GraphCollision
    #: Unit vector (x, z) along the axis of symmetry.
    along: tuple[float, float]
    #: For each body the number of its mirror image, counted from 0.
    images: Sequence[int]


class Symmetry(NamedTuple):
    """Measurements of one solver in all symmetric scenes. Differences of velocities are divided by |v0|."""

    #: Largest asymmetry for each name of a graph. Graphs without an answer are missing.
    asymmetries: dict[str, float]
    #: Largest change of a velocity if the bodies are in other orders, and if the contacts are.
    by_bodies: float
    by_contacts: float
    #: Number of scenes without an answer.
    refused: int


def symmetric_scenes() -> list[SymmetricScene]:
    """Return all scenes that the module's docstring lists, with all restitutions."""
    scenes: list[SymmetricScene] = []
    for e in RESTITUTIONS:
        for name in ("bernoulli", "bridge", "rack"):
            spec = GRAPH_SPECS[name]
            for number in spec.angles or (3.0, 6.0):
                numbers = {
                    "angle": number,
                    "balls": number,
                    "stiffness_ratio": 1.0,
                    "mass_ratio": 2.0,
                    "e": e,
                }
                mirror = spec.mirror(numbers)
                assert mirror is not None
                along = (0.0, 1.0) if mirror.coordinate == 0 else (1.0, 0.0)
                scenes.append(SymmetricScene(name, spec.make(numbers), along, mirror.images))
        for angle in (60.0, 90.0, 120.0):
            half = math.radians(angle) / 2
            along = math.sin(half), math.cos(half)
            ball = corner(angle, restitutions=(e, e), velocity=(-along[0], -along[1]))
            scenes.append(SymmetricScene("corner", ball, along, (0,)))
    return [
        scene._replace(
            collision=with_stiffness(scene.collision, STIFFNESS / scene.collision.contacts[0].stiffness)
        )
        for scene in scenes
    ]


def asymmetry(scene: SymmetricScene, velocities: Floats) -> float:
    """Return the largest difference in m/s between a velocity and the mirrored velocity of the body's mirror image."""
    along = np.array(scene.along)
    images = velocities[list(scene.images)]
    mirrored = 2 * np.outer(images @ along, along) - images
    return float(np.abs(velocities - mirrored).max())


def other_orders(count: int) -> list[list[int]]:
    """Return the orders of `count` numbers in which a scene is solved again.

    They are the reversed order, and the ascending order that begins with the second number and ends with the first.
    Orders that are equal to the ascending order or to each other are left out.
    """
    numbers = list(range(count))
    orders = [numbers[::-1], [*numbers[1:], *numbers[:1]]]
    return [order for place, order in enumerate(orders) if order != numbers and order not in orders[:place]]


def measure_symmetry(solver: Solver, scenes: Sequence[SymmetricScene], settings: Settings) -> Symmetry:
    """Let a solver answer all scenes in all orders, and return the largest asymmetries and changes of velocities."""

    def velocities_of(collisions: Sequence[GraphCollision]) -> list[Floats]:
        return [np.array(outcome.velocities, float) for outcome in solver.solve_graphs(collisions, settings)]

    asymmetries: dict[str, float] = {}
    by_bodies = by_contacts = 0.0
    refused = 0
    answers = velocities_of([scene.collision for scene in scenes])
    for scene, velocities in zip(scenes, answers, strict=True):
        if not np.isfinite(velocities).all():
            refused += 1
            continue
        asymmetries[scene.name] = max(asymmetries.get(scene.name, 0.0), asymmetry(scene, velocities))
        same_bodies, same_contacts = (
            list(range(len(things))) for things in (scene.collision.masses, scene.collision.contacts)
        )
        orders = other_orders(len(same_bodies))
        changed = [renumbered(scene.collision, order, same_contacts) for order in orders]
        for order, moved in zip(orders, velocities_of(changed), strict=True):
            by_bodies = max(by_bodies, float(np.abs(moved - velocities[order]).max()))
        changed = [
            renumbered(scene.collision, same_bodies, order) for order in other_orders(len(same_contacts))
        ]
        for moved in velocities_of(changed):
            by_contacts = max(by_contacts, float(np.abs(moved - velocities).max()))
    return Symmetry(asymmetries, by_bodies, by_contacts, refused)


def main() -> None:
    """Print a table with one row for each solver that the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("solvers", nargs="+", metavar="NAME")
    options = parser.parse_args()
    scenes, console = symmetric_scenes(), Console(width=118)
    names = list(dict.fromkeys(scene.name for scene in scenes))
    table = Table("solver", *names, "bodies renumbered", "contacts renumbered", "refused")
    for name in options.solvers:
        found = measure_symmetry(get_solver(name), scenes, replace(Settings(), max_steps=100_000))
        row = [found.asymmetries.get(scene, math.nan) for scene in names]
        table.add_row(
            name,
            *(f"{x:.1e}" for x in (*row, found.by_bodies, found.by_contacts)),
            f"{found.refused} of {len(scenes)}",
        )
    console.print(table)


if __name__ == "__main__":
    main()
