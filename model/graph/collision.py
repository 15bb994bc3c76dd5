"""Collisions of bodies that touch in any number of contacts, described by bodies and contacts.

`GraphCollision` describes such a collision. `touching_balls` finds the contacts between balls, and between balls and
planes.

Used by `graph.named`, by `graph.solving`, which solves such collisions, and by users.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from numbers import Integral

import numpy as np

from impact_xval.model.arrays import Floats
from impact_xval.model.graph.record import MOST_CONTACTS
from impact_xval.model.inputs import LINE, Legal

_MASSES, _STIFFNESSES, _RESTITUTIONS, _VELOCITIES, _ = LINE
_INERTIAS = Legal("inertias", _MASSES.low, math.inf, "numbers > 0 (kg m^2; inf: the body does not turn)")
_TURNS = Legal("angular_velocities", _VELOCITIES.low, _VELOCITIES.high, "finite numbers (rad/s)")
_LENGTHS = Legal("", _VELOCITIES.low, _VELOCITIES.high, "finite numbers (m)")
_RADII = Legal("radii", _MASSES.low, _MASSES.high, "finite numbers > 0 (m)")

#: Largest gap or overlap at which two balls are taken to touch, as a share of the sum of their radii. It allows for the
#: rounding of positions.
TOUCHING = 1e-9

#: Largest difference between the length of a given normal and 1. A normal within it is scaled to length 1; any other
#: normal is refused.
UNIT = 1e-9


@dataclass(frozen=True, slots=True)
class BodyContact:
    """Contact between two bodies, or between a body and a fixed body such as a wall.

    Parameters
    ----------
    bodies : tuple of int and (int or None)
        Numbers of the two bodies, from 1; None stands for a fixed body.
    normal : sequence of float, length 2 or 3
        Unit vector that points from the second body into the first. The contact force pushes the first body along it.
    stiffness : float
        Stiffness in N/m; positive, finite.
    restitution : float
        Coefficient of energetic restitution, from 0 (perfectly plastic) to 1 (elastic).
    arms : tuple of two sequences of float, or empty
        Vectors from each body's centre of mass to the contact, in m; empty if the normal passes through both centres.
    """

    bodies: tuple[int, int | None]
    normal: tuple[float, ...]
    stiffness: float
    restitution: float
    arms: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True, slots=True)
class GraphCollision:
    """Bodies that meet at once, in a plane or in space, without friction.

    Parameters
    ----------
    masses : sequence of float, one per body
        Masses in kg; positive, finite.
    velocities : sequence of sequences of float
        Velocity of each body's centre of mass at first touch, in m/s: (x, z) in a plane, (x, y, z) in space.
    contacts : sequence of BodyContact
        From 1 to `MOST_CONTACTS` contacts. The bodies of at least one contact have to approach.
    inertias : sequence, one per body, or empty
        Moments of inertia about the centre of mass, in kg m^2. A body in a plane has one number; a body in space has
        three principal moments, along the coordinate axes. The moment of a body that cannot turn is infinite. Empty if
        no body can turn.
    angular_velocities : sequence, one per body, or empty
        Angular velocities at first touch, in rad/s. A body in a plane has one number, positive from x to z; a body in
        space has three numbers. Empty if no body turns at first touch.

    Raises
    ------
    ValueError
        For an illegal value; the message names the field, the value and the legal range.

    Examples
    --------
    A ball falls into a corner of two walls at right angles:

    >>> walls = [BodyContact((1, None), (0, 1), 1.0, 0.9), BodyContact((1, None), (1, 0), 1.0, 0.7)]
    >>> corner = GraphCollision([1.0], [(-1.0, -0.3)], walls)
    >>> [round(v, 12) for v in solve_graph_collision(corner).velocities[0]]
    [0.7, 0.27]
    """

    masses: Sequence[float]
    velocities: Sequence[Sequence[float]]
    contacts: Sequence[BodyContact]
    inertias: Sequence[float | Sequence[float]] = ()
    angular_velocities: Sequence[float | Sequence[float]] = ()

    def __post_init__(self) -> None:
        masses = _vector(_MASSES, self.masses)
        bodies = len(masses)
        if not bodies or len(self.velocities) != bodies:
            raise ValueError(
                f"velocities: {len(self.velocities)} of them; legal: {bodies}, one per mass, at least 1"
            )
        velocities = tuple(
            _vector(_VELOCITIES._replace(name=f"velocities[{body}]"), v)
            for body, v in enumerate(self.velocities, 1)
        )
        dimension = len(velocities[0])
        if dimension not in (2, 3) or any(len(v) != dimension for v in velocities):
            raise ValueError(
                f"velocities: {[len(v) for v in velocities]} numbers; legal: 2 of each body (x, z), or 3 (x, y, z)"
            )
        turns = 1 if dimension == 2 else 3
        object.__setattr__(self, "masses", masses)
        object.__setattr__(self, "velocities", velocities)
        for legal in (_INERTIAS, _TURNS):
            rows = getattr(self, legal.name)
            if len(rows) not in (0, bodies):
                raise ValueError(f"{legal.name}: {len(rows)} of them; legal: {bodies}, one per body, or none")
            numbers = tuple(_turning(legal, body, row, turns) for body, row in enumerate(rows, 1))
            object.__setattr__(self, legal.name, numbers)
        if not 1 <= len(self.contacts) <= MOST_CONTACTS:
            raise ValueError(f"contacts: {len(self.contacts)} of them; legal: from 1 to {MOST_CONTACTS}")
        contacts = tuple(
            _checked_contact(f"contacts[{i}]", contact, bodies, dimension)
            for i, contact in enumerate(self.contacts, 1)
        )
        object.__setattr__(self, "contacts", contacts)
        if not (self.rates > 0).any():
            raise ValueError(
                f"velocities = {velocities!r}: nothing meets; legal: the bodies of some contact approach"
            )

    @property
    def jacobian(self) -> Floats:
        """Matrix J, shape (C, D), that gives the rates of compression w = -J v of the C contacts.

        v holds the velocities of all bodies in D directions of motion, one body after another: first its directions of
        translation, then its directions of rotation.
        """
        dimension, turns = self._directions
        rows = np.zeros((len(self.contacts), len(self.masses) * (dimension + turns)))
        for row, contact in zip(rows, self.contacts, strict=True):
            for place, body in enumerate(contact.bodies):
                if body is None:
                    continue
                sign, start = (1.0, -1.0)[place], (body - 1) * (dimension + turns)
                normal = np.array(contact.normal)
                row[start : start + dimension] += sign * normal
                if contact.arms:
                    row[start + dimension : start + dimension + turns] += sign * _torque(
                        contact.arms[place], normal
                    )
        return rows

    @property
    def inverse_masses(self) -> Floats:
        """Diagonal of the inverse mass matrix M^-1, shape (D,): inverse masses and inverse moments of inertia.

        The entry is 0 for a rotation that a body cannot make.
        """
        dimension, turns = self._directions
        parts: list[float] = []
        for body, mass in enumerate(self.masses):
            parts += [1 / mass] * dimension
            moments = np.ravel(self.inertias[body]) if len(self.inertias) else np.full(turns, math.inf)
            parts += [float(1 / moment) for moment in moments]
        return np.array(parts)

    @property
    def delassus(self) -> Floats:
        """Delassus matrix W = J M^-1 J^T of the C contacts, in 1/kg, shape (C, C)."""
        J = self.jacobian
        return (J * self.inverse_masses) @ J.T

    @property
    def rates(self) -> Floats:
        """Rates of compression w = -J v of all contacts at first touch, in m/s, shape (C,)."""
        J = self.jacobian
        terms = -J * self._all_velocities
        rates = terms.sum(axis=1)
        # Bodies with equal velocities do not approach. A small rate from rounding of the sum is set to 0.
        return np.where(np.abs(rates) <= 2.0**-48 * np.abs(terms).sum(axis=1), 0.0, rates)

    @property
    def _directions(self) -> tuple[int, int]:
        """Number of directions in which a body can move, and number of axes about which it can turn."""
        dimension = len(self.velocities[0])
        return dimension, 1 if dimension == 2 else 3

    @property
    def _all_velocities(self) -> Floats:
        """Velocities and angular velocities of all bodies at first touch, body after body; shape (D,)."""
        dimension, turns = self._directions
        rows = np.zeros((len(self.masses), dimension + turns))
        rows[:, :dimension] = self.velocities
        if len(self.angular_velocities):
            rows[:, dimension:] = np.reshape(self.angular_velocities, (-1, turns))
        return rows.ravel()

    def after(self, impulses: Sequence[float]) -> tuple[Floats, Floats]:
        """Return the velocities and the angular velocities of the B bodies after the contacts gave these impulses.

        Velocities have the shape (B, 2) in a plane or (B, 3) in space; angular velocities have (B, 1) or (B, 3).
        """
        dimension, turns = self._directions
        new = self._all_velocities + self.inverse_masses * (self.jacobian.T @ np.asarray(impulses, float))
        rows = new.reshape(-1, dimension + turns)
        return rows[:, :dimension], rows[:, dimension:]


@dataclass(frozen=True, slots=True)
class Plane:
    """A fixed half space. Its surface consists of the points x whose scalar product with `normal` is `offset`.

    Parameters
    ----------
    normal : sequence of float, length 2 or 3
        Unit vector that points out of the half space.
    offset : float
        Distance of the surface from the origin along `normal`, in m.
    """

    normal: tuple[float, ...]
    offset: float = 0.0


def touching_balls(
    positions: Sequence[Sequence[float]],
    radii: Sequence[float],
    planes: Sequence[Plane] = (),
) -> list[tuple[tuple[int, int | None], tuple[float, ...]]]:
    """Find the contacts of balls, and return the bodies and the unit normal of each contact.

    Parameters
    ----------
    positions : sequence of sequences of float
        Positions of the centres, in m.
    radii : sequence of float
        Radii in m; positive, finite.
    planes : sequence of Plane

    Returns
    -------
    list of tuple
        Values for the fields `bodies` and `normal` of `BodyContact`. The contacts between two balls come first, in the
        order of the balls' numbers; then come the contacts with each plane. Two balls touch if the gap between them is
        at most the share `TOUCHING` of the sum of their radii.

    Raises
    ------
    ValueError
        For balls that overlap each other or a plane, and for illegal numbers.
    """
    sizes = _vector(_RADII, radii)
    if len(positions) != len(sizes):
        raise ValueError(f"positions: {len(positions)} of them; legal: {len(sizes)}, one per radius")
    centres = [
        np.array(_vector(_LENGTHS._replace(name=f"positions[{ball}]"), centre))
        for ball, centre in enumerate(positions, 1)
    ]
    contacts: list[tuple[tuple[int, int | None], tuple[float, ...]]] = []
    for i, j in combinations(range(len(sizes)), 2):
        apart = centres[i] - centres[j]
        distance, reach = float(np.linalg.norm(apart)), sizes[i] + sizes[j]
        if distance < reach * (1 - TOUCHING):
            raise ValueError(
                f"positions[{i + 1}] and positions[{j + 1}]: balls overlap at a distance of {distance!r}; legal: at "
                f"least the sum of their radii, {reach!r} (m)"
            )
        if distance <= reach * (1 + TOUCHING):
            contacts.append(((i + 1, j + 1), tuple((apart / distance).tolist())))
    for number, plane in enumerate(planes, 1):
        normal = _unit(f"planes[{number}].normal", plane.normal, len(centres[0]))
        for ball, (centre, radius) in enumerate(zip(centres, sizes, strict=True), 1):
            distance = float(centre @ np.array(normal)) - plane.offset
            if distance < radius * (1 - TOUCHING):
                raise ValueError(
                    f"positions[{ball}]: the ball overlaps plane {number} at a distance of {distance!r}; legal: at "
                    f"least its radius, {radius!r} (m)"
                )
            if distance <= radius * (1 + TOUCHING):
                contacts.append(((ball, None), normal))
    return contacts


def _torque(arm: Sequence[float], force: Floats) -> Floats:
    """Return the torque of a force that acts at the end of an arm; a torque in a plane is positive from x to z."""
    r = np.array(arm, float)
    if len(r) == 2:
        return np.array([r[0] * force[1] - r[1] * force[0]])
    return np.cross(r, force)


def _vector(legal: Legal, values: Sequence[float]) -> tuple[float, ...]:
    """Check numbers against a legal range, and return them as floats.

    A ValueError names the place of the first illegal number, counted from 1.
    """
    return tuple(legal._replace(name=f"{legal.name}[{i}]").number(value) for i, value in enumerate(values, 1))


def _turning(legal: Legal, body: int, row: float | Sequence[float], turns: int) -> float | tuple[float, ...]:
    """Check the moments of inertia, or the angular velocities, of one body, and return them.

    `turns` is 1 in a plane, where `row` is one number, and 3 in space, where `row` has three numbers.
    """
    named = legal._replace(name=f"{legal.name}[{body}]")
    if turns == 1:
        return named.number(row)
    if not isinstance(row, Sequence) or len(row) != 3:
        raise ValueError(f"{named.name} = {row!r}; legal: three {legal.text}")
    return _vector(named, row)


def _unit(name: str, normal: Sequence[float], dimension: int) -> tuple[float, ...]:
    """Return a normal, scaled to length 1; a ValueError names a normal whose length is not 1 within `UNIT`."""
    numbers = _vector(_LENGTHS._replace(name=name, text="finite numbers"), normal)
    length = math.hypot(*numbers)
    if len(numbers) != dimension or not abs(length - 1) <= UNIT:
        raise ValueError(
            f"{name} = {numbers!r}, of length {length!r}; legal: {dimension} numbers, of length 1"
        )
    return tuple(number / length for number in numbers)


def _is_number_of(body: object, bodies: int) -> bool:
    """Return whether an object is an integer from 1 to the number of bodies."""
    return not isinstance(body, bool) and isinstance(body, Integral) and 1 <= int(body) <= bodies


def _checked_contact(name: str, contact: BodyContact, bodies: int, dimension: int) -> BodyContact:
    """Check all fields of a contact, and return the contact with its values as floats."""
    first, second = contact.bodies
    if not _is_number_of(first, bodies) or not (second is None or _is_number_of(second, bodies)):
        raise ValueError(
            f"{name}.bodies = {contact.bodies!r}; legal: numbers from 1 to {bodies}, the second one or None (fixed)"
        )
    if first == second:
        raise ValueError(
            f"{name}.bodies = {contact.bodies!r}: a contact of a body with itself; legal: two bodies"
        )
    arms = contact.arms
    if len(arms) not in (0, 2):
        raise ValueError(f"{name}.arms: {len(arms)} of them; legal: 2, or none")
    for place, arm in enumerate(arms, 1):
        numbers = _vector(_LENGTHS._replace(name=f"{name}.arms[{place}]"), arm)
        if len(numbers) != dimension:
            raise ValueError(f"{name}.arms[{place}] = {numbers!r}; legal: {dimension} numbers (m)")
    return BodyContact(
        (first, second),
        _unit(f"{name}.normal", contact.normal, dimension),
        _STIFFNESSES._replace(name=f"{name}.stiffness").number(contact.stiffness),
        _RESTITUTIONS._replace(name=f"{name}.restitution").number(contact.restitution),
        tuple(tuple(float(number) for number in arm) for arm in arms),
    )
