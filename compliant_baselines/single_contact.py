"""The contact asked for between two bodies, and the largest step at which an engine gives it (docs/mapping.md).

Restitution and duration of a Kelvin-Voigt contact do not depend on the speed. In an engine they depend on the step, and
on where within a step the bodies touch. The restitution does because the first force comes late, and the duration
because a user counts it in whole steps. A step is good if both are within the tolerance wherever within the step the
bodies touch, and if the shorter steps that are tried are good too.

MuJoCo and PyBullet run the printed text and nothing else (`pasted_drops`). Drake runs the scenes of its adapter, which
have the numbers of the text.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scanner import RunEnd
from impact_xval.compliant_baselines.engines.scene import Scene, radius_of
from impact_xval.compliant_baselines.engines.stepping import Run
from impact_xval.compliant_baselines.mapping import KelvinVoigtContact
from impact_xval.compliant_baselines.paste import paste
from impact_xval.compliant_baselines.pasted_drops import (
    drop_in_mujoco,
    drop_in_pybullet,
    drop_on_flat_in_pybullet,
)
from impact_xval.compliant_baselines.restitution import contact_time, damping_ratio
from impact_xval.compliant_baselines.solver import SolverError
from impact_xval.model.inputs import Legal
from impact_xval.model.materials import MaterialContact

#: Allowed relative error of restitution and duration.
TOLERANCE = 0.01

#: Rounding of such an error; 99 steps of 0.001 s for a duration of 0.1 s are on the edge.
ROUNDING = 1e-9

#: Share of a step just after its start. At the start itself rounding decides whether it is the start or the end.
END = 1e-8

#: Places within a step at which the touch is tried: just after its start, just before its end, and evenly spaced.
PLACES = (END, *(np.arange(1, 31) / 31).tolist(), 1 - END)

#: The places that are tried to look for a step.
FEW_PLACES = (*PLACES[:-1:7], PLACES[-1])

#: How often the distance of places is halved around the least and the greatest restitution between the two ends.
#: Restitution is a continuous function of the place, made of straight pieces whose corners lie anywhere.
HALVINGS = 8

#: Most steps in a contact that are tried.
MOST_STEPS = 200_000

#: Digits of the steps that are tried: R10 of the preferred numbers.
DIGITS = (80, 60, 50, 40, 30, 25, 20, 15, 12, 10)

#: The steps that are tried, in s, from the longest down.
STEPS = [float(f"{digits}e{power}") for power in range(3, -324, -1) for digits in DIGITS]

#: Legal ranges. Beyond them positions or velocities of a drop are lost in rounding, or its end is never reached.
_MASSES = Legal("masses", 1e-15, 1e15, "from 1e-15 to 1e+15 (kg), one of them inf for a fixed body")
_RESTITUTION = Legal("restitution", 1e-4, 1.0, "from 0.0001 to 1")
_SPEED = Legal("speed", 1e-9, 1e9, "from 1e-09 to 1e+09 (m/s)")
_STIFFNESS, _DURATION = (
    Legal(name, math.ulp(0.0), sys.float_info.max, f"a finite number > 0 ({unit})")
    for name, unit in (("stiffness", "N/m"), ("duration", "s"))
)

#: Largest ratio of two masses.
LARGEST_RATIO = 1e12

#: Longest contact in s.
LONGEST = 1e6

#: Functions that run the text to paste for an engine by itself. A step is looked for by the first function of an
#: engine, and the intervals hold for all of them.
DROP = {"mujoco": [drop_in_mujoco], "pybullet": [drop_in_pybullet, drop_on_flat_in_pybullet]}

#: Number of shorter steps that have to be good too, down to 0.4 of the step that is named.
SHORTER = 4


@dataclass(frozen=True, slots=True)
class Pair:
    """Two bodies and the contact asked for between them.

    Raises
    ------
    ValueError
        If a value is illegal; the message names the field, the value and the legal range.
    """

    #: In kg; one of them may be infinite, a fixed body.
    masses: tuple[float, float]
    #: From 1e-4 to 1: no finite damping gives 0.
    restitution: float
    #: In N/m; None if the duration is given.
    stiffness: float | None = None
    #: From touch to the end of the force, in s; None if the stiffness is given.
    duration: float | None = None
    #: Speed of approach in m/s; it decides how deep the bodies go, and whether an engine can take the contact.
    speed: float = 1.0
    #: The contact asked for.
    contact: KelvinVoigtContact = field(init=False)

    def __post_init__(self) -> None:
        if len(self.masses) != 2:
            raise ValueError(f"masses = {self.masses!r}; legal: two")
        light, heavy = sorted(self.masses)
        if light == math.inf:
            raise ValueError("masses = inf inf: two fixed bodies do not collide; legal: at most one inf")
        both = (_STIFFNESS, self.stiffness), (_DURATION, self.duration)
        decisive = [(legal, value) for legal, value in both if value is not None]
        if len(decisive) != 1:
            given = "both" if decisive else "neither"
            raise ValueError(
                f"stiffness or duration: {given} given; legal: one of the two, which decides the other"
            )
        masses = [(_MASSES, mass) for mass in self.masses if mass != math.inf]
        for legal, value in (*masses, (_RESTITUTION, self.restitution), (_SPEED, self.speed), *decisive):
            if not legal.includes(value):
                raise ValueError(f"{legal.name} = {value!r}; legal: {legal.text}")
        if LARGEST_RATIO < heavy / light < math.inf:
            raise ValueError(
                f"masses = {self.masses!r}: one is {heavy / light:.3g} times the other; "
                f"legal: at most {LARGEST_RATIO:g} times, or inf for a fixed body"
            )
        ((legal, value),) = decisive
        k = value
        if legal is _DURATION:
            rate = contact_time(damping_ratio(self.restitution)) / value
            k = self.mass * rate * rate
        if 0 < k < math.inf:
            contact = KelvinVoigtContact.from_restitution(k, self.restitution, self.mass)
        else:
            contact = KelvinVoigtContact(k, math.nan if k == 0 else math.inf, self.mass)
        if not (0 < contact.k < math.inf and 0 < contact.omega < math.inf and contact.c < math.inf):
            raise ValueError(
                f"{legal.name} = {value!r}: no stiffness within double precision gives it to a reduced "
                f"mass of {self.mass:.6g} kg (k = {contact.k:.6g} N/m, c = {contact.c:.6g} N s/m)"
            )
        if contact.duration > LONGEST:
            raise ValueError(
                f"{legal.name} = {value!r}: a contact of {contact.duration:.3g} s; legal: at most {LONGEST:g} s"
            )
        object.__setattr__(self, "contact", contact)

    @property
    def fixed(self) -> bool:
        """Whether one of the bodies is fixed."""
        return math.inf in self.masses

    @property
    def mass(self) -> float:
        """Reduced mass in kg."""
        small, large = sorted(self.masses)
        return small / (1 + small / large)

    @property
    def penetration(self) -> float:
        """Greatest penetration in m, at the speed of this pair: after half its duration, decayed by sqrt(e)."""
        return self.speed * math.sqrt(self.restitution) / self.contact.omega


def make_pair(
    masses: tuple[float, float] | None,
    restitution: float | None,
    stiffness: float | None,
    duration: float | None,
    speed: float,
    materials: Sequence[str] = (),
    radii: Sequence[float] = (),
) -> tuple[Pair, MaterialContact | None]:
    """Make a pair from numbers, or from two bodies of materials, whose contact is linearised at the speed.

    A number that is not given is None; an explicit restitution overrides the materials'. A ValueError names the
    argument, the value and the legal range.
    """
    if not (materials or radii):
        if masses is None or restitution is None:
            missing = "masses" if masses is None else "restitution"
            raise ValueError(f"{missing}: not given; legal: a value, or materials and radii")
        return Pair(masses, restitution, stiffness, duration, speed), None
    for name, given in (("masses", masses), ("stiffness", stiffness), ("duration", duration)):
        if given is not None:
            raise ValueError(f"{name}: given beside materials or radii, which decide it; legal: one of both")
    touch = MaterialContact.of(materials, radii)
    e = touch.restitution if restitution is None else restitution
    return Pair((touch.upper.mass, touch.lower.mass), e, touch.linear(speed), speed=speed), touch


class Drops(NamedTuple):
    """The results of drops that touch at different places within a step."""

    #: In s.
    step: float
    #: Least and greatest.
    restitution: tuple[float, float]
    #: Least and greatest, in s: whole steps from the first to the last with force.
    duration: tuple[float, float]
    #: Number of drops.
    n: int

    def error(self, pair: Pair) -> float:
        """Return the greatest relative error of restitution and duration."""
        ratios = [e / pair.restitution for e in self.restitution]
        ratios += [duration / pair.contact.duration for duration in self.duration]
        return max(abs(ratio - 1) for ratio in ratios)


def drop_at_places(engine: Engine, pair: Pair, step: float, places: Sequence[float]) -> Drops:
    """Drop a pair in an engine, once for every place of the touch within a step, from 0 to 1."""
    return _summarise(step, measure_drops(engine, pair, step, places))


def measure_drops(
    engine: Engine, pair: Pair, step: float, places: Sequence[float], kind: int = 0
) -> list[tuple[float, float]]:
    """Return restitution and duration in s for every place of the touch within a step.

    `kind` is the position of a function in `DROP`. A SolverError says that the engine refuses the contact, or how a
    drop failed.
    """
    adapted = scenes_of(pair, step, places)
    refused = engine.refusal(adapted[0])
    if refused is not None:
        raise SolverError(engine.name, "unrepresentable", refused)
    most = 10 * math.ceil(pair.contact.duration / step) + 100
    if engine.name not in DROP:
        return [_result_of(engine.name, pair, run) for run in engine.run(adapted, most)]
    text, gaps = paste(engine.name, pair.contact, step), [place * pair.speed * step for place in places]
    light, heavy = sorted(pair.masses)
    drop, radius = DROP[engine.name][kind], radius_of(pair.penetration)
    results = drop(text, (light, heavy), radius, pair.speed, gaps, most)
    return [(restitution, steps * step) for restitution, steps in results]


def find_extremes(engine: Engine, pair: Pair, step: float) -> Drops:
    """Drop at all `PLACES` by all functions of `DROP`, and close in on the least and the greatest restitution."""
    kinds = range(len(DROP[engine.name])) if engine.name in DROP else range(1)
    return _summarise(step, [drop for kind in kinds for drop in _extremes(engine, pair, step, kind)])


def _extremes(engine: Engine, pair: Pair, step: float, kind: int) -> list[tuple[float, float]]:
    """Return the restitution and duration of all drops of one kind."""
    results = dict(zip(PLACES, measure_drops(engine, pair, step, PLACES, kind), strict=True))
    for _ in range(HALVINGS):
        places = sorted(results)
        least, greatest = (pick(results, key=lambda place: results[place][0]) for pick in (min, max))
        closer: set[float] = set()
        for i in (places.index(least), places.index(greatest)):
            if 0 < i < len(places) - 1:
                closer |= {0.5 * (places[i] + places[i - 1]), 0.5 * (places[i] + places[i + 1])}
        if not closer:
            break
        added = sorted(closer)
        results |= dict(zip(added, measure_drops(engine, pair, step, added, kind), strict=True))
    return list(results.values())


def _summarise(step: float, results: Sequence[tuple[float, float]]) -> Drops:
    """Keep the least and the greatest of restitutions and durations."""
    restitution, duration = ((min(values), max(values)) for values in zip(*results, strict=True))
    return Drops(step, restitution, duration, len(results))


def scenes_of(pair: Pair, step: float, places: Sequence[float]) -> list[Scene]:
    """Set two balls on a table up for each place of the touch within a step, so that one contact alone takes part.

    Every scene is one of a collision: the code that is tested is the code that is run. The start of the balls keeps the
    other contact out of the way. If one body is fixed, B2 meets the table while B1 leaves upwards at twice the speed.
    If both are free, B1 meets B2 in a frame that rises at twice the speed, high above the table.
    """
    (light, heavy), contact, speed = sorted(pair.masses), pair.contact, pair.speed
    far = 10 * speed * contact.period  # out of reach for the contact's whole duration, with room to spare
    return [
        Scene(
            masses=(light, light if pair.fixed else heavy),
            velocities=(2 * speed, -speed) if pair.fixed else (speed, 2 * speed),
            heights=(far, gap) if pair.fixed else (far + gap, far),
            stiffnesses=(contact.k, contact.k),
            restitutions=(pair.restitution, pair.restitution),
            table=True,
            step=step,
        )
        for gap in (place * speed * step for place in places)
    ]


def _result_of(name: str, pair: Pair, run: Run) -> tuple[float, float]:
    """Return the restitution and the duration in s of a run."""
    if run.end != RunEnd.APART:
        if run.status == "crashed":
            raise SolverError(name, "crashed", run.problem())
        # A collision can be over with both bodies settled on each other, but their contact is not.
        raise SolverError(name, "timeout", f"not over after {run.n_steps} steps, {run.duration:.3g} s")
    upper, lower = run.velocities.tolist()
    loaded = np.flatnonzero(run.raw_states.state & (2 if pair.fixed else 1))
    if not loaded.size:
        raise SolverError(name, "unconverged", "no step with force: the bodies passed through each other")
    ends = np.append(run.raw_states.start[1:], run.n_steps)
    steps = int(ends[loaded[-1]] - run.raw_states.start[loaded[0]])
    return (lower if pair.fixed else upper - lower) / pair.speed, steps * run.scene.step


def find_largest_step(engine: Engine, pair: Pair) -> Drops:
    """Find the largest of `STEPS` at which a contact is the one asked for, at the next shorter ones too.

    A SolverError says that the engine is missing or refuses the contact, or that no step is good.
    """
    reason = engine.unavailable()
    if reason is not None:
        raise SolverError(engine.name, "unavailable", reason)
    # A count of whole steps is off by up to one step: a step longer than the tolerance could be good only by luck.
    longest, shortest = pair.contact.duration * TOLERANCE, pair.contact.duration / MOST_STEPS
    why = f"{MOST_STEPS} steps tell no duration as exactly as that"
    good: list[float] = []  # one after the other, the largest first
    for step in (step for step in STEPS if shortest <= step <= longest):
        try:
            _good_drops(engine, pair, step, FEW_PLACES)
            good.append(step)
            if len(good) > SHORTER:
                return _check_tolerance(engine, pair, find_extremes(engine, pair, good.pop(0)))
        except SolverError as failed:
            if failed.status == "unrepresentable":
                raise
            why = failed.reason
            if step not in good:
                good.clear()
    reason = f"no step from {longest:.2g} s to {shortest:.2g} s gives restitution and duration within {TOLERANCE:g}"
    raise SolverError(engine.name, "unconverged", f"{reason}: {why}")


def measure_largest_step(engine: Engine, pair: Pair) -> tuple[Drops, Drops]:
    """Drop a pair at the largest good step, at all places of the touch, and once at a tenth of that step."""
    largest = find_largest_step(engine, pair)
    return largest, drop_at_places(engine, pair, largest.step / 10, [END])


def _good_drops(engine: Engine, pair: Pair, step: float, places: Sequence[float]) -> Drops:
    """Drop a pair at places of a step; a SolverError if a result is outside the tolerance."""
    # A bad step mostly shows at the first place.
    _check_tolerance(engine, pair, drop_at_places(engine, pair, step, places[:1]))
    return _check_tolerance(engine, pair, drop_at_places(engine, pair, step, places))


def _check_tolerance(engine: Engine, pair: Pair, results: Drops) -> Drops:
    """Return drops that are within the tolerance; else raise a SolverError."""
    if (error := results.error(pair)) > TOLERANCE - ROUNDING:
        raise SolverError(
            engine.name, "unconverged", f"at the last step tried one of them is off by {error:.2g}"
        )
    return results
