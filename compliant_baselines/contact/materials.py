"""From materials, radii and a speed to the stiffness of a contact: Hertz's law, and the linear spring in its place.

**Hertz** (K. L. Johnson, Contact Mechanics, 1985, sections 4.2 and 11.4). Two elastic spheres that are much larger
than the region in which they touch repel each other with F = K delta^(3/2),

    K = (4/3) E* sqrt(R*),    1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2,    1/R* = 1/R1 + 1/R2.

At the speed v and the reduced mass M they go delta_max = (5 M v^2/(4 K))^(2/5) into each other, with a force of at most
5 M v^2/(4 delta_max), and a contact without losses lasts T = 2.9433 delta_max/v.

**The linear spring** with the same duration at this speed, pi sqrt(M/k) = T:

    k = (pi/2.9433)^2 M v^2/delta_max^2 = 0.9114 K sqrt(delta_max).

The duration is what is kept, since it decides how contacts overlap in time and how long a step may be; impulse and
energy of a contact that is alone are then those of Hertz, and so is the mean force 2 M v/T. The penetration of the
spring is 6.3 % too small and its largest force 14.6 % too small, at any speed and of any materials. Keeping the largest
penetration instead makes k 0.8777 times as large, the duration 6.7 % too long and the force 20 % too small. Either way
k2/k1 of two contacts at one speed is the same, and so are final velocities (Theorem 5). k grows as v^(2/5): it holds at
the speed that it was made for.

Assumed are spheres, small strain and no yield. What is measured of materials is in `MATERIALS` and `RESTITUTIONS`, each
with its source; what has none here is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from impact_xval.model.collision import Collision
from impact_xval.model.columns.column import Column, ColumnOutcome
from impact_xval.model.inputs import Legal
from impact_xval.model.kinetic import column_norm

#: Duration of a Hertz contact over delta_max/v: twice the integral of 1/sqrt(1 - x^(5/2)) from 0 to 1.
HERTZ_DURATION = 4 * math.sqrt(math.pi) / 5 * math.gamma(0.4) / math.gamma(0.9)

#: p of F = K delta^p.
HERTZ_EXPONENT = 1.5


@dataclass(frozen=True, slots=True)
class Material:
    """What is measured of a material.

    Attributes
    ----------
    name : str
    young : float or None
        Young's modulus in Pa; None for a hollow body, to which Hertz's law does not apply.
    poisson : float or None
        Poisson's ratio.
    density : float or None
        In kg/m^3.
    radius : float or None
        Of the balls that the source used, in m; None if it used none.
    mass : float or None
        Of such a ball in kg, where it is not that of a solid one.
    source : str
        Who says so, and which values are typical ones with a range.
    """

    name: str
    young: float | None
    poisson: float | None
    density: float | None
    radius: float | None
    source: str
    mass: float | None = None


@dataclass(frozen=True, slots=True)
class MeasuredRestitution:
    """A coefficient of restitution that was measured, or that a standard demands.

    Attributes
    ----------
    materials : tuple of str
        Names of the two, in alphabetical order.
    low, high : float
        The range.
    speed : float or None
        At which it holds, in m/s; None if the source is cited here without it.
    source : str
    """

    materials: tuple[str, str]
    low: float
    high: float
    speed: float | None
    source: str

    @property
    def middle(self) -> float:
        """Middle of the range."""
        return (self.low + self.high) / 2


MATERIALS = {
    material.name: material
    for material in (
        Material(
            "steel",
            young=193e9,
            poisson=0.30,
            density=8000.0,
            radius=2.38e-3,
            source="stainless steel 316, as in Daraio, Nesterenko, Herbold and Jin, Physical Review E 73:026610, 2006",
        ),
        Material(
            "glass",
            young=71.3e9,
            poisson=0.22,
            density=2500.0,
            radius=1.5e-3,
            source="crown glass: Kaye and Laby, Tables of Physical and Chemical Constants, 16th ed., 1995, elastic "
            "constants; density: a typical value, 2400 to 2600",
        ),
        Material(
            "brass",
            young=100.6e9,
            poisson=0.35,
            density=8530.0,
            radius=None,
            source="70 Cu 30 Zn: Kaye and Laby, 16th ed., 1995, elastic constants; density of cartridge brass: ASM "
            "Handbook, vol. 2, 1990",
        ),
        Material(
            "rubber",
            young=2e6,
            poisson=0.499,
            density=925.0,
            radius=None,
            source="natural rubber, typical values: E 1.5 to 2.5 MPa, density 920 to 930 (Ashby, Shercliff and Cebon, "
            "Materials: Engineering, Science, Processing and Design, 2007, appendix); nearly incompressible",
        ),
        Material(
            "ping-pong",
            young=None,
            poisson=None,
            density=None,
            radius=20e-3,
            mass=2.7e-3,
            source="ITTF, Laws of Table Tennis, 2.3: diameter 40 mm, mass 2.7 g; a thin shell",
        ),
    )
}

RESTITUTIONS = (
    MeasuredRestitution(
        ("glass", "glass"),
        low=0.96,
        high=0.98,
        speed=None,
        source="spheres of 3 mm: Foerster, Louge, Chang and Allia, Physics of Fluids 6:1108, 1994",
    ),
    MeasuredRestitution(
        ("ping-pong", "steel"),
        # A drop of 305 mm has to come back to 240 to 260 mm.
        low=math.sqrt(240 / 305),
        high=math.sqrt(260 / 305),
        speed=math.sqrt(2 * 9.81 * 0.305),
        source="demanded on a steel block: ITTF, Technical Leaflet T3, 2016; air drag left out",
    ),
)

_RADIUS = Legal("radius", math.ulp(0.0), math.inf, "greater than 0 (m); inf for a flat, fixed body")
_SPEED = Legal("speed", math.ulp(0.0), 1e6, "greater than 0, at most 1e6 (m/s)")


def measured_restitution(first: str, second: str) -> MeasuredRestitution | None:
    """Return what is known of the restitution of two materials; None if nothing is."""
    names = tuple(sorted((first, second)))
    return next((each for each in RESTITUTIONS if each.materials == names), None)


@dataclass(frozen=True, slots=True)
class Body:
    """A solid ball of one material, or a flat fixed body.

    Parameters
    ----------
    material : Material
    radius : float
        In m; infinite for a flat, fixed body.

    Raises
    ------
    ValueError
        For an illegal radius, a material that Hertz's law does not apply to, or a mass beyond double precision.
    """

    material: Material
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", _RADIUS.number(self.radius))
        if self.material.young is None:
            raise ValueError(
                f"material = {self.material.name!r}: a thin shell bends and buckles, and is no elastic half-space; "
                f"legal: {', '.join(name for name, each in MATERIALS.items() if each.young is not None)}"
            )
        if not self.fixed and not 0 < self.mass < math.inf:
            raise ValueError(
                f"radius = {self.radius!r}: a mass beyond double precision; legal: a real ball's"
            )

    @property
    def fixed(self) -> bool:
        """Whether it is flat and fixed."""
        return math.isinf(self.radius)

    @property
    def mass(self) -> float:
        """In kg; infinite for a fixed body."""
        if self.fixed:
            return math.inf
        assert self.material.density is not None
        # Cubed one by one: a power beyond double precision is an exception, a product infinite.
        return 4 / 3 * math.pi * self.material.density * self.radius * self.radius * self.radius

    @property
    def compliance(self) -> float:
        """(1 - nu^2)/E, in 1/Pa."""
        assert self.material.young is not None
        assert self.material.poisson is not None
        return (1 - self.material.poisson**2) / self.material.young


@dataclass(frozen=True, slots=True)
class HertzContact:
    """One contact without losses, at one speed; symbols as in the module.

    Attributes
    ----------
    stiffness : float
        K, in N/m^1.5.
    mass : float
        Reduced mass M, in kg.
    speed : float
        Of approach, in m/s.
    """

    stiffness: float
    mass: float
    speed: float

    @property
    def penetration(self) -> float:
        """delta_max, in m."""
        return (1.25 * self.mass * self.speed**2 / self.stiffness) ** 0.4

    @property
    def duration(self) -> float:
        """T, in s; that of the linear spring too."""
        return HERTZ_DURATION * self.penetration / self.speed

    @property
    def force(self) -> float:
        """Largest force, in N."""
        return self.stiffness * self.penetration**HERTZ_EXPONENT

    @property
    def linear_stiffness(self) -> float:
        """Stiffness k of the linear spring that lasts as long, in N/m."""
        return self.mass * (math.pi / self.duration) ** 2

    @property
    def linear_penetration(self) -> float:
        """Of the linear spring, in m."""
        return self.speed * self.duration / math.pi

    @property
    def linear_force(self) -> float:
        """Largest force of the linear spring, in N."""
        return self.linear_stiffness * self.linear_penetration


def hertz_contact(first: Body, second: Body, speed: float) -> HertzContact:
    """Return the contact of two bodies that meet at a speed.

    Parameters
    ----------
    first, second : Body
        At most one of them fixed.
    speed : float
        Of approach, in m/s.

    Raises
    ------
    ValueError
        For two fixed bodies, an illegal speed, or a contact beyond double precision.
    """
    if first.fixed and second.fixed:
        raise ValueError("radius = inf, inf: two fixed bodies do not collide; legal: at most one inf")
    effective_modulus = 1 / (first.compliance + second.compliance)
    effective_radius = 1 / (1 / first.radius + 1 / second.radius)
    contact = HertzContact(
        stiffness=4 / 3 * effective_modulus * math.sqrt(effective_radius),
        mass=1 / (1 / first.mass + 1 / second.mass),
        speed=_SPEED.number(speed),
    )
    penetration = contact.penetration
    if not (0 < penetration < math.inf and 0 < contact.linear_stiffness < math.inf):
        raise ValueError(f"speed = {speed!r}: a contact beyond double precision; legal: nearer to 1 m/s")
    return contact


@dataclass(frozen=True, slots=True)
class Linearised:
    """Two balls on a table, with Hertz contacts and with the linear springs in their place.

    Attributes
    ----------
    collision : Collision
        With the linear springs.
    hertz, linear : ColumnOutcome
        What the model answers, exactly, of either.
    divergence : float
        D of the two, the kinetic norm of the difference of the final velocities.
    """

    collision: Collision
    hertz: ColumnOutcome
    linear: ColumnOutcome
    divergence: float


def linearised(upper: Body, lower: Body, table: Body, speed: float, e1: float, e2: float) -> Linearised:
    """Say what linearising both contacts at the speed of impact changes in the collision of two balls on a table.

    Parameters
    ----------
    upper, lower : Body
        Balls.
    table : Body
        Fixed.
    speed : float
        Of the upper ball, in m/s.
    e1, e2 : float
        Coefficients of energetic restitution, ball on ball and ball on table, from 0 to 1.

    Raises
    ------
    ValueError
        For bodies that are not two balls and a fixed one, and what `hertz_contact` and `Collision` refuse.
    """
    from impact_xval.model.columns.solving import solve_column

    if upper.fixed or lower.fixed or not table.fixed:
        raise ValueError("radius: legal for two balls on a table: finite, finite, inf")
    contacts = [hertz_contact(upper, lower, speed), hertz_contact(lower, table, speed)]
    k1, k2 = (contact.linear_stiffness for contact in contacts)
    collision = Collision(upper.mass, lower.mass, k1, k2, e1, e2, -speed)

    def column(*stiffnesses: float) -> Column:
        masses, velocities = (upper.mass, lower.mass), (-speed, 0.0)
        return Column(masses, stiffnesses, (e1, e2), velocities, table=True)

    before = column(k1, k2)
    hertz = solve_column(column(*(each.stiffness for each in contacts)), exponent=HERTZ_EXPONENT)
    linear = solve_column(before)
    change = [a - b for a, b in zip(hertz.velocities, linear.velocities, strict=True)]
    divergence = column_norm(before.masses, change) / column_norm(before.masses, before.velocities)
    return Linearised(collision, hertz, linear, float(divergence))
