"""Random graphs, and chains laid as graphs."""

import numpy as np

from impact_xval.model.graph.collision import BodyContact, GraphCollision


def random_graph(rng, *, least=0.5, singular=False, fixed=True):
    """Draw bodies in a plane, up to 8, and contacts, up to 12; `singular` has more contacts than directions of motion."""
    while True:
        bodies = int(rng.integers(1, 5) if singular else rng.integers(2, 9))
        turns = bool(rng.integers(2))
        directions = bodies * (3 if turns else 2)
        most = min(12, directions + 3)
        contacts = int(rng.integers(directions + 1, most + 1)) if singular and directions < 12 else int(rng.integers(1, 13))
        if (contacts > directions) != singular:
            continue
        rows = [_random_contact(rng, bodies, turns, least, fixed) for _ in range(contacts)]
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
        except ValueError:  # nothing meets
            continue


def _random_contact(rng, bodies, turns, least, fixed):
    first = int(rng.integers(1, bodies + 1))
    second = int(rng.integers(1, bodies + 1))
    is_fixed = second == first or bool(fixed and rng.integers(4) == 0)
    if second == first and not fixed:
        second = first % bodies + 1
        is_fixed = False
    angle = rng.uniform(0, 2 * np.pi)
    arms = tuple(tuple(arm) for arm in rng.uniform(-1, 1, (2, 2))) if turns else ()
    return BodyContact(
        (first, None if is_fixed else second),
        (np.cos(angle), np.sin(angle)),
        10 ** rng.uniform(-1, 1),
        rng.uniform(least, 1),
        arms,
    )


def random_graphs(seed, count, **given):
    """Draw graphs, a quarter of them with a singular W."""
    rng = np.random.default_rng(seed)
    return [random_graph(rng, singular=i % 4 == 3, **given) for i in range(count)]


def chain_as_graph(chain, angle=0.7):
    """Lay a chain along a line in the plane: ball 1 is its upper end."""
    up = np.array([np.sin(angle), np.cos(angle)])
    balls = len(chain.masses)
    contacts = [
        BodyContact((i, i + 1 if i < balls else None), tuple(up), k, e)
        for i, (k, e) in enumerate(zip(chain.stiffnesses, chain.restitutions, strict=True), 1)
    ]
    return GraphCollision(chain.masses, [tuple(v * up) for v in chain.velocities], contacts)
