"""What an engine is asked to run: two balls above a table, in the numbers an engine needs.

Heights are counted from touching: x2 is that of B2 above the table (negative inside it), x1 that of B1 above
the place where it would touch a B2 that only just touches the table. The gaps are x1 - x2 and x2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from impact_xval.compliant_baselines.mapping import Contact, contacts
from impact_xval.compliant_baselines.solver import MappingName, Settings
from impact_xval.model.collision import Collision

#: Least radius of the balls over the depth to which they may go. Large enough that no ball comes near to
#: passing through another; no larger, since a penetration is the difference of positions of that size and
#: loses as many digits.
RADIUS_OVER_DEPTH = 4.0


@dataclass(frozen=True, slots=True)
class Column:
    """Two balls above a table.

    Attributes
    ----------
    m1, m2 : float
        Masses of B1 and B2 in kg.
    contact1, contact2 : Contact
        What is asked of the ball-ball and of the ball-table contact.
    mapping : str
        How that becomes the engine's own parameters.
    gravity : float
        Downwards, in m/s^2; 0 for none.
    settled : bool
        Whether B2 starts in static equilibrium on the table (each engine knows its own); x1 and x2 then count
        from there. Asked for by a drop.
    x1, x2, v1, v2 : float
        Heights (see the module) in m and velocities in m/s at t = 0.
    step : float
        Time step in s.
    regularisation : float
        How many times the engine's least regularisation of contacts, where it has any.
    """

    m1: float
    m2: float
    contact1: Contact
    contact2: Contact
    mapping: MappingName
    gravity: float
    settled: bool
    x1: float
    x2: float
    v1: float
    v2: float
    step: float
    regularisation: float = 1.0

    @property
    def masses(self) -> tuple[float, float]:
        """Masses of B1 and B2 in kg."""
        return self.m1, self.m2

    @property
    def contacts(self) -> tuple[Contact, Contact]:
        """Both contacts, the upper one first."""
        return self.contact1, self.contact2

    @property
    def speed(self) -> float:
        """Speed of impact in m/s: what errors are relative to."""
        return abs(self.v1)

    @property
    def fastest(self) -> float:
        """Larger of the speeds at t = 0, in m/s."""
        return max(abs(self.v1), abs(self.v2))

    @property
    def weights(self) -> tuple[float, ...]:
        """Masses over that of the first ball."""
        return 1.0, self.m2 / self.m1

    @property
    def table(self) -> bool:
        """Whether there is a table; as of `engines.line.Line`."""
        return True

    @property
    def period(self) -> float:
        """Shorter of the contact periods asked for, in s; that of `shorter_period`."""
        return min(self.contact1.period, self.contact2.period)

    def depth(self, k1: float, k2: float) -> float:
        """Bound the penetrations of this column, in m, given its stiffnesses as the engine has them.

        It is what a spring needs to stop the masses above it from the highest speed about, and what their
        weight presses it in by.
        """
        speed = max(abs(self.v1), abs(self.v2))
        above = self.m1 + self.m2
        dynamic = speed * (math.sqrt(self.contact1.mass / k1) + math.sqrt(above / k2))
        static = self.gravity * (self.m1 / k1 + above / k2)
        return dynamic + static

    def start(self, rest: float, radius: float) -> tuple[float, float]:
        """Give the heights x1 and x2 at t = 0 in m, for how deep B2 settles and the balls' radius, both in m.

        Rounded to the spacing of floating-point numbers at four radii, so that adding one or three radii
        rounds nothing away: the gap between the balls is then exact, see `radius_of`. `rest` counts only if
        B2 is settled.
        """
        rest = rest if self.settled else 0.0
        far = 4 * radius
        return (self.x1 - rest + far) - far, (self.x2 - rest + far) - far


def radius_of(depth: float) -> float:
    """Choose the radius in m of balls that go this deep: a power of two, `RADIUS_OVER_DEPTH` fold or more.

    A power of two, so that the places at which the balls only just touch, one and three radii above the
    table, are exact: whether a contact shows in the first step is then the same at any scale, and not
    rounding's to say.
    """
    return 2.0 ** math.ceil(math.log2(RADIUS_OVER_DEPTH * depth))


#: Why an engine cannot take what double precision has no numbers for.
BEYOND = (
    "periods, penetrations or energies beyond double precision; scale stiffnesses, masses or v0 (Theorem 5)"
)


def unrepresentable(collision: Collision) -> str | None:
    """Why no contact of spring and dashpot represents this collision, in one sentence; None if one does."""
    for i, k, e in ((1, collision.k1, collision.e1), (2, collision.k2, collision.e2)):
        if k == 0 or math.isinf(k):
            return (
                f"k{i} = {k!r} N/m: a contact of spring and dashpot needs a finite stiffness > 0; "
                "take a large or small finite k2/k1, or the state-transition model, which knows the limit"
            )
        if e == 0:
            return (
                f"e{i} = 0: no finite damping makes a dashpot perfectly plastic; "
                "take a small positive e, or the state-transition model, which knows the limit"
            )
    return None


def shorter_period(collision: Collision) -> float:
    """Give the shorter of the periods 2 pi sqrt(M_i/k_i) of the contacts of any collision, in s.

    0 if a contact is rigid. One without stiffness has an infinite period, and the other's is the shorter.
    """
    c = collision
    omega = max(math.sqrt(c.k1 / c.reduced_mass), math.sqrt(c.k2 / c.m2))
    return 2 * math.pi / omega if omega > 0 else math.inf


def column_of(collision: Collision, settings: Settings) -> Column:
    """Set a collision up as a column, at the time step and in the scenario of the settings.

    The step is `settings.step_fraction` of the shorter of the periods 2 pi sqrt(M_i/k_i) *asked for*,
    whatever the mapping makes of them.
    """
    contact1, contact2 = contacts(collision, settings.mapping)
    drop = settings.scenario == "drop"
    return Column(
        m1=collision.m1,
        m2=collision.m2,
        contact1=contact1,
        contact2=contact2,
        mapping=settings.mapping,
        gravity=settings.gravity if drop else 0.0,
        settled=drop,
        x1=0.0,
        x2=0.0,
        v1=collision.v0,
        v2=0.0,
        step=float(settings.step_fraction * min(contact1.period, contact2.period)),
    )
