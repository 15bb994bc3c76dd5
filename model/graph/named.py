"""Well-known collisions of several bodies, by name: `bernoulli`, `corner`, `bridge`, `rack` and `box`.

All of them lie in a plane with the axes x and z; z points up. Each function returns a `GraphCollision`. Unless its
docstring says otherwise, masses are 1 kg, the stiffness k1 of contact 1 is 1 N/m, and bodies strike with 1 m/s.
`graph_of_balls` builds a collision from the positions of balls and planes. To add a collision, write a function in
this module and a line in `GRAPHS`.

Used by users, and by the commands through `GRAPHS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from impact_xval.model.graph.collision import BodyContact, GraphCollision, Plane, touching_balls
from impact_xval.model.inputs import Legal

#: Legal angles in degrees. Below 30 degrees the two equal balls that the third ball strikes would overlap.
_BETWEEN_BALLS = Legal("angle", 30.0, math.nextafter(90.0, 0.0), "from 30 to less than 90 degrees")
_BETWEEN_WALLS = Legal(
    "angle", math.ulp(0.0), math.nextafter(180.0, 0.0), "more than 0 and less than 180 degrees"
)
_RATIO = Legal("stiffness_ratio", math.ulp(0.0), 1e150, "a finite number > 0 (k2/k1)")
_POSITIVE = Legal("", math.ulp(0.0), 1e150, "a finite number > 0")

#: Legal numbers of balls in a rack, not counting the cue ball.
RACKS = (3, 6, 10)


def graph_of_balls(
    positions: Sequence[Sequence[float]],
    masses: Sequence[float],
    velocities: Sequence[Sequence[float]],
    stiffness: Callable[[int, int | None], float],
    restitution: Callable[[int, int | None], float],
    *,
    radius: float = 0.5,
    planes: Sequence[Plane] = (),
) -> GraphCollision:
    """Find the contacts of equal balls with each other and with planes, and return the collision.

    `stiffness` and `restitution` are functions that return the value for one contact. Their arguments are the numbers
    of its two bodies, counted from 1; None stands for a plane.
    """
    contacts = [
        BodyContact(bodies, normal, stiffness(*bodies), restitution(*bodies))
        for bodies, normal in touching_balls(positions, [radius] * len(positions), planes)
    ]
    return GraphCollision(masses, velocities, contacts)


def bernoulli(
    angle: float = 30.0, *, stiffness_ratio: float = 1.0, restitution: float = 1.0
) -> GraphCollision:
    """Return Bernoulli's problem: a ball falls between two balls at rest, and strikes both at once.

    Parameters
    ----------
    angle : float
        Angle in degrees, from 30 to less than 90, between the direction of fall and the line from the centre of the
        falling ball to the centre of a ball at rest. At 30 degrees the two balls at rest also touch each other, in
        contact 3 with the stiffness k1.
    stiffness_ratio : float
        k2/k1. The falling ball is ball 1. It meets ball 2, at x < 0, in contact 1, and ball 3 in contact 2.
    restitution : float
        Coefficient of restitution of all contacts.

    Raises
    ------
    ValueError
        For an illegal value.
    """
    across, down = _direction(_BETWEEN_BALLS.number(angle))
    ratio = _RATIO.number(stiffness_ratio)
    return graph_of_balls(
        [(0.0, 0.0), (-across, -down), (across, -down)],
        (1.0, 1.0, 1.0),
        [(0.0, -1.0), (0.0, 0.0), (0.0, 0.0)],
        lambda first, second: ratio if (first, second) == (1, 3) else 1.0,
        lambda first, second: restitution,
    )


def corner(
    angle: float = 90.0,
    *,
    stiffness_ratio: float = 1.0,
    restitutions: tuple[float, float] = (1.0, 1.0),
    velocity: tuple[float, float] = (-1.0, -0.3),
) -> GraphCollision:
    """Return a ball that strikes two walls at once.

    Parameters
    ----------
    angle : float
        Angle between the normals of the walls, in degrees, more than 0 and less than 180. Wall 1 has the normal
        (0, 1), and wall 2 has the normal (sin angle, cos angle).
    stiffness_ratio : float
        k2/k1: stiffness of the contact with wall 2 over the stiffness of the contact with wall 1.
    restitutions : tuple of float
        Coefficients of restitution of wall 1 and wall 2.
    velocity : tuple of float
        Velocity of the ball, in m/s.

    Raises
    ------
    ValueError
        For an illegal value.
    """
    second = _direction(_BETWEEN_WALLS.number(angle))
    ratio = _RATIO.number(stiffness_ratio)
    walls = (
        BodyContact((1, None), (0.0, 1.0), 1.0, restitutions[0]),
        BodyContact((1, None), second, ratio, restitutions[1]),
    )
    return GraphCollision((1.0,), (velocity,), walls)


def bridge(
    angle: float = 30.0,
    *,
    table_stiffness_ratio: float = 3.0,
    mass_ratio: float = 2.0,
    restitutions: tuple[float, float] = (0.9, 0.7),
) -> GraphCollision:
    """Return a ball that falls between two balls on a table, and strikes both at once.

    Parameters
    ----------
    angle : float
        Angle in degrees, from 30 to less than 90, between the direction of fall and the line from the centre of the
        falling ball to the centre of a ball at rest. At 30 degrees the two balls at rest also touch each other.
    table_stiffness_ratio : float
        Stiffness of the contacts with the table over the stiffness of all other contacts.
    mass_ratio : float
        Mass of each ball on the table over the mass of the falling ball.
    restitutions : tuple of float
        Coefficients of restitution: first of the contacts between balls, then of the contacts with the table.

    Raises
    ------
    ValueError
        For an illegal value.
    """
    across, down = _direction(_BETWEEN_BALLS.number(angle))
    ratio = _RATIO._replace(name="table_stiffness_ratio").number(table_stiffness_ratio)
    mass = _POSITIVE._replace(name="mass_ratio").number(mass_ratio)
    return graph_of_balls(
        [(0.0, 0.5 + down), (-across, 0.5), (across, 0.5)],
        (1.0, mass, mass),
        [(0.0, -1.0), (0.0, 0.0), (0.0, 0.0)],
        lambda _, second: ratio if second is None else 1.0,
        lambda _, second: restitutions[1] if second is None else restitutions[0],
        planes=[Plane((0.0, 1.0))],
    )


def rack(balls: int = 3, *, restitution: float = 0.95, offset: float = 0.0) -> GraphCollision:
    """Return a cue ball that strikes a rack of balls. The rows of the rack have 1, 2, 3, ... balls, along x.

    Parameters
    ----------
    balls : int
        Number of balls in the rack: 3, 6 or 10. Ball 1 is the cue ball, and ball 2 is the first ball of the rack.
    restitution : float
        Coefficient of restitution of all contacts.
    offset : float
        Angle in degrees, between -90 and 90, between the cue ball's velocity and x, the axis of the rack. It does not
        change where the cue ball touches the first ball, which is on the axis.

    Raises
    ------
    ValueError
        For an illegal value.
    """
    if balls not in RACKS:
        raise ValueError(f"balls = {balls!r}; legal: {', '.join(map(str, RACKS[:-1]))} or {RACKS[-1]}")
    across, along = _direction(
        Legal(
            "offset", -math.nextafter(90.0, 0.0), math.nextafter(90.0, 0.0), "between -90 and 90 degrees"
        ).number(offset)
    )
    places = [(math.sqrt(0.75) * row, place - row / 2) for row in range(4) for place in range(row + 1)]
    return graph_of_balls(
        [(-1.0, 0.0), *places[:balls]],
        (1.0,) * (balls + 1),
        [(along, across), *[(0.0, 0.0)] * balls],
        lambda first, second: 1.0,
        lambda first, second: restitution,
    )


def box(
    inertia: float = 1 / 3,
    *,
    stiffness_ratio: float = 1.0,
    restitution: float = 0.8,
    half_width: float = 1.0,
) -> GraphCollision:
    """Return a box that lands flat on two corners.

    Parameters
    ----------
    inertia : float
        Moment of inertia about the centre of mass, divided by m a^2 with the mass m and the half width a; positive. It
        is 1/3 for a thin plate. If it is 1, the impact at one corner does not change the velocity of the other corner.
    stiffness_ratio : float
        k2/k1. Corner 1 is at x = a, and corner 2 is at x = -a.
    restitution : float
        Coefficient of restitution of both corners.
    half_width : float
        Half width a of the box, in m; positive.

    Raises
    ------
    ValueError
        For an illegal value.
    """
    moment = _POSITIVE._replace(name="inertia").number(inertia)
    a = _POSITIVE._replace(name="half_width").number(half_width)
    stiffnesses = (1.0, _RATIO.number(stiffness_ratio))
    corners = [
        BodyContact((1, None), (0.0, 1.0), k, restitution, ((x, -a), (0.0, 0.0)))
        for x, k in zip((a, -a), stiffnesses, strict=True)
    ]
    return GraphCollision((1.0,), [(0.0, -1.0)], corners, inertias=(moment * a * a,))


def _direction(degrees: float) -> tuple[float, float]:
    """Return the sine and the cosine of an angle in degrees."""
    return math.sin(math.radians(degrees)), math.cos(math.radians(degrees))


#: Functions that return a collision, by the name under which the commands offer it.
GRAPHS: dict[str, Callable[..., GraphCollision]] = {
    "bernoulli": bernoulli,
    "corner": corner,
    "bridge": bridge,
    "rack": rack,
    "box": box,
}
