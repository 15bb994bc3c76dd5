"""Mappings of a contact's stiffness k and restitution e to the parameters of each engine (docs/mapping.md).

* ``calibrated``: the parameters with which a contact of two bodies alone has this k and e
* ``naive``: the parameters that a user would write who knows the names of the parameters, but not the engine's source.
  The damping ratio comes from the textbook's formula.
* ``documented`` (only MuJoCo): a time constant and a damping ratio
* ``shipped`` (MuJoCo, and all rigid engines except Pymunk): nothing is set, and the step is the engine's default
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

#: Smallest impedance of a contact that MuJoCo accepts (mjMINIMP in mjmodel.h). The smaller the impedance, the nearer is
#: the force of a contact to k delta + c delta' when a third body pushes too.
MUJOCO_IMPEDANCE = 1e-4

#: MuJoCo's default solref: a time constant in s and a damping ratio (XML reference).
MUJOCO_DEFAULT_SOLREF = (0.02, 1.0)

#: MuJoCo's default solimp: dmin, dmax, width in m, midpoint and power (XML reference).
MUJOCO_DEFAULT_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)


class KelvinVoigtContact(NamedTuple):
    """A contact with a spring and a dashpot that pushes and never pulls: F = max(0, k delta + c delta')."""

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
        """Make the contact of stiffness k with which two bodies alone have the restitution e.

        `e` is in (0, 1], and `mass` is the reduced mass of the two bodies in kg. The naive mapping takes the textbook's
        damping ratio.
        """
        zeta = textbook_damping_ratio(e) if mapping == "naive" else damping_ratio(e)
        return cls(k, 2 * zeta * math.sqrt(k) * math.sqrt(mass), mass)

    @property
    def omega(self) -> float:
        """Angular frequency sqrt(k/M) in 1/s, with the stiffness k and the reduced mass M."""
        return math.sqrt(self.k / self.mass)

    @property
    def period(self) -> float:
        """Period 2 pi sqrt(M/k) in s that the contact would have without damping."""
        return 2 * math.pi / self.omega

    @property
    def zeta(self) -> float:
        """Damping ratio c/(2 M omega), with the damping c, the reduced mass M and omega = sqrt(k/M)."""
        return self.c / (2 * self.mass * self.omega)

    @property
    def duration(self) -> float:
        """Duration in s of a contact of the two bodies alone, without gravity."""
        return contact_time(self.zeta) / self.omega

    @property
    def restitution(self) -> float:
        """Coefficient of restitution of the two bodies alone, without gravity."""
        return restitution(self.zeta)


class MujocoContact(NamedTuple):
    """The parameters of a contact `<pair>` in MuJoCo."""

    #: The engine's solref: either -stiffness in 1/s^2 and -damping in 1/s (direct format), or two positive numbers, a
    #: time constant in s and a damping ratio.
    solref: tuple[float, float]
    #: The engine's solimp: dmin, dmax, width in m, midpoint and power.
    solimp: tuple[float, float, float, float, float]

    @property
    def direct(self) -> tuple[float, float]:
        """The solref in direct format, -stiffness and -damping.

        The engine's chapter "Solver parameters", section "Reference acceleration", has the conversion.
        """
        first, second = self.solref
        return self.solref if first <= 0 else (-1 / (first * second) ** 2, -2 / first)

    def stiffness(self, mass: float) -> float:
        """Return the stiffness in N/m of this contact between two bodies alone, with the impedance d = dmin.

        `mass` is their reduced mass in kg. Without damping, the engine's equations give the acceleration stiffness r
        (d/dmax)^2 at the depth r.
        """
        dmin, dmax = self.solimp[:2]
        return -self.direct[0] * mass * (dmin / dmax) ** 2

    def equilibrium_depth(self, acceleration: float) -> float:
        """Return the depth in m at which a ball rests on this contact under an acceleration in m/s^2.

        The depth r solves stiffness r (d/dmax)^2 = (1 - d) acceleration, with the impedance d = d(r). The engine's
        chapter "Computation", section "Constraint model", has this equation.
        """
        dmin, dmax = self.solimp[:2]
        stiffness = -self.direct[0]
        if dmin == dmax:
            return (1 - dmin) * acceleration / stiffness
        # Suppose that the impedance had its smallest value at every depth. `high` is twice the depth at which the ball
        # would then rest.
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

    The calibrated mapping writes a constant impedance d, stiffness = k/M and damping = c/M; d is as small as the engine
    allows. Between two bodies alone, this is *exactly* the contact asked for. If a third body pushes too, the force
    differs from that contact by a part d of M times the acceleration (docs/mapping.md).
    """
    if mapping == "naive":
        return MujocoContact((-contact.k, -contact.c), MUJOCO_DEFAULT_SOLIMP)
    if mapping == "documented":
        return MujocoContact((1 / (contact.zeta * contact.omega), contact.zeta), MUJOCO_DEFAULT_SOLIMP)
    d = impedance
    return MujocoContact((-contact.k / contact.mass, -contact.c / contact.mass), (d, d, 0.001, 0.5, 1.0))


class Side(NamedTuple):
    """Parameters of one of the two bodies of a contact, in an engine that combines the parameters of both bodies."""

    #: Stiffness in N/m: `contactStiffness` in PyBullet, "point_contact_stiffness" in Drake.
    stiffness: float
    #: In PyBullet `contactDamping`, a damping c in N s/m. In Drake's `kSap` "relaxation_time", the quotient c/k in s.
    dissipation: float

    def against(self, partner: Side) -> Side:
        """Return the parameters of the contact of a body with a second body: stiffnesses in series, dissipations added.

        Both engines combine the parameters of two bodies in this way; PyBullet's source is btManifoldResult.cpp.
        """
        stiffness = 1 / (1 / self.stiffness + 1 / partner.stiffness)
        return Side(stiffness, self.dissipation + partner.dissipation)


#: Parameters of a rigid and undamped body. In a contact with it the other body's parameters are those of the contact:
#: 1/(1/k + 1/1e30) = k in double precision. PyBullet uses the same stiffness of 1e30 N/m for a body whose contact
#: stiffness is not set (BT_LARGE_FLOAT in btScalar.h).
RIGID = Side(1e30, 0.0)


class ContactSides(NamedTuple):
    """The parameters of both bodies of a contact."""

    #: Parameters of the first body. In a line it is the upper body, which touches with its lower side.
    first: Side
    #: Parameters of the second body. In a line it is the lower body, which touches with its upper side.
    second: Side


def sides_of_contacts(
    contacts: Sequence[Side], mapping: MappingName, *, one_side_per_body: bool = False
) -> list[ContactSides]:
    """Return the parameters of both bodies for each contact.

    `contacts` are the parameters that each contact shall have.

    The first body gets the parameters of the contact, and the second body is rigid and undamped in this contact.

    In some engines a body has the same parameters in all its contacts (`one_side_per_body`). There two balls on a table
    are the only possible scene: the upper ball has the parameters of contact 1, the table has those of contact 2, and
    the lower ball is rigid.

    In the naive mapping every body has the same parameters in all its contacts. Both balls have the parameters of
    contact 1.
    """
    if not one_side_per_body and mapping != "naive":
        return [ContactSides(side, RIGID) for side in contacts]
    ball, table = contacts
    lower_ball = ball if mapping == "naive" else RIGID
    return [ContactSides(ball, lower_ball), ContactSides(lower_ball, table)]


def combine_sides(contacts: Sequence[ContactSides]) -> list[Side]:
    """Return the parameters of each contact, combined from the parameters of its two bodies."""
    return [first.against(second) for first, second in contacts]


def pybullet_side(contact: KelvinVoigtContact) -> Side:
    """Return PyBullet's parameters for a contact, to be set on one of the two bodies."""
    return Side(contact.k, contact.c)


def drake_side(contact: KelvinVoigtContact) -> Side:
    """Return Drake's parameters for a contact, to be set on the geometry of one of the two bodies."""
    return Side(contact.k, contact.c / contact.k)
