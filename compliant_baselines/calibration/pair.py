"""Two bodies and the contact asked for between them: restitution, and stiffness or duration.

The contact is Kelvin and Voigt's, F = max(0, k delta + c delta'), between two bodies of which nothing else acts
on either while it lasts. Then (docs/theory.md, section 7; Schwager and Poeschel, Granular Matter 9:465, 2007), with M
the reduced mass, omega = sqrt(k/M) and zeta the damping ratio that gives e,

* it lasts T = contact_time(zeta)/omega, so that k = M (contact_time(zeta)/T)^2 for a duration asked for;
* it goes in by |v| sqrt(e)/omega at most: delta peaks after exactly half of T, and decays by sqrt(e) until then.

Neither restitution nor duration depends on the speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

from impact_xval.compliant_baselines.contact.mapping import Contact, contact_time, damping_ratio


@dataclass(frozen=True, slots=True)
class Pair:
    """What is asked of one contact between two bodies.

    Parameters
    ----------
    masses : tuple of float
        Of the two bodies in kg; one of them may be infinite, a fixed body.
    restitution : float
        Coefficient of restitution, greater than 0, at most 1.
    stiffness : float, optional
        In N/m.
    duration : float, optional
        From touch to the end of the force, in s; instead of the stiffness.
    speed : float
        Speed of approach in m/s; it decides how deep the bodies go, and what an engine can take.

    Raises
    ------
    ValueError
        For an illegal value; the message names the field, the value and the legal range.
    """

    masses: tuple[float, float]
    restitution: float
    stiffness: float | None = None
    duration: float | None = None
    speed: float = 1.0

    def __post_init__(self) -> None:
        if len(self.masses) != 2:
            raise ValueError(f"masses = {self.masses!r}; legal: two")
        for mass in self.masses:
            _require("masses", mass, mass > 0, "numbers > 0 (kg), one of them inf for a fixed body")
        if all(map(math.isinf, self.masses)):
            raise ValueError("masses = inf inf: two fixed bodies do not collide; legal: at most one inf")
        e = self.restitution
        why = (
            " (no finite damping gives 0)"
            if e == 0
            else " (a contact of spring and dashpot creates no energy)"
        )
        _require("restitution", e, 0 < e <= 1, "greater than 0, at most 1" + why * (e == 0 or e > 1))
        _require("speed", self.speed, 0 < self.speed < math.inf, "a finite number > 0 (m/s)")
        if (self.stiffness is None) == (self.duration is None):
            given = "neither" if self.stiffness is None else "both"
            raise ValueError(
                f"stiffness, duration: {given} given; legal: one of the two, which decides the other"
            )
        if self.stiffness is not None:
            _require("stiffness", self.stiffness, 0 < self.stiffness < math.inf, "a finite number > 0 (N/m)")
        else:
            T = self.duration
            _require("duration", T, T is not None and 0 < T < math.inf, "a finite number > 0 (s)")
        contact = self.contact
        if not (0 < contact.k < math.inf and 0 < contact.omega < math.inf and contact.c < math.inf):
            name = "duration" if self.stiffness is None else "stiffness"
            raise ValueError(
                f"{name} = {getattr(self, name)!r}: no stiffness within double precision gives it to a reduced "
                f"mass of {self.mass:.6g} kg (k = {contact.k:.6g} N/m, c = {contact.c:.6g} N s/m)"
            )

    @property
    def fixed(self) -> bool:
        """Whether one of the bodies is fixed."""
        return any(map(math.isinf, self.masses))

    @property
    def mass(self) -> float:
        """Reduced mass in kg."""
        small, large = sorted(self.masses)
        return small / (1 + small / large)

    @property
    def contact(self) -> Contact:
        """The contact asked for."""
        k = self.stiffness
        if k is None:
            assert self.duration is not None
            rate = contact_time(damping_ratio(self.restitution)) / self.duration
            k = self.mass * rate * rate
            if not 0 < k < math.inf:
                return Contact(k, math.nan if k == 0 else math.inf, self.mass)
        return Contact.from_restitution(k, self.restitution, self.mass)

    @property
    def penetration(self) -> float:
        """Greatest penetration in m, at the speed of this pair."""
        return self.speed * math.sqrt(self.restitution) / self.contact.omega


def _require(name: str, value: object, legal: object, legal_range: str) -> None:
    if isinstance(value, bool) or not isinstance(value, Real) or not legal:
        raise ValueError(f"{name} = {value!r}; legal: {legal_range}")
