"""What two bodies of a scene make of each other: driven together in their engine, alone, and what came back.

A `Meeting` is a pair of bodies that can touch, with all that its engine knows of their contact: plain values, so that
it can be measured in another process than the one that read the scene. `inspect` lets the two meet along the normal
at one speed, without gravity, at `PLACES` of the touch within a step, and again at half the step: with few steps in a
contact the answer depends on both.

**Measured** are the restitution, the rate at which the bodies part over that at which they met, and the duration, the
steps in which the rate changes. Both are means over the places; over evenly spread ones the mean number of steps is
that of the duration, to one over their number.

**Effective** are the stiffness and the damping of the contact F = max(0, k delta + c delta') that has this restitution
and this duration (Schwager and Poeschel, Granular Matter 9:465, 2007; `contact.restitution_laws`): with M the reduced
mass, zeta = damping_ratio(e), k = M (contact_time(zeta)/T)^2, c = 2 zeta sqrt(k M). The engine's own law may differ. A
contact that is over in fewer than `IMPULSE` steps, at half the step in as many, is an impulse and has neither.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Protocol, TypeAlias

from impact_xval.compliant_baselines.contact.restitution_laws import contact_time, damping_ratio
from impact_xval.compliant_baselines.diagnosis.diagnosis import sentence
from impact_xval.compliant_baselines.practical.practice import QUIET_STEPS, ROUNDING, silent
from impact_xval.model.collision import Status

#: Where in a step the bodies touch: spread evenly, so in order that the first two are far apart.
PLACES = tuple((18 * i % 32 + 1) / 32 for i in range(16))

#: Steps of a contact from which on two places do.
LONG = 250

#: Steps after which a meeting is given up.
MOST_STEPS = 20_000

#: Steps below which a contact may be an impulse, and growth of their number at half the step from which it is none.
IMPULSE, GROWTH = 3, 1.5

#: Relative difference from which a number is said to depend on the step, or on the place within it.
WITHIN = 0.01

#: Restitution below which nothing comes back: no finite damping gives it.
NOTHING = 1e-9


class Alone(Protocol):
    """Two bodies in an engine of their own."""

    def step(self) -> None:
        """Take one step."""
        ...

    def rate(self) -> float:
        """Rate of the gap in m/s, negative while the bodies approach; NaN where the engine warned of its numbers."""
        ...


#: Makes two bodies that approach at a speed in m/s, for a step in s, at a distance at which they touch at a place
#: within the first step, from 0, its start, to 1.
Place: TypeAlias = Callable[[float, float, float], Alone]


@dataclass(frozen=True)
class Meeting(ABC):
    """Two bodies that can touch, and what decides their contact.

    Attributes
    ----------
    where : str
        What they are called.
    masses : tuple of float
        In kg, that of a fixed body infinite.
    step : float
        Of the scene, in s.
    notes : tuple of str
        What to know of the masses, a sentence each.
    """

    where: str
    masses: tuple[float, float]
    step: float
    notes: tuple[str, ...]

    @property
    def mass(self) -> float:
        """Reduced mass in kg; infinite for two fixed bodies."""
        inverse = sum(1 / mass if mass else math.inf for mass in self.masses)
        return 1 / inverse if inverse else math.inf

    def refusal(self) -> str | None:
        """Why these two cannot be driven against each other, in one sentence; None if they can."""
        return None

    @abstractmethod
    def engine(self) -> AbstractContextManager[Place]:
        """Give what makes the two bodies, as often as it is called."""


@dataclass(frozen=True, slots=True)
class Inspected:
    """What a contact of a scene is, as it was measured.

    Attributes
    ----------
    where, masses, mass, step
        Of the `Meeting`.
    speed : float
        At which the bodies met, in m/s.
    status : str
        ``ok``, or why there are no numbers; then those below are None.
    reason : str
        One sentence where the status is not ``ok``.
    restitution : float or None
        At the step, a mean over `PLACES`.
    restitution_range : tuple of float or None
        Least and greatest of them.
    restitution_half_step : float or None
        At half the step; None also where it did not end.
    duration : float or None
        In s, a mean.
    steps : float or None
        In the contact, a mean.
    stiffness, damping : float or None
        Effective, in N/m and N s/m; None for an impulse, and where nothing comes back.
    remarks : tuple of str
        What to know of these numbers, a sentence each.
    """

    where: str
    masses: tuple[float, float]
    mass: float
    step: float
    speed: float
    status: Status = "ok"
    reason: str = ""
    restitution: float | None = None
    restitution_range: tuple[float, float] | None = None
    restitution_half_step: float | None = None
    duration: float | None = None
    steps: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    remarks: tuple[str, ...] = field(default=())


class _LostError(Exception):
    def __init__(self, status: Status, reason: str) -> None:
        super().__init__(reason)
        self.status: Status = status


def kinds(meetings: Iterable[Meeting]) -> list[Meeting]:
    """Name meetings that differ in nothing but their names once, in the order of the first of each kind."""
    names: dict[Meeting, list[str]] = {}
    for meeting in meetings:
        names.setdefault(replace(meeting, where=""), []).append(meeting.where)
    return [
        replace(meeting, where=first + (f" and {len(others)} more" if others else ""))
        for meeting, (first, *others) in names.items()
    ]


def inspect(meeting: Meeting, speed: float = 1.0) -> Inspected:
    """Let two bodies of a scene meet, and describe their contact; what goes wrong is a status.

    Parameters
    ----------
    meeting : Meeting
    speed : float
        In m/s.

    Raises
    ------
    ValueError
        If the speed is not a finite number > 0.
    """
    if isinstance(speed, bool) or not isinstance(speed, Real) or not 0 < speed < math.inf:
        raise ValueError(f"speed = {speed!r}; legal: a finite number > 0 (m/s)")
    refused = meeting.refusal()
    if refused is not None:
        return lost(meeting, speed, "unrepresentable", refused)
    try:
        with silent(), meeting.engine() as make:
            bounces = _bounces(make, speed, meeting.step)
            try:
                halved = _bounces(make, speed, meeting.step / 2)
            except _LostError:  # of twice as many steps
                halved = []
        return _described(meeting, speed, bounces, halved)
    except _LostError as error:
        return lost(meeting, speed, error.status, str(error))
    except Exception as error:  # an engine may raise anything
        return lost(meeting, speed, "crashed", " ".join(str(error).split()) or type(error).__name__)


def lost(meeting: Meeting, speed: float, status: Status, reason: str) -> Inspected:
    """Give the row of a pair without numbers."""
    return Inspected(meeting.where, meeting.masses, meeting.mass, meeting.step, speed, status, reason)


def _bounces(make: Place, speed: float, step: float) -> list[tuple[float, int]]:
    """Restitution, and steps in the contact, at every place of the touch."""
    found: list[tuple[float, int]] = []
    for place in PLACES:
        found.append(_follow(make(speed, step, place), speed))
        if len(found) == 2 and min(steps for _, steps in found) >= LONG:
            break
    return found


def _follow(world: Alone, speed: float) -> tuple[float, int]:
    """Step until the rate no longer changes, and the bodies do not approach."""
    before, first, last = -speed, 0, 0
    for n in range(1, MOST_STEPS + 1):
        world.step()
        rate = world.rate()
        if not math.isfinite(rate):
            raise _LostError("crashed", f"the engine gave no finite velocities after {n} steps")
        if abs(rate - before) > ROUNDING["float64"] * speed:
            first, last = first or n, n
        elif first and n - last >= QUIET_STEPS and rate >= -ROUNDING["float64"] * speed:
            return (rate / speed if abs(rate) > NOTHING * speed else 0.0), last - first + 1
        before = rate
    if not first:
        raise _LostError(
            "unconverged",
            f"no force within {MOST_STEPS} steps: the bodies pass through each other, or never meet",
        )
    raise _LostError("timeout", f"not over after {MOST_STEPS} steps")


def _described(
    meeting: Meeting, speed: float, bounces: list[tuple[float, int]], halved: list[tuple[float, int]]
) -> Inspected:
    e, steps = (sum(values) / len(bounces) for values in zip(*bounces, strict=True))
    low, high = min(e for e, _ in bounces), max(e for e, _ in bounces)
    half = steps_half = None
    if halved:
        half, steps_half = (sum(values) / len(halved) for values in zip(*halved, strict=True))
    duration = steps * meeting.step
    impulse = steps < IMPULSE and steps_half is not None and steps_half < GROWTH * steps
    k = c = None
    if e > NOTHING and not impulse:
        zeta = damping_ratio(min(e, 1.0))
        k = meeting.mass * (contact_time(zeta) / duration) ** 2
        c = 2 * zeta * math.sqrt(k * meeting.mass)
        if not (0 < k < math.inf and c < math.inf):
            raise OverflowError(f"the stiffness leaves double precision: {k:.3g} N/m, {c:.3g} N s/m")
    said = {
        "impulse": impulse,
        "step_decides": half is not None and not _close(e, half),
        "place_decides": not _close(low, high),
        "gains": e > 1 + WITHIN,
    }
    remarks = [sentence("remarks.j2", macro, within=WITHIN) for macro, holds in said.items() if holds]
    return Inspected(
        meeting.where,
        meeting.masses,
        meeting.mass,
        meeting.step,
        speed,
        restitution=e,
        restitution_range=(low, high),
        restitution_half_step=half,
        duration=duration,
        steps=steps,
        stiffness=k,
        damping=c,
        remarks=(*meeting.notes, *remarks),
    )


def _close(one: float, two: float) -> bool:
    """Whether two restitutions are one, to `WITHIN` or to a thousandth of the speed."""
    return math.isclose(one, two, rel_tol=WITHIN, abs_tol=1e-3)
