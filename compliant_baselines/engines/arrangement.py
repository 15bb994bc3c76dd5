"""Arrangements: which bodies of a scene touch, in which directions, and where equal balls lie that touch in this way.

Bodies move along one axis (in a line, upwards) or along two axes (in a plane, x and z, with z upwards). Lengths are in
radii of the balls.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from impact_xval.model.arrays import Floats

if TYPE_CHECKING:
    from impact_xval.model.graph.collision import GraphCollision

#: Largest error, in radii, of the distance between the centres of two balls that touch. It allows for rounded normals.
FITTING = 1e-9

#: Overlap at the start, in radii, of bodies that touch, in a scene in a plane. It is larger than the rounding of
#: positions, so that the engine finds each touching contact in its first step.
ROUNDING_OVERLAP = 2.0**-48


class Touch(NamedTuple):
    """Contact of two bodies, or of a body with a fixed plane that belongs to this contact alone."""

    #: Numbers of the two bodies, from 0; None stands for a fixed plane.
    first: int
    second: int | None
    #: Unit vector from the second body into the first, one number for each axis.
    normal: tuple[float, ...]


@dataclass(frozen=True)
class Arrangement:
    """Places of equal balls that touch each other and fixed planes, with their contacts."""

    #: Centres of the balls in radii when all contacts just touch without overlap, one number for each axis.
    centres: tuple[tuple[float, ...], ...]
    touches: tuple[Touch, ...]

    @property
    def axes(self) -> int:
        """Number of axes along which bodies move: 1 in a line, 2 in a plane."""
        return len(self.centres[0])

    @cached_property
    def jacobian(self) -> Floats:
        """Matrix J, shape (C, N axes), with which the rates of compression are -J v.

        The velocities v are ordered by body, and for each body by axis.
        """
        rows = np.zeros((len(self.touches), len(self.centres), self.axes))
        for row, touch in zip(rows, self.touches, strict=True):
            row[touch.first] += touch.normal
            if touch.second is not None:
                row[touch.second] -= touch.normal
        return rows.reshape(len(self.touches), -1)

    @property
    def has_fixed_body(self) -> bool:
        """Return True if a ball touches a plane."""
        return any(touch.second is None for touch in self.touches)

    def surface(self, contact: int) -> Floats:
        """Return the point, in radii, at which a ball touches the plane of a contact; shape (axes,)."""
        touch = self.touches[contact]
        return np.subtract(self.centres[touch.first], touch.normal)

    def sides(self, body: int) -> tuple[list[int], list[int]]:
        """Return the contacts in which a body is the first one, and the contacts in which it is the second one."""
        return (
            [i for i, touch in enumerate(self.touches) if touch.first == body],
            [i for i, touch in enumerate(self.touches) if touch.second == body],
        )


@lru_cache
def line_of_balls(balls: int, table: bool) -> Arrangement:
    """Return the arrangement of balls in a line, ball 1 on top.

    `table` says if there is a table below the last ball.
    """
    centres = tuple((float(height),) for height in range(2 * balls - 1, 0, -2))
    touches = [Touch(upper, upper + 1, (1.0,)) for upper in range(balls - 1)]
    return Arrangement(centres, (*touches, *([Touch(balls - 1, None, (1.0,))] if table else [])))


def arrangement_of_graph(collision: GraphCollision) -> Arrangement | str:
    """Return the arrangement of equal balls for a contact graph; or a sentence that says why there is none."""
    axes = len(collision.velocities[0])
    if axes != 2:
        return "the bodies move in space: engines run contact graphs in a plane; legal: velocities (x, z)"
    turning = any(contact.arms for contact in collision.contacts)
    if turning or any(collision.angular_velocities):
        return "contacts with arms: engines run balls, which do not turn; legal: contacts without arms"
    touches = tuple(
        Touch(first - 1, None if second is None else second - 1, contact.normal)
        for contact in collision.contacts
        for first, second in [contact.bodies]
    )
    pairs = [tuple(sorted((touch.first, touch.second))) for touch in touches if touch.second is not None]
    if len(set(pairs)) < len(pairs):
        return "two contacts of the same two bodies: balls touch in one point"
    centres = np.zeros((len(collision.masses), axes))
    between = [touch for touch in touches if touch.second is not None]
    if between:
        # One equation for each contact: the difference of the centres is two radii along the normal.
        differences = np.zeros((len(between), len(centres)))
        for row, touch in zip(differences, between, strict=True):
            row[touch.first], row[touch.second] = 1.0, -1.0
        wanted = 2 * np.array([touch.normal for touch in between])
        centres = np.linalg.lstsq(differences, wanted, rcond=None)[0]
        missed = np.linalg.norm(differences @ centres - wanted, axis=1)
        if missed.max() > FITTING * len(between):
            contact = touches.index(between[int(missed.argmax())]) + 1
            return (
                f"no equal balls touch with these normals: contact {contact} misses by {missed.max():.2g} radii; "
                "legal: normals that close every ring of contacts"
            )
    return Arrangement(tuple(map(tuple, centres.tolist())), touches)


def in_space(coordinates: Floats, axes: int) -> Floats:
    """Return coordinates along the axes, shape (..., N axes), as points in space (x, y, z), shape (..., N, 3)."""
    points = np.reshape(coordinates, (*np.shape(coordinates)[:-1], -1, axes))
    space = np.zeros((*points.shape[:-1], 3))
    space[..., SPACE_AXES[axes]] = points
    return space


def along_axes(points: Floats, axes: int) -> Floats:
    """Return points in space, shape (..., N, 3), as coordinates along the axes, shape (..., N axes)."""
    coordinates = np.asarray(points)[..., SPACE_AXES[axes]]
    return coordinates.reshape(*coordinates.shape[:-2], -1)


#: The axes along which bodies move in a line and in a plane, as positions in (x, y, z).
SPACE_AXES: dict[int, list[int]] = {1: [2], 2: [0, 2]}
