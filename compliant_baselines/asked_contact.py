"""Spring and dashpot of a contact from two quantities that a user gives: one for the damping, and one for the spring.

The formulas are those of docs/theory.md, section 7. M is the reduced mass of the two bodies, k the stiffness, c the
damping, omega = sqrt(k/M), and zeta = c/(2 M omega) the damping ratio. A contact of two bodies alone has the duration T
= `contact_time`(zeta)/omega and the restitution e = exp(-zeta omega T). Both formulas are true for every zeta >= 0.

* A restitution e gives zeta = `damping_ratio`(e).
* A damping and a duration give e = exp(-c T/(2 M)) without knowing k, because zeta omega = c/(2 M). Then e gives zeta,
  and zeta and T give omega.
* A sink is the depth at which the spring carries a mass m at rest: k = m g/sink.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields

from impact_xval.compliant_baselines.mapping import KelvinVoigtContact
from impact_xval.compliant_baselines.restitution import contact_time, damping_ratio
from impact_xval.model.inputs import Legal

#: Gravity in m/s^2. It gives the weight that a contact carries at rest.
GRAVITY = 9.81

#: Largest legal damping ratio; a contact with this ratio has a restitution of 1e-4. At larger ratios the force becomes
#: smaller than the rounding of velocities before it ends. At a ratio of 200 a drop in MuJoCo therefore shows a duration
#: that is 4 % too short, and at 1000 a duration that is 20 % too short.
LARGEST_DAMPING_RATIO = 50.0

#: Longest legal duration of a contact in s.
LONGEST = 1e6

_LEAST, _LARGEST = math.ulp(0.0), sys.float_info.max

RESTITUTION = Legal("restitution", 1e-4, 1.0, "from 0.0001 to 1")
DAMPING = Legal("damping", 0.0, _LARGEST, "a finite number >= 0 (N s/m)")
DAMPING_RATIO = Legal("damping_ratio", 0.0, LARGEST_DAMPING_RATIO, f"from 0 to {LARGEST_DAMPING_RATIO:g}")
STIFFNESS = Legal("stiffness", _LEAST, _LARGEST, "a finite number > 0 (N/m)")
DURATION = Legal("duration", _LEAST, _LARGEST, "a finite number > 0 (s)")
SINK = Legal("sink", _LEAST, _LARGEST, "a finite number > 0 (m)")

#: Quantities from which the damping follows, and quantities from which the spring follows. A user gives one of the
#: first group and one of the second.
DAMPERS = (RESTITUTION, DAMPING, DAMPING_RATIO)
SPRINGS = (STIFFNESS, DURATION, SINK)

#: The quantities that a user can give for the spring and for the damping, as texts for messages. A spring also follows
#: from a time step: it is the stiffest contact that an engine computes well with this step.
SPRING_NAMES = "stiffness, duration, step or sink"
DAMPER_NAMES = "restitution, damping or damping_ratio"


@dataclass(frozen=True, slots=True)
class AskedContact:
    """The quantities that a user gives for a contact: one for the damping, and one for the spring. All others are None.

    Raises
    ------
    ValueError
        If quantities are missing, contradictory or illegal. The message names the field, the value and the legal range.
    """

    #: Coefficient of restitution, from 1e-4 to 1. A restitution of 0 would need an infinite damping.
    restitution: float | None = None
    #: Damping in N s/m.
    damping: float | None = None
    #: Damping as a fraction of the critical damping 2 sqrt(k M).
    damping_ratio: float | None = None
    #: Stiffness in N/m.
    stiffness: float | None = None
    #: Time in s from the first touch to the end of the force.
    duration: float | None = None
    #: Depth in m at which the contact carries a weight under `GRAVITY`.
    sink: float | None = None

    def __post_init__(self) -> None:
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        _pick_one(given, DAMPERS, DAMPER_NAMES)
        _pick_one(given, SPRINGS, SPRING_NAMES)
        for legal in (*DAMPERS, *SPRINGS):
            value = given[legal.name]
            if value is not None and not legal.includes(value):
                raise ValueError(f"{legal.name} = {value!r}; legal: {legal.text}")

    def contact(self, mass: float, load: float) -> KelvinVoigtContact:
        """Return the contact with the damping and the spring that follow from the given quantities.

        Parameters
        ----------
        mass
            Reduced mass of the two bodies in kg.
        load
            Mass in kg whose weight the contact carries at rest.

        Raises
        ------
        ValueError
            If the contact needs a spring or a dashpot that is outside the legal range or outside double precision.
        """
        decisive = next(legal for legal in SPRINGS if getattr(self, legal.name) is not None)
        value = getattr(self, decisive.name)
        try:
            contact = self._contact(mass, load)
        except (OverflowError, ZeroDivisionError):
            contact = KelvinVoigtContact(math.inf, math.nan, mass)
        if not (0 < contact.k < math.inf and 0 < contact.omega < math.inf and contact.c < math.inf):
            raise ValueError(
                f"{decisive.name} = {value!r}: no stiffness within double precision gives it to a reduced "
                f"mass of {mass:.6g} kg (k = {contact.k:.6g} N/m, c = {contact.c:.6g} N s/m)"
            )
        if contact.zeta > LARGEST_DAMPING_RATIO * (1 + 1e-12):
            raise ValueError(
                f"damping = {self.damping!r} beside {decisive.name} = {value!r}: a damping ratio of "
                f"{contact.zeta:.3g}; legal: at most {LARGEST_DAMPING_RATIO:g}, which returns 1e-4 of the speed"
            )
        if contact.duration > LONGEST:
            raise ValueError(
                f"{decisive.name} = {value!r}: a contact of {contact.duration:.3g} s; legal: at most {LONGEST:g} s"
            )
        return contact

    def _contact(self, mass: float, load: float) -> KelvinVoigtContact:
        """Return the contact without checking it; its stiffness and its damping may be 0 or infinite."""
        if self.damping is None:
            zeta = self.damping_ratio
            if zeta is None:
                assert self.restitution is not None
                zeta = damping_ratio(self.restitution)
            k = stiffness_from_sink(self.sink, load) if self.sink is not None else self.stiffness
            if k is None:
                assert self.duration is not None
                k = stiffness_from_duration(self.duration, zeta, mass)
            return KelvinVoigtContact(k, 2 * zeta * math.sqrt(k) * math.sqrt(mass), mass)
        k = stiffness_from_sink(self.sink, load) if self.sink is not None else self.stiffness
        if k is None:
            assert self.duration is not None
            k = stiffness_from_damping_and_duration(self.damping, self.duration, mass)
        return KelvinVoigtContact(k, self.damping, mass)


def _pick_one(given: dict[str, float | None], group: Sequence[Legal], names: str) -> None:
    """Raise a ValueError if not exactly one quantity of a group is given."""
    present = [legal.name for legal in group if given[legal.name] is not None]
    if not present:
        raise ValueError(f"{names}: none given; legal: one of them; the others follow from it")
    if len(present) > 1:
        values = " and ".join(f"{name} = {given[name]!r}" for name in present)
        raise ValueError(f"{values}: each follows from the other; legal: one of {names}")


def stiffness_from_sink(sink: float, load: float) -> float:
    """Return the stiffness in N/m at which a spring carries a load in kg at a depth `sink` in m."""
    return load * GRAVITY / sink


def stiffness_from_duration(duration: float, zeta: float, mass: float) -> float:
    """Return the stiffness in N/m that gives a contact its duration in s, for a damping ratio and a mass in kg.

    `mass` is the reduced mass of the two bodies.
    """
    omega = contact_time(zeta) / duration
    return mass * omega * omega


def stiffness_from_damping_and_duration(damping: float, duration: float, mass: float) -> float:
    """Return the stiffness in N/m that gives a contact its duration in s, for a damping in N s/m and a mass in kg.

    `mass` is the reduced mass. The restitution follows from damping, duration and mass without the stiffness; the
    module's docstring has the formula. A ValueError says that the restitution would be below 1e-4.
    """
    loss = damping * duration / (2 * mass)
    largest = LARGEST_DAMPING_RATIO * contact_time(LARGEST_DAMPING_RATIO)
    if loss > largest:
        raise ValueError(
            f"damping = {damping!r} beside duration = {duration!r}: a restitution of exp(-{loss:.3g}); legal: at most "
            f"{largest * 2 * mass / duration:.6g} N s/m, which returns 1e-4 of the speed"
        )
    zeta = damping_ratio(math.exp(-loss))
    return stiffness_from_duration(duration, zeta, mass)
