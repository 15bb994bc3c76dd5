"""From what a collision asks of a contact, (k, e), to each engine's own parameters: docs/mapping.md.

The calibrated mapping is the one of that page. The naive one is what a user writes who knows the names of the
parameters but not the engine's source; its damping ratio is the textbook's. MuJoCo has two more: documented, and, like
PyBullet with coefficients of restitution, shipped: nothing is set, and the step is the engine's own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from impact_xval.compliant_baselines.restitution import (
    contact_time,
    damping_ratio,
    restitution,
    textbook_damping_ratio,
)
from impact_xval.compliant_baselines.solver import MappingName

#: MuJoCo's least constraint impedance (mjMINIMP of mjmodel.h): as near as it comes to a contact at the level of forces.
MUJOCO_IMPEDANCE = 1e-4

#: MuJoCo's default solref (time constant in s, damping ratio) and solimp (dmin, dmax, width in m, midpoint, power), of
#: the XML reference.
MUJOCO_DEFAULT_SOLREF = (0.02, 1.0)
MUJOCO_DEFAULT_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)


class Contact(NamedTuple):
    """One Kelvin-Voigt contact, F = max(0, k delta + c delta'): k in N/m, c in N s/m, the pair's reduced mass in kg."""

    k: float
    c: float
    mass: float

    @classmethod
    def from_restitution(
        cls, k: float, e: float, mass: float, mapping: MappingName = "calibrated"
    ) -> Contact:
        """Make the contact of stiffness k that gives restitution e in (0, 1] to a pair of this reduced mass, alone."""
        zeta = textbook_damping_ratio(e) if mapping == "naive" else damping_ratio(e)
        return cls(k, 2 * zeta * math.sqrt(k) * math.sqrt(mass), mass)

    @property
    def omega(self) -> float:
        """Angular frequency sqrt(k/M), in 1/s."""
        return math.sqrt(self.k / self.mass)

    @property
    def period(self) -> float:
        """Period 2 pi sqrt(M/k) of the undamped contact, in s."""
        return 2 * math.pi / self.omega

    @property
    def zeta(self) -> float:
        """Damping ratio."""
        return self.c / (2 * self.mass * self.omega)

    @property
    def duration(self) -> float:
        """How long the contact lasts when the pair is alone and without gravity, in s."""
        return contact_time(self.zeta) / self.omega

    @property
    def restitution(self) -> float:
        """Coefficient of restitution when the pair is alone and without gravity."""
        return restitution(self.zeta)


class MujocoContact(NamedTuple):
    """A contact pair of MuJoCo."""

    #: Direct format, (-stiffness, -damping) in 1/s^2 and 1/s, or positive: time constant in s and damping ratio.
    solref: tuple[float, float]
    #: (dmin, dmax, width, midpoint, power).
    solimp: tuple[float, float, float, float, float]

    @property
    def direct(self) -> tuple[float, float]:
        """The solref in the direct format (the engine's chapter "Solver parameters", "Reference acceleration")."""
        first, second = self.solref
        return self.solref if first <= 0 else (-1 / (first * second) ** 2, -2 / first)

    def stiffness(self, mass: float) -> float:
        """Stiffness in N/m that a pair of this reduced mass, alone, finds in this contact: that of the smallest d.

        Solved for the acceleration, the engine's equations read a = stiffness r (d/dmax)^2 (damping aside).
        """
        dmin, dmax = self.solimp[:2]
        return -self.direct[0] * mass * (dmin / dmax) ** 2

    def rest_penetration(self, acceleration: float) -> float:
        """Penetration in m at which a ball rests on this contact in a field of this acceleration, in m/s^2.

        There stiffness r (d/dmax)^2 = (1 - d) acceleration, with the impedance d a function of r (the engine's
        "Computation" chapter, section "Constraint model").
        """
        dmin, dmax, width, midpoint, power = self.solimp
        stiffness = -self.direct[0]
        if dmin == dmax:
            return (1 - dmin) * acceleration / stiffness
        # d >= dmin: the rest lies above that of a constant impedance dmin.
        low, high = 0.0, 2 * (1 - dmin) * acceleration / (stiffness * (dmin / dmax) ** 2)
        while low < (r := 0.5 * (low + high)) < high:
            x = min(1.0, r / width)
            if x <= midpoint:
                y = x**power / midpoint ** (power - 1)
            else:
                y = 1 - (1 - x) ** power / (1 - midpoint) ** (power - 1)
            d = dmin + y * (dmax - dmin)
            low, high = (r, high) if stiffness * r * (d / dmax) ** 2 < (1 - d) * acceleration else (low, r)
        return high


def mujoco_contact(
    contact: Contact, mapping: MappingName = "calibrated", impedance: float = MUJOCO_IMPEDANCE
) -> MujocoContact:
    """MuJoCo's parameters of one contact.

    Calibrated: a constant impedance d as small as the engine allows, stiffness = k/M and damping = c/M: *exactly* the
    contact asked for as long as the pair is alone, and within d of it when a third body pushes too (docs/mapping.md).
    """
    if mapping == "naive":
        return MujocoContact((-contact.k, -contact.c), MUJOCO_DEFAULT_SOLIMP)
    if mapping == "documented":
        return MujocoContact((1 / (contact.zeta * contact.omega), contact.zeta), MUJOCO_DEFAULT_SOLIMP)
    d = impedance
    return MujocoContact((-contact.k / contact.mass, -contact.c / contact.mass), (d, d, 0.001, 0.5, 1.0))


class Side(NamedTuple):
    """What a body, or a side of it, carries in an engine that combines those of two bodies."""

    #: In N/m: PyBullet's `contactStiffness`, Drake's "point_contact_stiffness".
    stiffness: float
    #: PyBullet's `contactDamping` c in N s/m; "relaxation_time" c/k in s under Drake's `kSap`.
    dissipation: float

    def against(self, other: Side) -> Side:
        """Combine two as the engines do: stiffness in series, dissipation added (btManifoldResult)."""
        stiffness = 1 / (1 / self.stiffness + 1 / other.stiffness)
        return Side(stiffness, self.dissipation + other.dissipation)


#: A side that adds nothing: its stiffness is PyBullet's own for a body that was not given one (BT_LARGE_FLOAT of
#: btScalar.h, double precision), 1/(1/k + 1/1e30) = k.
RIGID = Side(1e30, 0.0)


#: Of a body, what meets the body above and what meets the body below.
Sides = tuple[Side, Side]


def sides(carried: Sequence[Side], mapping: MappingName, *, whole: bool = False) -> list[Sides]:
    """Give every ball, and the table, its part in the contacts, given what each of these is to have.

    The lower side of a ball carries the contact with the body below; all else is rigid and undamped. Of two balls on a
    table whose bodies are `whole`, one side as the other, the upper ball carries contact 1 and the table contact 2.
    So they are in the naive mapping, where both balls carry contact 1.
    """
    if not whole and mapping != "naive":
        return [*((RIGID, side) for side in carried), (RIGID, RIGID)]
    ball, table = carried
    return [(body, body) for body in (ball, ball if mapping == "naive" else RIGID, table)]


def combined(bodies: Sequence[Sequence[Side]]) -> list[Side]:
    """Combine the sides that meet, one pair a contact."""
    return [below.against(above) for (_, below), (above, _) in pairwise(bodies)]


def pybullet_side(contact: Contact) -> Side:
    """PyBullet's parameters of the body that carries a contact."""
    return Side(contact.k, contact.c)


def drake_side(contact: Contact) -> Side:
    """Drake's parameters of the geometry that carries a contact."""
    return Side(contact.k, contact.c / contact.k)
