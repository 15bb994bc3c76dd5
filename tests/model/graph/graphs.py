"""Helpers that make random contact graphs, and chains written as graphs."""

import numpy as np

from impact_xval.model.graph.collision import BodyContact, GraphCollision


def random_graph(rng, *, least=0.5, singular=False, fixed=True):
    """Draw a graph of up to 8 bodies in a plane with up to 12 contacts.

    With `singular` there are more contacts than directions of motion, so that the Delassus matrix W is singular. The
    normals are drawn so that some motion opens all contacts at once. Without such a motion the bodies would be jammed.
    """
    while True:
        bodies = int(rng.integers(1 if fixed else 2, 5) if singular else rng.integers(2, 9))
        turns = bool(rng.integers(2))
        directions = bodies * (3 if turns else 2)
        contacts = (
            directions + int(rng.integers(1, 4))
            if singular
            else int(rng.integers(1, min(12, directions) + 1))
        )
        if contacts > 12:
            continue
        opening = rng.normal(size=(bodies, 2)), rng.normal(size=bodies)
        rows = [_random_contact(rng, opening, turns, least, fixed) for _ in range(contacts)]
        moving = rng.integers(2, size=bodies)
        moving[rng.integers(bodies)] = 1
        try:
            return GraphCollision(
                10 ** rng.uniform(-0.5, 0.5, bodies),
                [tuple(v) for v in rng.normal(size=(bodies, 2)) * moving[:, None]],
                rows,
                inertias=tuple(10 ** rng.uniform(-1, 0, bodies)) if turns else (),
                angular_velocities=tuple(rng.normal(size=bodies) * moving) if turns else (),
            )
        except ValueError:  # no bodies approach: draw again
            continue


def _random_contact(rng, opening, turns, least, fixed):
    """Draw a contact that the given velocities and spins open."""
    velocities, spins = opening
    bodies = len(spins)
    first, second = (int(body) for body in rng.integers(bodies, size=2))
    if not fixed:
        second = (first + 1 + int(rng.integers(bodies - 1))) % bodies
    is_fixed = second == first or bool(fixed and rng.integers(4) == 0)
    angle = rng.uniform(0, 2 * np.pi)
    normal, arms = np.array([np.cos(angle), np.sin(angle)]), rng.uniform(-1, 1, (2, 2)) * turns
    parts = [
        velocities[body] + spins[body] * np.array([-r[1], r[0]])
        for body, r in zip((first, second), arms, strict=True)
    ]
    if normal @ (parts[0] - (0 if is_fixed else parts[1])) < 0:
        normal = -normal
    return BodyContact(
        (first + 1, None if is_fixed else second + 1),
        tuple(normal.tolist()),
        10 ** rng.uniform(-1, 1),
        rng.uniform(least, 1),
        tuple(tuple(arm) for arm in arms.tolist()) if turns else (),
    )


def random_graphs(seed, count, **given):
    """Draw `count` graphs, every fourth of them with a singular Delassus matrix W."""
    rng = np.random.default_rng(seed)
    return [random_graph(rng, singular=i % 4 == 3, **given) for i in range(count)]


def chain_as_graph(chain, angle=0.7):
    """Return a chain as a graph: its balls on a line in the plane, tilted by `angle`, with ball 1 at the upper end."""
    up = np.array([np.sin(angle), np.cos(angle)])
    balls = len(chain.masses)
    contacts = [
        BodyContact((i, i + 1 if i < balls else None), tuple(up), k, e)
        for i, (k, e) in enumerate(zip(chain.stiffnesses, chain.restitutions, strict=True), 1)
    ]
    return GraphCollision(chain.masses, [tuple(v * up) for v in chain.velocities], contacts)
