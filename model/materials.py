"""Stiffness and restitution of contacts between bodies of known materials.

`MATERIALS` are the materials by name. A `Body` is a ball or a fixed flat. `MaterialContact` is the contact of two
bodies, Hertz's contact or a linear contact in its place. `line` makes a collision of bodies.

Used by the command `contact`, by `compliant_baselines.single_contact` and by users.

A contact has the force F = K delta^p. The contact between solids is Hertz's, elastic and quasi-static (Johnson, Contact
Mechanics, 1985, sections 4.2 and 11.4):

    p = 3/2, K = 4/3 E* sqrt(R*), 1/E* = (1 - nu_1^2)/E_1 + (1 - nu_2^2)/E_2, 1/R* = 1/R_1 + 1/R_2.

Here E is Young's modulus, nu Poisson's ratio, and R the radius of a body.

A hollow ball bends where it is touched. With a wall of thickness h, p = 1 and K = 4 E h^2/(R sqrt(3 (1 - nu^2)))
(Reissner, J. Math. Phys. 25:279, 1946). This is valid until its cap snaps through at a compression of a few h (Hubbard
and Stronge, Sports Engineering 4:49, 2001). If a hollow ball meets a solid, the indentation of the solid is neglected.

A linear contact can stand in for Hertz's contact. At a speed of impact v and with the reduced mass M, the linear
contact with the same greatest compression delta_max and the same stored energy has the stiffness k = M v^2/delta_max^2.
It lasts pi/2.9432 times as long as Hertz's contact, which is 6.7 % longer. Its peak force is 4/5 of the peak force of
Hertz's contact. If several contacts share an impact, the two laws give different outcomes. By the model at 1 m/s they
differ by a velocity divergence D = 0.15 for a steel ball that falls on another steel ball on a steel flat (radius 20
mm), and by D = 0.14 for one ball that strikes a row of four (tests/model/test_materials.py).

Restitution is energetic. The work done on each body is its share of the compression, and the body gives back the part
e_i^2 of this work (Coaplen, Stronge and Ravani, Int. J. Impact Eng. 30:581, 2004). Restitution falls with the speed,
most of all for metals. Each value in this module is valid at the speed of impact that its source has measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from impact_xval.model.collision import Collision


@dataclass(frozen=True, slots=True)
class Material:
    """Material of a body, in SI units.

    The restitution is None if no good source states it.
    """

    name: str
    young: float
    poisson: float
    density: float
    restitution: float | None
    #: Thickness of the wall of a hollow ball, in m; None for a solid body.
    wall: float | None = None


#: Materials by name; the help of the command `contact` and docs/mapping.md list the names too.
MATERIALS = {
    material.name: material
    for material in (
        # All four numbers: Hlosta et al., Processes 8:222 (2020). EN 1993-1-1 and EN 1993-1-2 have the same first
        # three.
        Material("steel", 210e9, 0.3, 7850.0, 0.85),
        # Soda-lime glass by EN 572-1; restitution of two spheres of 3 mm: Foerster, Louge, Chang and Allia, Phys.
        # Fluids 6:1108 (1994).
        Material("glass", 70e9, 0.2, 2500.0, 0.97),
        # 70 Cu, 30 Zn: Kaye and Laby, Tables of Physical and Chemical Constants, section 2.2.2; density of C26000 in
        # the ASM Handbook, volume 2.
        Material("brass", 100.6e9, 0.35, 8530.0, None),
        # Natural rubber of 50 IRHD: Lindley, Engineering Design with Natural Rubber, 4th ed. (1978); density: MatWeb,
        # vulcanised natural rubber; restitution of a SuperBall: "Measuring the collision time of a ball with high
        # coefficient of restitution" (journals.azbuki.bg).
        Material("rubber", 2.2e6, 0.5, 950.0, 0.9),
        # Celluloid, E and wall: Shorter, Smith, Coveney and Busfield, J. Mech. Mater. Struct. 5:689 (2010); nu is that
        # of glassy polymers, and K changes by 3 % from 0.33 to 0.45; density: 40 mm and 2.7 g are the law of the game;
        # restitution: a bounce of 235 to 255 mm from 305 mm on steel was its law for balls of 38 mm.
        Material("ping-pong", 2.2e9, 0.4, 1370.0, 0.9, wall=0.4e-3),
    )
}


#: Smallest and largest radius of a ball, in m. The masses of balls in this range are finite numbers above 0.
SMALLEST, LARGEST = 1e-9, 1e6


@dataclass(frozen=True, slots=True)
class Body:
    """Ball of a material, or a fixed flat if the radius is infinite.

    A ValueError names the field, the value and the legal range.
    """

    material: Material
    #: Radius in m.
    radius: float = math.inf

    def __post_init__(self) -> None:
        wall = self.material.wall
        least, flat = (SMALLEST, ", inf for a flat") if wall is None else (10 * wall, "; no flat is hollow")
        if not (least <= self.radius <= LARGEST or (wall is None and self.radius == math.inf)):
            legal = f"from {least:g} to {LARGEST:g} (m){flat}"
            raise ValueError(f"radius = {self.radius!r} of {self.material.name}; legal: {legal}")

    @property
    def mass(self) -> float:
        """Mass in kg."""
        wall = self.material.wall
        hollow = 0.0 if wall is None else (self.radius - wall) ** 3
        return self.material.density * 4 / 3 * math.pi * (self.radius**3 - hollow)

    @property
    def compliance(self) -> float:
        """Term (1 - nu^2)/E of the body in 1/E*, in 1/Pa; for a hollow ball 1/K, in m/N."""
        material = self.material
        if material.wall is None:
            return (1 - material.poisson**2) / material.young
        root = math.sqrt(3 * (1 - material.poisson**2))
        return self.radius * root / (4 * material.young * material.wall**2)


@dataclass(frozen=True, slots=True)
class MaterialContact:
    """Contact of two bodies. At least one of them must be a ball; otherwise a ValueError is raised."""

    upper: Body
    lower: Body

    @classmethod
    def of(cls, materials: Sequence[str], radii: Sequence[float]) -> MaterialContact:
        """Make the contact of two bodies from names of materials and radii in m, one or two each.

        If one name is given, it is the material of both bodies. If one radius is given, the second body is a flat.
        """
        for name, values, partner in (("material", materials, "radius"), ("radius", radii, "material")):
            if not 1 <= len(values) <= 2:
                raise ValueError(f"{name}: given {len(values)} times; legal: once or twice, beside {partner}")
        for name in materials:
            if name not in MATERIALS:
                raise ValueError(f"material = {name!r:.60}; legal: {', '.join(MATERIALS)}")
        return cls(Body(MATERIALS[materials[0]], radii[0]), Body(MATERIALS[materials[-1]], *radii[1:]))

    def __post_init__(self) -> None:
        if math.isinf(self.upper.radius) and math.isinf(self.lower.radius):
            raise ValueError("radius = inf inf: two flats have no point of contact; legal: at most one inf")

    @property
    def _yielding(self) -> list[Body]:
        """Bodies that are compressed: the hollow bodies, or both bodies if none of them is hollow."""
        hollow = [body for body in (self.upper, self.lower) if body.material.wall is not None]
        return hollow or [self.upper, self.lower]

    @property
    def exponent(self) -> float:
        """Exponent p of the contact force: 1.5 between solids, and 1 if a ball is hollow."""
        return 1.0 if any(body.material.wall for body in self._yielding) else 1.5

    @property
    def stiffness(self) -> float:
        """Stiffness K of the contact force K delta^p, in N/m^p."""
        compliance = sum(body.compliance for body in self._yielding)
        if self.exponent == 1:
            return 1 / compliance
        return 4 / 3 / compliance / math.sqrt(1 / self.upper.radius + 1 / self.lower.radius)

    @property
    def mass(self) -> float:
        """Reduced mass of both bodies in kg."""
        return 1 / (1 / self.upper.mass + 1 / self.lower.mass)

    @property
    def restitution(self) -> float:
        """Coefficient of energetic restitution; a ValueError names a material whose restitution is not known."""
        returned, work = 0.0, 0.0
        for body in self._yielding:
            e, name = body.material.restitution, body.material.name
            if e is None:
                raise ValueError(f"restitution of {name}: none has a source; legal: one of your own, 0 to 1")
            returned += e * e * body.compliance
            work += body.compliance
        return math.sqrt(returned / work)

    def compression(self, speed: float) -> float:
        """Return the greatest compression in m of an elastic impact at a speed in m/s."""
        if not 0 < speed < math.inf:
            raise ValueError(f"speed = {speed!r}; legal: a finite number > 0 (m/s)")
        p = self.exponent
        return ((p + 1) * self.mass * speed**2 / (2 * self.stiffness)) ** (1 / (p + 1))

    def duration(self, speed: float) -> float:
        """Return the duration in s of an elastic impact at a speed in m/s."""
        x = 1 / (self.exponent + 1)
        # The factor of the duration is pi for p = 1, and 2.9432 for p = 1.5.
        shape = 2 * math.sqrt(math.pi) * math.gamma(1 + x) / math.gamma(0.5 + x)
        return shape * self.compression(speed) / speed

    def linear(self, speed: float) -> float:
        """Return the stiffness in N/m of the linear contact with the same greatest compression and energy."""
        return self.mass * (speed / self.compression(speed)) ** 2


def line(bodies: Sequence[Body], velocities: Sequence[float], *, exponent: float = 1.0) -> Collision:
    """Make a collision of balls in a line, ball 1 on top.

    Parameters
    ----------
    bodies : sequence of Body
        Balls from top to bottom; a flat at the end is the table.
    velocities : sequence of float
        Velocities at first touch in m/s, one for each ball.
    exponent : float
        1.5 for Hertz's contacts; 1 for linear contacts in their place, at the largest speed of the balls.

    Returns
    -------
    Collision

    Raises
    ------
    ValueError
        For an illegal exponent, or a material without a known restitution.
    """
    contacts = [MaterialContact(upper, lower) for upper, lower in pairwise(bodies)]
    legal = (1.0, 1.5) if all(contact.exponent == 1.5 for contact in contacts) else (1.0,)
    if exponent not in legal:
        raise ValueError(f"exponent = {exponent!r}; legal: 1, or 1.5 where all balls are solid")
    speed = max(map(abs, velocities))
    return Collision(
        masses=tuple(body.mass for body in bodies if math.isfinite(body.radius)),
        stiffnesses=tuple(
            contact.stiffness if exponent == 1.5 else contact.linear(speed) for contact in contacts
        ),
        restitutions=tuple(contact.restitution for contact in contacts),
        velocities=tuple(velocities),
        table=math.isinf(bodies[-1].radius),
        exponent=exponent,
    )
