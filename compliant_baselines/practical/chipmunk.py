"""Pymunk (Chipmunk): discs on a segment in the plane, impulses iterated contact by contact.

What it does with restitution (cpArbiter.c, cpSpaceStep.c): elasticities are multiplied; the bounce of a contact is
that of the rate at which its bodies approach in the first step in which they overlap. A contact of gap 0 is not there
yet. The impulses of all contacts are found by `iterations` sweeps (10 by default) in the order of the contacts, each
of them from what the others left: sequential impacts if the sweeps are few, all at once if they are many. The slop of
0.1 m that it lets bodies overlap by default is meant for pixels; it only concerns positions here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from impact_xval.compliant_baselines.practical.dart import no_factors
from impact_xval.compliant_baselines.practical.mixing import factors
from impact_xval.compliant_baselines.practical.practice import RADIUS, Arrangement, Practice
from impact_xval.model.columns.column import Column

#: Half the length of the table, in m.
TABLE = 10.0


class Chipmunk(Practice):
    """Pymunk with a number of iterations."""

    engine = "Chipmunk"
    distribution = "pymunk"
    module = "pymunk"
    default_step = 1 / 60

    def __init__(self, name: str = "pymunk", iterations: int = 10) -> None:
        self.name = name
        self.settings = f"{iterations} iterations; elasticities multiply; discs in the plane"
        self._iterations = iterations

    def load(self) -> object:
        """Import it."""
        return import_module("pymunk")

    def refuses(self, column: Column) -> str | None:
        """Products of what two bodies have cannot be any coefficients."""
        return no_factors(column)

    @contextmanager
    def world(self, column: Column, arrangement: Arrangement) -> Iterator[_World]:
        """Make the column."""
        yield _World(column, arrangement, self._iterations)


class _World:
    def __init__(self, column: Column, arrangement: Arrangement, iterations: int) -> None:
        pymunk: Any = import_module("pymunk")
        self._step = arrangement.step
        self._space = pymunk.Space()
        self._space.iterations = iterations
        bounces = factors(column.restitutions) or ()
        heights = arrangement.heights(column)
        self._balls: dict[int, Any] = {}
        for i in arrangement.order(column):
            if i == len(column.masses):
                ends = (-TABLE, arrangement.floor()), (TABLE, arrangement.floor())
                shape = pymunk.Segment(self._space.static_body, *ends, 0.0)
                self._space.add(shape)
            else:
                mass = column.masses[i]
                body = pymunk.Body(mass, pymunk.moment_for_circle(mass, 0.0, RADIUS))
                body.position, body.velocity = (0.0, heights[i]), (0.0, column.velocities[i])
                shape = pymunk.Circle(body, RADIUS)
                self._space.add(body, shape)
                self._balls[i] = body
            shape.elasticity, shape.friction = bounces[i], 0.0

    def step(self) -> None:
        self._space.step(self._step)

    def velocities(self) -> Sequence[float]:
        return [self._balls[i].velocity.y for i in range(len(self._balls))]
