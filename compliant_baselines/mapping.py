"""Mappings of a contact's stiffness and restitution (k, e) to the parameters of each engine (docs/mapping.md).

* ``calibrated``: the parameters that docs/mapping.md derives, with which a lone contact has this k and e
* ``naive``: the parameters that a user writes who knows their names but not the engine's source; the damping ratio is
  the textbook's
* ``documented`` (MuJoCo alone): a time constant and a damping ratio
* ``shipped`` (MuJoCo, and all rigid engines except Pymunk): nothing is set, and the step is the engine's own
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from impact_xval.compliant_baselines.restitution import (
    contact_time,
    damping_ratio,
    restitution,
    textbook_damping_ratio,
)
from impact_xval.compliant_baselines.solver import MappingName

#: MuJoCo's least constraint impedance (mjMINIMP of mjmodel.h). With it a contact comes nearest to a spring and dashpot
#: on the level of forces.
MUJOCO_IMPEDANCE = 1e-4

#: MuJoCo's default solref (time constant in s, damping ratio), of the XML reference.
MUJOCO_DEFAULT_SOLREF = (0.02, 1.0)

#: MuJoCo's default solimp (dmin, dmax, width in m, midpoint, power), of the XML reference.
MUJOCO_DEFAULT_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)


class KelvinVoigtContact(NamedTuple):
    """A contact with a spring and a dashpot, F = max(0, k delta + c delta')."""

    #: Stiffness in N/m.
    k: float
    #: Damping in N s/m.
    c: float
    #: Reduced mass of the two bodies, in kg.
    mass: float

    @classmethod
    def from_restitution(
        cls, k: float, e: float, mass: float, mapping: MappingName = "calibrated"
    ) -> KelvinVoigtContact:
        """Make the contact of stiffness k that gives two lone bodies of this reduced mass restitution e in (0, 1]."""
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
        """Damping ratio c/(2 M omega)."""
        return self.c / (2 * self.mass * self.omega)

    @property
    def duration(self) -> float:
        """Duration in s of the contact of the two bodies alone, without gravity."""
        return contact_time(self.zeta) / self.omega

    @property
    def restitution(self) -> float:
        """Coefficient of restitution of the two bodies alone, without gravity."""
        return restitution(self.zeta)


class MujocoContact(NamedTuple):
    """The parameters of a contact pair of MuJoCo."""

    #: Either the direct format (-stiffness, -damping) in 1/s^2 and 1/s, or two positive numbers: time constant in s and
    #: damping ratio.
    solref: tuple[float, float]
    #: The numbers (dmin, dmax, width in m, midpoint, power).
    solimp: tuple[float, float, float, float, float]

    @property
    def direct(self) -> tuple[float, float]:
        """The solref in direct format (the engine's chapter "Solver parameters", "Reference acceleration")."""
        first, second = self.solref
        return self.solref if first <= 0 else (-1 / (first * second) ** 2, -2 / first)

    def stiffness(self, mass: float) -> float:
        """Return the stiffness in N/m of this contact, at the smallest impedance d, for two bodies alone.

        `mass` is their reduced mass in kg. Without damping, the engine's equations give the acceleration a = stiffness
        r (d/dmax)^2.
        """
        dmin, dmax = self.solimp[:2]
        return -self.direct[0] * mass * (dmin / dmax) ** 2

    def equilibrium_depth(self, acceleration: float) -> float:
        """Return the penetration in m at which a ball rests on this contact under an acceleration in m/s^2.

        At this penetration r, stiffness r (d/dmax)^2 = (1 - d) acceleration. The impedance d is a function of r (the
        engine's "Computation" chapter, section "Constraint model").
        """
        dmin, dmax = self.solimp[:2]
        stiffness = -self.direct[0]
        if dmin == dmax:
            return (1 - dmin) * acceleration / stiffness
        # If the impedance were the least one at every depth, the ball would rest at half of `high`.
        least = min(dmin, dmax)
        low, high = 0.0, 2 * (1 - least) * acceleration / (stiffness * (least / dmax) ** 2)
        while low < (r := 0.5 * (low + high)) < high:
            d = self.impedance(r)
            if stiffness * r * (d / dmax) ** 2 < (1 - d) * acceleration:
                low = r
            else:
                high = r
        return high

    def impedance(self, depth: float) -> float:
        """Return the impedance d at a depth in m (the engine's chapter "Solver parameters", "Impedance")."""
        dmin, dmax, width, midpoint, power = self.solimp
        x = min(1.0, max(0.0, depth) / width)
        if x <= midpoint:
            y = x**power / midpoint ** (power - 1)
        else:
            y = 1 - (1 - x) ** power / (1 - midpoint) ** (power - 1)
        return dmin + y * (dmax - dmin)


def mujoco_contact(
    contact: KelvinVoigtContact, mapping: MappingName = "calibrated", impedance: float = MUJOCO_IMPEDANCE
) -> MujocoContact:
    """Map a contact to MuJoCo's parameters.

    The calibrated mapping has a constant impedance d as small as the engine allows, stiffness = k/M and damping = c/M.
    While the two bodies are alone, the result is *exactly* the contact asked for. When a third body pushes too, it is
    within d of that contact (docs/mapping.md).
    """
    if mapping == "naive":
        return MujocoContact((-contact.k, -contact.c), MUJOCO_DEFAULT_SOLIMP)
    if mapping == "documented":
        return MujocoContact((1 / (contact.zeta * contact.omega), contact.zeta), MUJOCO_DEFAULT_SOLIMP)
    d = impedance
    return MujocoContact((-contact.k / contact.mass, -contact.c / contact.mass), (d, d, 0.001, 0.5, 1.0))


class Side(NamedTuple):
    """The parameters of a body, or of one side of it, in an engine that combines the parameters of two bodies."""

    #: Stiffness in N/m: PyBullet's `contactStiffness`, Drake's "point_contact_stiffness".
    stiffness: float
    #: Dissipation: PyBullet's `contactDamping` c in N s/m, or "relaxation_time" c/k in s under Drake's `kSap`.
    dissipation: float

    def against(self, partner: Side) -> Side:
        """Combine two sides as the engines do: stiffness in series, dissipation added (btManifoldResult)."""
        stiffness = 1 / (1 / self.stiffness + 1 / partner.stiffness)
        return Side(stiffness, self.dissipation + partner.dissipation)


#: A side that adds nothing. Its stiffness is the default that PyBullet gives a body (BT_LARGE_FLOAT of btScalar.h,
#: double precision), so that 1/(1/k + 1/1e30) = k.
RIGID = Side(1e30, 0.0)


class ContactSides(NamedTuple):
    """The sides of two bodies that meet in a contact."""

    #: Side of the first body; in a line it is the lower side of the ball above.
    first: Side
    #: Side of the second body; in a line it is the upper side of the body below.
    second: Side


def sides_of_contacts(
    contacts: Sequence[Side], mapping: MappingName, *, one_side_per_body: bool = False
) -> list[ContactSides]:
    """Return the sides of the two bodies of each contact; `contacts` are the parameters that each contact shall have.

    The first body's side has the parameters of the contact; the second body's side is rigid and undamped. In some
    engines a body has one side only. Two balls on a table are possible even there: the upper ball has the parameters of
    contact 1, the table those of contact 2, and the lower ball is rigid. In the naive mapping bodies have one side in
    every engine, and both balls have the parameters of contact 1.
    """
    if not one_side_per_body and mapping != "naive":
        return [ContactSides(side, RIGID) for side in contacts]
    ball, table = contacts
    lower_ball = ball if mapping == "naive" else RIGID
    return [ContactSides(ball, lower_ball), ContactSides(lower_ball, table)]


def combine_sides(contacts: Sequence[ContactSides]) -> list[Side]:
    """Combine the two sides that meet at each contact."""
    return [first.against(second) for first, second in contacts]


def pybullet_side(contact: KelvinVoigtContact) -> Side:
    """Return PyBullet's parameters of the body that carries a contact."""
    return Side(contact.k, contact.c)


def drake_side(contact: KelvinVoigtContact) -> Side:
    """Return Drake's parameters of the geometry that carries a contact."""
    return Side(contact.k, contact.c / contact.k)
