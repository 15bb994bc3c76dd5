"""From what a collision asks of a contact, (k, e), to what each engine calls its parameters.

The chain has three links, each a closed form of its own:

1. e -> zeta, the damping ratio of a Kelvin-Voigt contact that may push but not pull (docs/theory.md, section 7;
   Schwager and Poeschel, Granular Matter 9:465, 2007, their equations for the contact that ends when its
   force is zero), in `restitution`;
2. zeta -> c = 2 zeta sqrt(k M), with M the reduced mass of the *pair*, as if no third body took part;
3. (k, c) -> the engine's own numbers.

Beside the **calibrated** mapping stands the **naive** one: what a user writes who has read the names of the
parameters but not the engine's source. It is there so that its cost can be tabulated, never as a
recommendation. It takes zeta from the textbook formula, and

* MuJoCo: k and c as they are, in N/m and N s/m, in a direct-format solref under the default solimp. The
  engine reads them as 1/s^2 and 1/s, and its default impedance is not that of a spring;
* PyBullet: k and c as properties of a *body*, since `changeDynamics` sets them per body: both balls get those
  of the ball-ball contact, the table those of the ball-table contact. The engine combines two bodies in
  series, so that equal balls are half as stiff and twice as damped as asked. (Leaving a body unset, the other
  common slip, costs only the engine's default damping of 0.1 N s/m, which is nothing at the stiffness of the
  default grid.)
* Drake: the same slip, k and the relaxation time c/k as properties of each geometry: half as stiff but, as
  relaxation times add, damped as asked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from impact_xval.compliant_baselines.restitution import (
    contact_time,
    damping_ratio,
    restitution,
    textbook_damping_ratio,
)
from impact_xval.compliant_baselines.solver import MappingName
from impact_xval.model.collision import Collision

#: MuJoCo's smallest constraint impedance (mjMINIMP of mjmodel.h): the nearest it comes to a force-level
#: contact.
MUJOCO_IMPEDANCE = 1e-4

#: MuJoCo's default solimp (dmin, dmax, width in m, midpoint, power), of the XML reference.
MUJOCO_DEFAULT_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)

#: A stiffness, in N/m, that adds nothing in series with any stiffness of interest: 1/(1/k + 1/1e30) = k. It
#: is the engine's own value for a body that was not given one (BT_LARGE_FLOAT of btScalar.h, double
#: precision).
PYBULLET_RIGID = 1e30


@dataclass(frozen=True, slots=True)
class Contact:
    """One Kelvin-Voigt contact, F = max(0, k delta + c delta').

    Attributes
    ----------
    k : float
        Stiffness in N/m.
    c : float
        Damping in N s/m.
    mass : float
        Reduced mass of the pair in kg.
    """

    k: float
    c: float
    mass: float

    @classmethod
    def from_restitution(
        cls, k: float, e: float, mass: float, mapping: MappingName = "calibrated"
    ) -> Contact:
        """Make the contact of stiffness k that gives restitution e to a pair of this reduced mass, alone.

        Raises
        ------
        ValueError
            For e outside (0, 1].
        """
        zeta = damping_ratio(e) if mapping == "calibrated" else textbook_damping_ratio(e)
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


def contacts(collision: Collision, mapping: MappingName = "calibrated") -> tuple[Contact, Contact]:
    """Contact 1 (ball-ball, M = m1 m2/(m1 + m2)) and contact 2 (ball-table, M = m2) of a collision.

    Raises
    ------
    ValueError
        For e_i = 0.
    """
    c = collision
    return (
        Contact.from_restitution(c.k1, c.e1, c.reduced_mass, mapping),
        Contact.from_restitution(c.k2, c.e2, c.m2, mapping),
    )


@dataclass(frozen=True, slots=True)
class MujocoContact:
    """A contact pair of MuJoCo.

    Attributes
    ----------
    solref : tuple of float
        Direct format: (-stiffness, -damping), in 1/s^2 and 1/s.
    solimp : tuple of float
        (dmin, dmax, width, midpoint, power).
    """

    solref: tuple[float, float]
    solimp: tuple[float, float, float, float, float]

    def stiffness(self, mass: float) -> float:
        """Stiffness in N/m that a pair of this reduced mass, alone, finds in this contact, at least.

        Solved for the acceleration, the engine's equations read a = stiffness r (d/dmax)^2 (damping aside): a
        mass on a spring. Exact at a constant impedance; else that of the smallest d.
        """
        dmin, dmax = self.solimp[:2]
        return -self.solref[0] * mass * (dmin / dmax) ** 2

    def rest_penetration(self, acceleration: float) -> float:
        """Penetration in m at which a ball rests on this contact in a field of this acceleration, in m/s^2.

        At rest the engine's force equals the weight where d K r = (1 - d) acceleration, K = stiffness
        d/dmax^2, with the impedance d a function of r (equations of the engine's "Computation" chapter,
        section "Constraint model").
        """
        dmin, dmax, width, midpoint, power = self.solimp
        stiffness = -self.solref[0]

        def impedance(r: float) -> float:
            x = min(1.0, r / width)
            if x <= midpoint:
                y = x**power / midpoint ** (power - 1)
            else:
                y = 1 - (1 - x) ** power / (1 - midpoint) ** (power - 1)
            return dmin + y * (dmax - dmin)

        if dmin == dmax:
            return (1 - dmin) * acceleration / stiffness
        # d lies between dmin and dmax, and with it the root between the two rests of constant impedance.
        low, high = 0.0, 2 * (1 - dmin) * acceleration / (stiffness * (dmin / dmax) ** 2)
        while low < (r := 0.5 * (low + high)) < high:
            d = impedance(r)
            if stiffness * r * (d / dmax) ** 2 < (1 - d) * acceleration:
                low = r
            else:
                high = r
        return high


def mujoco_contact(
    contact: Contact, mapping: MappingName = "calibrated", impedance: float = MUJOCO_IMPEDANCE
) -> MujocoContact:
    """MuJoCo's parameters of one contact.

    Calibrated: a constant impedance d as small as the engine allows, stiffness = k A and damping = c A with A
    = 1/M the sum of the bodies' inverse weights. The engine's constraint then obeys F (1 - d) = k delta + c
    delta' - d M a, with a the rate at which the pair separates faster: *exactly* the contact asked for as
    long as the pair is alone (F = M a), and within d of it when a third body pushes too. The force-level
    variant, both numbers times (1 - d), gives k delta + c delta' - d/(1 - d) M a: within d always, exact in
    statics only.

    Naive: see the module's docstring.
    """
    if mapping == "naive":
        return MujocoContact((-contact.k, -contact.c), MUJOCO_DEFAULT_SOLIMP)
    d = impedance
    return MujocoContact((-contact.k / contact.mass, -contact.c / contact.mass), (d, d, 0.001, 0.5, 1.0))


@dataclass(frozen=True, slots=True)
class PybulletBody:
    """`changeDynamics(contactStiffness=stiffness, contactDamping=damping)` of one body, in N/m and N s/m."""

    stiffness: float
    damping: float

    def against(self, other: PybulletBody) -> PybulletBody:
        """Combine two bodies as the engine does: stiffness in series, damping added (btManifoldResult)."""
        series = 1 / (1 / self.stiffness + 1 / other.stiffness)
        return PybulletBody(series, self.damping + other.damping)


def pybullet_bodies(
    contact1: Contact, contact2: Contact, mapping: MappingName = "calibrated"
) -> tuple[PybulletBody, PybulletBody, PybulletBody]:
    """PyBullet's parameters of the upper ball, the lower ball and the table.

    Calibrated: the upper ball carries contact 1, the table contact 2, and the lower ball, which takes part in
    both, is rigid and undamped. Naive: see the module's docstring.
    """
    upper = PybulletBody(contact1.k, contact1.c)
    table = PybulletBody(contact2.k, contact2.c)
    lower = upper if mapping == "naive" else PybulletBody(PYBULLET_RIGID, 0.0)
    return upper, lower, table


@dataclass(frozen=True, slots=True)
class DrakeGeometry:
    """Proximity properties of a geometry under Drake's `kSap`, ("material", ...).

    Attributes
    ----------
    stiffness : float
        "point_contact_stiffness", in N/m.
    relaxation_time : float
        "relaxation_time", tau = c/k, in s.
    """

    stiffness: float
    relaxation_time: float

    def against(self, other: DrakeGeometry) -> DrakeGeometry:
        """Combine two geometries as the engine does: stiffness in series, relaxation times added."""
        series = 1 / (1 / self.stiffness + 1 / other.stiffness)
        return DrakeGeometry(series, self.relaxation_time + other.relaxation_time)


def drake_geometries(
    contact1: Contact, contact2: Contact, mapping: MappingName = "calibrated"
) -> tuple[DrakeGeometry, DrakeGeometry, DrakeGeometry]:
    """Drake's parameters of the upper ball, the lower ball and the table; shared out as `pybullet_bodies` does."""
    upper = DrakeGeometry(contact1.k, contact1.c / contact1.k)
    table = DrakeGeometry(contact2.k, contact2.c / contact2.k)
    lower = upper if mapping == "naive" else DrakeGeometry(PYBULLET_RIGID, 0.0)
    return upper, lower, table
