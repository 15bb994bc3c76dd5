"""Contact graphs of balls in a plane for tests and benchmarks: drawn at random, rotated, mirrored and renumbered."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from impact_xval.model.graph import BodyContact, GraphCollision


def random_graph(rng: np.random.Generator, most_contacts: int = 5, most_walls: int = 2) -> GraphCollision:
    """Draw 2 to 4 equal balls that touch in a tree, and up to `most_walls` walls that touch a ball.

    Neither balls nor walls overlap. Stiffnesses are about 1e8 N/m, speeds about 1 m/s, restitutions from 0.4 to 1.
    """
    while True:
        balls, walls = int(rng.integers(2, 5)), int(rng.integers(0, most_walls + 1))
        centres = [np.zeros(2)]
        contacts: list[tuple[int, int | None, tuple[float, ...]]] = []
        while len(centres) < balls:
            neighbour = int(rng.integers(len(centres)))
            normal = unit(rng.uniform(0, 2 * math.pi))
            centre = centres[neighbour] + 2 * normal
            apart = [np.linalg.norm(centre - other) for i, other in enumerate(centres) if i != neighbour]
            if min(apart, default=math.inf) > 2.05:
                centres.append(centre)
                contacts.append((len(centres), neighbour + 1, tuple(normal.tolist())))
        for _ in range(walls):
            ball, normal = int(rng.integers(balls)), unit(rng.uniform(0, 2 * math.pi))
            surface = (centres[ball] - normal) @ normal
            if all(centre @ normal - surface > 1.05 for i, centre in enumerate(centres) if i != ball):
                contacts.append((ball + 1, None, tuple(normal.tolist())))
        if len(contacts) > most_contacts:
            continue
        try:
            return GraphCollision(
                np.exp(rng.uniform(-1, 1, balls)).tolist(),
                [tuple(v) for v in rng.normal(size=(balls, 2)).tolist()],
                [
                    BodyContact((first, second), normal, 10 ** rng.uniform(7.5, 8.5), rng.uniform(0.4, 1))
                    for first, second, normal in contacts
                ],
            )
        except ValueError:  # no bodies approach: draw again
            continue


def unit(angle: float) -> np.ndarray:
    """Return the unit vector at an angle in rad."""
    return np.array([math.cos(angle), math.sin(angle)])


def moved(collision: GraphCollision, move: Callable[[Sequence[float]], Sequence[float]]) -> GraphCollision:
    """Return a collision whose velocities and normals are changed by `move`, a rotation or a mirror."""
    return replace(
        collision,
        velocities=[tuple(move(v)) for v in collision.velocities],
        contacts=[replace(contact, normal=tuple(move(contact.normal))) for contact in collision.contacts],
    )


def renumbered(collision: GraphCollision, bodies: Sequence[int], contacts: Sequence[int]) -> GraphCollision:
    """Return a collision with bodies and contacts in another order.

    Its body i is body `bodies[i]` of the given collision, counted from 0. The order of the contacts changes likewise.
    """
    numbers = {old + 1: new + 1 for new, old in enumerate(bodies)}
    changed: list[BodyContact] = []
    for i in contacts:
        contact = collision.contacts[i]
        first, second = contact.bodies
        changed.append(replace(contact, bodies=(numbers[first], None if second is None else numbers[second])))
    return GraphCollision(
        [collision.masses[i] for i in bodies], [collision.velocities[i] for i in bodies], changed
    )


def with_stiffness(collision: GraphCollision, factor: float) -> GraphCollision:
    """Return a collision whose stiffnesses are multiplied by `factor`."""
    contacts = [replace(contact, stiffness=factor * contact.stiffness) for contact in collision.contacts]
    return replace(collision, contacts=contacts)
