"""Materials by name, and the contact of two bodies made of them: Hertz's, and a linear one in its place.

The contact is F = K delta^p. Between solids it is Hertz's (Johnson, Contact Mechanics, 1985, sections 4.2 and 11.4),
elastic and quasi-static:

    p = 3/2, K = 4/3 E* sqrt(R*), 1/E* = (1 - nu_1^2)/E_1 + (1 - nu_2^2)/E_2, 1/R* = 1/R_1 + 1/R_2.

A hollow ball bends where it is touched: p = 1, K = 4 E h^2/(R sqrt(3 (1 - nu^2))) with a wall of thickness h (Reissner,
J. Math. Phys. 25:279, 1946), until its cap snaps through, at a few h (Hubbard and Stronge, Sports Engineering 4:49,
2001). The indentation of a solid that it meets is left out.

The linear contact that has the same greatest compression and stores the same energy at a speed of impact v has
k = M v^2/delta_max^2. Beside Hertz's it lasts pi/2.9432 times as long, 6.7 % longer, and its peak force is 4/5. Several
contacts at once share an impact out differently: of two steel balls of 20 mm radius, one on the other on a steel flat,
the laws end D = 0.15 apart, of one ball on four in a row 0.14, by the model at 1 m/s (tests/model/test_materials.py).

Restitution is energetic. Each body gives back e_i^2 of the work done on it, which is its share of the compression
(Coaplen, Stronge and Ravani, Int. J. Impact Eng. 30:581, 2004). A restitution falls with the speed, most of all that of
metals; each one here is its source's, at the speed of that.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from impact_xval.model.collision import Collision


@dataclass(frozen=True, slots=True)
class Material:
    """What a body is made of, in SI units; a restitution of None is known from no source good enough."""

    name: str
    young: float
    poisson: float
    density: float
    restitution: float | None
    #: Thickness of a hollow ball's wall, in m.
    wall: float | None = None


MATERIALS = {
    material.name: material
    for material in (
        # All four: Hlosta et al., Processes 8:222 (2020); the first three are those of EN 1993-1-1 and EN 1993-1-2.
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


#: Radii of balls, in m: within them masses stay numbers.
SMALLEST, LARGEST = 1e-9, 1e6


@dataclass(frozen=True, slots=True)
class Body:
    """A ball, or with an infinite radius a fixed flat; a ValueError names the field, the value and the legal range."""

    material: Material
    #: In m.
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
        """Its part of 1/E* in 1/Pa, or of a hollow ball 1/K in m/N."""
        of = self.material
        if of.wall is None:
            return (1 - of.poisson**2) / of.young
        return self.radius * math.sqrt(3 * (1 - of.poisson**2)) / (4 * of.young * of.wall**2)


@dataclass(frozen=True, slots=True)
class Touch:
    """The contact of two bodies; a ValueError says that both are flat."""

    one: Body
    two: Body

    @classmethod
    def of(cls, materials: Sequence[str], radii: Sequence[float]) -> Touch:
        """Make it of one or two names and radii: one name is that of both bodies, a radius left out is a flat's."""
        for name, given in (("material", materials), ("radius", radii)):
            if not 1 <= len(given) <= 2:
                legal = f"once or twice, beside {'radius' if name == 'material' else 'material'}"
                raise ValueError(f"{name}: given {len(given)} times; legal: {legal}")
        for name in materials:
            if name not in MATERIALS:
                raise ValueError(f"material = {name!r:.60}; legal: {', '.join(MATERIALS)}")
        return cls(Body(MATERIALS[materials[0]], radii[0]), Body(MATERIALS[materials[-1]], *radii[1:]))

    def __post_init__(self) -> None:
        if math.isinf(self.one.radius) and math.isinf(self.two.radius):
            raise ValueError("radius = inf inf: two flats have no point of contact; legal: at most one inf")

    @property
    def _yielding(self) -> list[Body]:
        """The bodies that take part in the compression: hollow ones, or both."""
        hollow = [body for body in (self.one, self.two) if body.material.wall is not None]
        return hollow or [self.one, self.two]

    @property
    def exponent(self) -> float:
        """p: 1.5 between solids, 1 where a ball is hollow."""
        return 1.0 if any(body.material.wall for body in self._yielding) else 1.5

    @property
    def stiffness(self) -> float:
        """K, in N/m^p."""
        soft = sum(body.compliance for body in self._yielding)
        if self.exponent == 1:
            return 1 / soft
        return 4 / 3 / soft / math.sqrt(1 / self.one.radius + 1 / self.two.radius)

    @property
    def mass(self) -> float:
        """Reduced mass in kg."""
        return 1 / (1 / self.one.mass + 1 / self.two.mass)

    @property
    def restitution(self) -> float:
        """Coefficient of energetic restitution; a ValueError says that it is not known of a material."""
        given, done = 0.0, 0.0
        for body in self._yielding:
            e, name = body.material.restitution, body.material.name
            if e is None:
                raise ValueError(f"restitution of {name}: none has a source; legal: one of your own, 0 to 1")
            given, done = given + e * e * body.compliance, done + body.compliance
        return math.sqrt(given / done)

    def compression(self, speed: float) -> float:
        """Greatest compression in m, of an elastic impact at a speed in m/s."""
        if not 0 < speed < math.inf:
            raise ValueError(f"speed = {speed!r}; legal: a finite number > 0 (m/s)")
        p = self.exponent
        return ((p + 1) * self.mass * speed**2 / (2 * self.stiffness)) ** (1 / (p + 1))

    def duration(self, speed: float) -> float:
        """How long an elastic impact lasts, in s."""
        x = 1 / (self.exponent + 1)
        shape = 2 * math.sqrt(math.pi) * math.gamma(1 + x) / math.gamma(0.5 + x)  # pi, or 2.9432 of Hertz
        return shape * self.compression(speed) / speed

    def linear(self, speed: float) -> float:
        """Stiffness k in N/m of the linear contact of the same greatest compression and energy."""
        return self.mass * (speed / self.compression(speed)) ** 2


def line(bodies: Sequence[Body], velocities: Sequence[float], *, exponent: float = 1.0) -> Collision:
    """Make a collision of balls in a line, ball 1 on top; a flat, last, is the table.

    Parameters
    ----------
    bodies, velocities
        One velocity in m/s for each ball.
    exponent : float
        1.5 for Hertz's contacts, 1 for the linear ones in their place at the largest speed that is given.
    """
    touches = [Touch(one, two) for one, two in pairwise(bodies)]
    legal = (1.0, 1.5) if all(touch.exponent == 1.5 for touch in touches) else (1.0,)
    if exponent not in legal:
        raise ValueError(f"exponent = {exponent!r}; legal: 1, or 1.5 where all balls are solid")
    speed = max(map(abs, velocities))
    return Collision(
        masses=tuple(body.mass for body in bodies if math.isfinite(body.radius)),
        stiffnesses=tuple(t.stiffness if exponent == 1.5 else t.linear(speed) for t in touches),
        restitutions=tuple(touch.restitution for touch in touches),
        velocities=tuple(velocities),
        table=math.isinf(bodies[-1].radius),
        exponent=exponent,
    )
