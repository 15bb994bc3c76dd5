"""Search for the largest step at which an engine gives two bodies the contact asked for (docs/mapping.md).

Restitution and duration of a Kelvin-Voigt contact do not depend on the speed. In an engine both depend on the step, and
on the instant within a step at which the bodies touch. The restitution depends on them because the first force comes
late, and the duration because a user measures it in whole steps. A step is good if both errors are within the tolerance
wherever within a step the bodies touch. In addition, the next shorter steps that are tried must be good.

MuJoCo and PyBullet run only the printed text (`pasted_drops`). Drake runs the scenes of its adapter, which have the
same parameters as the text.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np

from impact_xval.compliant_baselines.asked_contact import DAMPERS, GRAVITY, SPRINGS, AskedContact
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scanner import RunEnd
from impact_xval.compliant_baselines.engines.scene import Scene, radius_of
from impact_xval.compliant_baselines.engines.stepping import Run
from impact_xval.compliant_baselines.mapping import KelvinVoigtContact, MujocoContact
from impact_xval.compliant_baselines.paste import paste
from impact_xval.compliant_baselines.pasted_drops import (
    drop_in_mujoco,
    drop_in_pybullet,
    drop_on_flat_in_pybullet,
)
from impact_xval.compliant_baselines.solref import ContactMotion, contact_of_solref
from impact_xval.compliant_baselines.solver import SolverError
from impact_xval.model.inputs import Legal
from impact_xval.model.materials import MaterialContact

#: Default of the relative error that is allowed for restitution and duration.
TOLERANCE = 0.01

#: Amount by which rounding may push an error above the tolerance. For example, 99 steps of 0.001 s for a duration of
#: 0.1 s have exactly the default tolerance as their error.
ROUNDING = 1e-9

#: Distance of the first instant of touch that is tried from the start of a step, as a fraction of the step. Exactly at
#: the start, it depends on rounding whether the bodies touch in this step or in the one before.
END = 1e-8

#: Instants of touch that are tried, as fractions of a step, called places below: just after the start of the step, just
#: before its end, and evenly spaced in between.
PLACES = (END, *(np.arange(1, 31) / 31).tolist(), 1 - END)

#: A few of `PLACES`, which are tried while a step is searched for.
FEW_PLACES = (*PLACES[:-1:7], PLACES[-1])

#: Number of times that the spacing of places is halved around the least and the greatest restitution. Restitution is a
#: continuous, piecewise linear function of the place, whose corners may lie anywhere.
HALVINGS = 8

#: Largest number of steps in a contact. No shorter step is tried.
MOST_STEPS = 200_000

#: Leading digits of the steps that are tried: the series R10 of preferred numbers.
DIGITS = (80, 60, 50, 40, 30, 25, 20, 15, 12, 10)

#: The steps in s that are tried, from the longest to the shortest.
STEPS = [float(f"{digits}e{power}") for power in range(3, -324, -1) for digits in DIGITS]

#: Legal masses and speeds. Outside these ranges rounding hides the positions or velocities of a drop, or the drop never
#: ends.
_MASSES = Legal("masses", 1e-15, 1e15, "from 1e-15 to 1e+15 (kg), one of them inf for a fixed body")
_SPEED = Legal("speed", 1e-9, 1e9, "from 1e-09 to 1e+09 (m/s)")

#: Legal range of the allowed error. The least error needs `MOST_STEPS` steps in a contact. At the largest error a
#: contact has three steps.
LEGAL_TOLERANCE = Legal("tolerance", 1e-4, 0.3, "from 0.0001 to 0.3")

#: Largest legal ratio of two finite masses.
LARGEST_RATIO = 1e12

#: For each engine, functions that drop two bodies by the text to paste and nothing else. The search for a step uses the
#: first function. The intervals that are reported cover all of them.
DROP = {"mujoco": [drop_in_mujoco], "pybullet": [drop_in_pybullet, drop_on_flat_in_pybullet]}

#: Legal time steps.
LEGAL_STEP = Legal("step", 1e-12, 1e3, "from 1e-12 to 1000 (s)")

#: Number of durations that are tried for each factor of ten, in the search for the stiffest contact for a given step.
PER_DECADE = 40

#: A given step and shorter steps, as fractions of the given step. A contact must be good at all of them.
SHORTER_STEPS = (1.0, 0.8, 0.63, 0.5, 0.4)

#: Largest number of steps in a contact that are tried for a given step.
MOST_STEPS_OF_STIFFEST = 5_000

#: Number of next shorter steps that must also be good. The shortest of them is 0.4 times the step that is found.
SHORTER = 4


@dataclass(frozen=True, slots=True)
class SingleImpact:
    """Two bodies and the contact asked for between them.

    The contact is given by the quantities of `AskedContact`, or by a solref of MuJoCo.

    Raises
    ------
    ValueError
        If a value is illegal; the message names the field, the value and the legal range.
    """

    #: Masses in kg. One of them may be infinite, for a fixed body.
    masses: tuple[float, float]
    restitution: float | None = None
    #: Stiffness in N/m.
    stiffness: float | None = None
    #: Time in s from the first touch to the end of the force.
    duration: float | None = None
    #: Speed of approach in m/s. The depth of the contact depends on it, and so does whether an engine can take the
    #: contact.
    speed: float = 1.0
    #: Damping in N s/m.
    damping: float | None = None
    damping_ratio: float | None = None
    #: Depth in m at which the contact carries `load` at rest.
    sink: float | None = None
    #: A solref and solimp of MuJoCo, given in place of all quantities for spring and damping.
    solref: MujocoContact | None = None
    #: Mass in kg whose weight the contact carries at rest; None: the mass of the lighter body.
    load: float | None = None
    #: Spring and dashpot of the contact. With `solref` they have the same restitution and duration as the solref at
    #: this speed.
    contact: KelvinVoigtContact = field(init=False)
    #: Restitution, duration and depth of the two bodies alone, without gravity, at a step of zero.
    motion: ContactMotion = field(init=False)

    def __post_init__(self) -> None:
        _require_legal_masses(self.masses)
        if not _SPEED.includes(self.speed):
            raise ValueError(f"speed = {self.speed!r}; legal: {_SPEED.text}")
        quantities = {legal.name: getattr(self, legal.name) for legal in (*DAMPERS, *SPRINGS)}
        if self.solref is None:
            asked = AskedContact(**quantities)
            contact = asked.contact(self.mass, self.carried)
            e = contact.restitution if self.restitution is None else self.restitution
            # The greatest depth is that of an undamped contact times sqrt(e), the decay over half the duration
            # (docs/theory.md, section 7).
            motion = ContactMotion(e, contact.duration, self.speed * math.sqrt(e) / contact.omega)
        else:
            for name, value in quantities.items():
                if value is not None:
                    raise ValueError(
                        f"{name} = {value!r}: given beside solref, which decides it; legal: one of both"
                    )
            contact, motion = contact_of_solref(self.solref, self.mass, self.speed)
        object.__setattr__(self, "contact", contact)
        object.__setattr__(self, "motion", motion)

    @classmethod
    def of(
        cls, masses: tuple[float, float], asked: AskedContact, speed: float = 1.0, load: float | None = None
    ) -> SingleImpact:
        """Make the pair of two bodies with masses in kg from the quantities that a user has asked for."""
        return cls(
            masses,
            asked.restitution,
            asked.stiffness,
            asked.duration,
            speed,
            damping=asked.damping,
            damping_ratio=asked.damping_ratio,
            sink=asked.sink,
            load=load,
        )

    @property
    def fixed(self) -> bool:
        """True if one of the bodies is fixed."""
        return math.inf in self.masses

    @property
    def mass(self) -> float:
        """Reduced mass of the two bodies in kg."""
        small, large = sorted(self.masses)
        return small / (1 + small / large)

    @property
    def carried(self) -> float:
        """Mass in kg whose weight the contact carries at rest."""
        return min(self.masses) if self.load is None else self.load

    @property
    def penetration(self) -> float:
        """Greatest depth in m of the contact at the speed of approach of this pair."""
        return self.motion.depth

    @property
    def depth_at_rest(self) -> float:
        """Depth in m of the contact at rest, under the weight of `carried` with the gravity `GRAVITY`."""
        if self.solref is None:
            return self.carried * GRAVITY / self.contact.k
        return self.solref.equilibrium_depth(self.carried * GRAVITY / self.mass)


def _require_legal_masses(masses: Sequence[float]) -> None:
    """Raise a ValueError unless both masses in kg are legal; at most one mass may be infinite."""
    if len(masses) != 2:
        raise ValueError(f"masses = {masses!r}; legal: two")
    light, heavy = sorted(masses)
    if light == math.inf:
        raise ValueError("masses = inf inf: two fixed bodies do not collide; legal: at most one inf")
    for mass in masses:
        if mass != math.inf and not _MASSES.includes(mass):
            raise ValueError(f"masses = {mass!r}; legal: {_MASSES.text}")
    if LARGEST_RATIO < heavy / light < math.inf:
        raise ValueError(
            f"masses = {masses!r}: one is {heavy / light:.3g} times the other; "
            f"legal: at most {LARGEST_RATIO:g} times, or inf for a fixed body"
        )


def bodies_of_contacts(masses: Sequence[float]) -> list[tuple[tuple[float, float], float | None]]:
    """Return the two masses of each contact of two or three bodies in a line, and the mass that it carries; in kg.

    If the third body is fixed, the other two bodies stand on it, one upon the other. Otherwise the carried mass is
    given as None, which stands for the mass of the contact's lighter body. A ValueError names the illegal value.
    """
    if len(masses) == 2:
        return [((masses[0], masses[1]), None)]
    first, second, third = masses
    if math.isinf(first) or math.isinf(second):
        text = " ".join(f"{mass:g}" for mass in masses)
        raise ValueError(f"masses = {text}: of three bodies only the last one may be fixed; legal: inf last")
    loads = (first, first + second) if math.isinf(third) else (None, None)
    return [((first, second), loads[0]), ((second, third), loads[1])]


def make_pair(
    masses: tuple[float, float] | None,
    restitution: float | None,
    stiffness: float | None,
    duration: float | None,
    speed: float,
    materials: Sequence[str] = (),
    radii: Sequence[float] = (),
) -> tuple[SingleImpact, MaterialContact | None]:
    """Make a pair from given quantities, or from two bodies of given materials.

    The contact of given materials is linearised at the speed of approach.

    A number that is not given is None. An explicit restitution overrides the restitution of the materials. A ValueError
    names the argument, the value and the legal range.
    """
    if not (materials or radii):
        if masses is None:
            raise ValueError("masses: not given; legal: a value, or materials and radii")
        return SingleImpact(masses, restitution, stiffness, duration, speed), None
    for name, given in (("masses", masses), ("stiffness", stiffness), ("duration", duration)):
        if given is not None:
            raise ValueError(f"{name}: given beside materials or radii, which decide it; legal: one of both")
    touch = MaterialContact.of(materials, radii)
    e = touch.restitution if restitution is None else restitution
    return SingleImpact((touch.upper.mass, touch.lower.mass), e, touch.linear(speed), speed=speed), touch


#: Numbers that a drop yields, for example restitution and duration in s.
Numbers = TypeVar("Numbers", bound=tuple[float, ...])


class Drops(NamedTuple):
    """Results of drops whose bodies touch at different instants within a step."""

    #: Time step in s.
    step: float
    #: Least and greatest restitution of the drops.
    restitution: tuple[float, float]
    #: Least and greatest duration in s of the drops: the whole steps from the first step with force to the last.
    duration: tuple[float, float]
    #: Number of drops.
    n: int

    def error(self, pair: SingleImpact) -> float:
        """Return the greatest relative error of restitution and duration, compared with the contact asked for."""
        right = pair.motion
        ratios = [e / right.restitution for e in self.restitution]
        ratios += [duration / right.duration for duration in self.duration]
        return max(abs(ratio - 1) for ratio in ratios)


def drop_at_places(engine: Engine, pair: SingleImpact, step: float, places: Sequence[float]) -> Drops:
    """Drop a pair in an engine, once for each place, and return the least and greatest results.

    A place is the instant of touch within a step, as a fraction of the step.
    """
    return _summarise(step, measure_drops(engine, pair, step, places))


def measure_drops(
    engine: Engine, pair: SingleImpact, step: float, places: Sequence[float], kind: int = 0
) -> list[tuple[float, float]]:
    """Drop a pair once for each place, and return the restitution and the duration in s of each drop.

    A place is the instant of touch within a step, as a fraction of the step. `kind` is the position of a function in
    `DROP`. A SolverError says that the engine refuses the contact, or how a drop failed.
    """
    adapted = scenes_of(pair, step, places)
    refused = engine.refusal(adapted[0])
    if refused is not None:
        raise SolverError(engine.name, "unrepresentable", refused)
    most = 10 * math.ceil(pair.motion.duration / step) + 100
    if engine.name not in DROP:
        return [_result_of(engine.name, pair, run) for run in engine.run(adapted, most)]
    text = paste(engine.name, pair.contact, step, pair.solref)
    gaps = [place * pair.speed * step for place in places]
    light, heavy = sorted(pair.masses)
    drop, radius = DROP[engine.name][kind], radius_of(pair.penetration)
    results = drop(text, (light, heavy), radius, pair.speed, gaps, most)
    return [(restitution, steps * step) for restitution, steps in results]


def find_extremes(engine: Engine, pair: SingleImpact, step: float) -> Drops:
    """Drop a pair at all `PLACES` by all functions of `DROP`, and return the least and greatest results.

    More places are tried near the least and the greatest restitution.
    """
    drops: list[tuple[float, float]] = []
    for kind in range(len(DROP.get(engine.name, [None]))):
        measure = partial(measure_drops, engine, pair, step, kind=kind)
        drops += extremes_over_places(measure, components=[0])
    return _summarise(step, drops)


def extremes_over_places(
    measure: Callable[[Sequence[float]], Sequence[Numbers]], components: Sequence[int]
) -> list[Numbers]:
    """Measure at all `PLACES` and at more places near the extremes, and return all measurements.

    A place is the instant of touch within a step, as a fraction of the step. `measure` returns one tuple of measured
    values for each place. `components` are positions in this tuple. For these components the least and greatest values
    are searched for.
    """
    results = dict(zip(PLACES, measure(PLACES), strict=True))
    for _ in range(HALVINGS):
        places = sorted(results)
        closer: set[float] = set()
        for component in components:
            least, greatest = (
                pick(places, key=lambda place: results[place][component]) for pick in (min, max)
            )
            for i in (places.index(least), places.index(greatest)):
                if 0 < i < len(places) - 1:
                    closer |= {0.5 * (places[i] + places[i - 1]), 0.5 * (places[i] + places[i + 1])}
        if not closer:
            break
        added = sorted(closer)
        results |= dict(zip(added, measure(added), strict=True))
    return list(results.values())


def _summarise(step: float, results: Sequence[tuple[float, float]]) -> Drops:
    """Return the least and the greatest of restitutions and durations, given as one tuple for each drop."""
    restitution, duration = ((min(values), max(values)) for values in zip(*results, strict=True))
    return Drops(step, restitution, duration, len(results))


def scenes_of(pair: SingleImpact, step: float, places: Sequence[float]) -> list[Scene]:
    """Return for each place a scene of two balls on a table in which only one contact takes part.

    A place is the instant of touch within a step, as a fraction of the step. The scenes are made like those of
    collisions. So the drops test the code that also runs collisions. The start keeps the other contact out of the way.
    If one body is fixed, B2 meets the table while B1 leaves upwards at twice the speed. If both are free, B1 meets B2
    high above the table, and all velocities have twice the speed added upwards.
    """
    (light, heavy), contact, speed = sorted(pair.masses), pair.contact, pair.speed
    # far enough that the other contact stays open until the contact is over, with room to spare
    far = 10 * speed * contact.period
    return [
        Scene(
            masses=(light, light if pair.fixed else heavy),
            velocities=(2 * speed, -speed) if pair.fixed else (speed, 2 * speed),
            heights=(far, gap) if pair.fixed else (far + gap, far),
            stiffnesses=(contact.k, contact.k),
            restitutions=(pair.motion.restitution, pair.motion.restitution),
            table=True,
            step=step,
        )
        for gap in (place * speed * step for place in places)
    ]


def _result_of(name: str, pair: SingleImpact, run: Run) -> tuple[float, float]:
    """Return the restitution and the duration in s of a finished run."""
    if run.end != RunEnd.APART:
        if run.status == "crashed":
            raise SolverError(name, "crashed", run.problem())
        # The run of a collision also ends when both bodies have settled on each other. Their contact is not over then.
        raise SolverError(name, "timeout", f"not over after {run.n_steps} steps, {run.duration:.3g} s")
    upper, lower = run.velocities.tolist()
    loaded = np.flatnonzero(run.raw_states.state & (2 if pair.fixed else 1))
    if not loaded.size:
        raise SolverError(name, "unconverged", "no step with force: the bodies passed through each other")
    ends = np.append(run.raw_states.start[1:], run.n_steps)
    steps = int(ends[loaded[-1]] - run.raw_states.start[loaded[0]])
    return (lower if pair.fixed else upper - lower) / pair.speed, steps * run.scene.step


def find_largest_step(engine: Engine, pair: SingleImpact, tolerance: float = TOLERANCE) -> Drops:
    """Find the largest of `STEPS` at which an engine gives the contact asked for, and return its drops at this step.

    The next shorter steps must give this contact too. A SolverError says that the engine is missing or refuses the
    contact, or that no step is good.
    """
    _require_available(engine)
    # The number of steps in a contact is off by at most one. So a step that is longer than the tolerance times the
    # duration could be good only by luck.
    longest, shortest = pair.motion.duration * tolerance, pair.motion.duration / MOST_STEPS
    why = f"even with {MOST_STEPS} steps a duration is not known to this tolerance"
    good: list[float] = []  # steps that are good, without a gap in `STEPS`, the largest first
    for step in (step for step in STEPS if shortest <= step <= longest):
        try:
            _good_drops(engine, pair, step, FEW_PLACES, tolerance)
            good.append(step)
            if len(good) > SHORTER:
                return _check_tolerance(engine, pair, find_extremes(engine, pair, good.pop(0)), tolerance)
        except SolverError as failed:
            if failed.status == "unrepresentable":
                raise
            why = failed.reason
            if step not in good:
                good.clear()
    reason = f"no step from {longest:.2g} s to {shortest:.2g} s gives restitution and duration within {tolerance:g}"
    raise SolverError(engine.name, "unconverged", f"{reason}: {why}")


def find_stiffest(
    engine: Engine, pair: SingleImpact, step: float, tolerance: float = TOLERANCE
) -> tuple[SingleImpact, Drops]:
    """Find the stiffest contact that an engine computes well at a given step, and return it with its drops.

    Contacts are tried with increasing durations (`PER_DECADE` of them for a factor of ten), with their stiffnesses
    rounded to three digits. The result is the first contact that is good at the given step and at the shorter steps
    (`SHORTER_STEPS`).

    Parameters
    ----------
    engine
        The engine.
    pair
        Two bodies and the quantity that gives their damping. The spring of this pair is ignored.
    step
        Time step in s.
    tolerance
        Allowed relative error of restitution and duration.

    Raises
    ------
    SolverError
        If the engine is missing or refuses the contacts, or if no contact is good.
    """
    _require_available(engine)

    def pair_of(steps: float) -> SingleImpact:
        """Return the pair whose contact lasts this number of steps; its stiffness is rounded down to three digits."""
        lasting = replace(pair, stiffness=None, sink=None, duration=steps * step)
        return replace(lasting, duration=None, stiffness=_round_down(lasting.contact.k))

    steps = [10 ** (i / PER_DECADE) / tolerance for i in range(round(PER_DECADE * math.log10(MOST_STEPS)))]
    why, longest = "", 0.0
    for n in (n for n in steps if n <= MOST_STEPS_OF_STIFFEST):
        try:
            tried = pair_of(n)
        # with the same damping a longer contact has a larger damping ratio, which may be illegal
        except ValueError as illegal:
            why = why or str(illegal)
            break
        longest = tried.motion.duration
        try:
            for factor in SHORTER_STEPS:
                _good_drops(engine, tried, step * factor, FEW_PLACES, tolerance)
            return tried, _check_tolerance(engine, tried, find_extremes(engine, tried, step), tolerance)
        except SolverError as failed:
            if failed.status == "unrepresentable":
                raise
            why = failed.reason
    raise SolverError(
        engine.name,
        "unconverged",
        f"no contact of {step / tolerance:.3g} s to {longest:.3g} s has restitution and duration within {tolerance:g} "
        f"at a step of {step:g} s: {why}",
    )


def _round_down(value: float) -> float:
    """Round a positive number down to three digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.floor(value / unit * (1 + 1e-12)) * unit:.3g}")


class VerifiedContact(NamedTuple):
    """A contact and the results of drops that verify it."""

    pair: SingleImpact
    #: Results of drops at the step that was found or given, over all places of the touch within a step.
    drops: Drops
    #: Result of a drop at a tenth of this step, at one place of the touch.
    fine: Drops


def verify_contacts(
    engine: Engine, pairs: Sequence[SingleImpact], tolerance: float = TOLERANCE
) -> list[VerifiedContact]:
    """Find the largest step that is good for all pairs. Return each pair with the results of drops at this step."""
    found = [find_largest_step(engine, pair, tolerance) for pair in pairs]
    step = min(drops.step for drops in found)
    return [
        _verified(engine, pair, drops if drops.step == step else find_extremes(engine, pair, step))
        for pair, drops in zip(pairs, found, strict=True)
    ]


def verify_stiffest(
    engine: Engine, pairs: Sequence[SingleImpact], step: float, tolerance: float = TOLERANCE
) -> list[VerifiedContact]:
    """Return for each pair the stiffest contact that the engine computes well at a step, with its drops."""
    return [_verified(engine, *find_stiffest(engine, pair, step, tolerance)) for pair in pairs]


def _verified(engine: Engine, pair: SingleImpact, drops: Drops) -> VerifiedContact:
    """Return a pair with the results of its drops, and with a drop at a tenth of the step."""
    return VerifiedContact(pair, drops, drop_at_places(engine, pair, drops.step / 10, [END]))


def _require_available(engine: Engine) -> None:
    """Raise a SolverError if an engine cannot run on this machine."""
    reason = engine.unavailable()
    if reason is not None:
        raise SolverError(engine.name, "unavailable", reason)


def _good_drops(
    engine: Engine, pair: SingleImpact, step: float, places: Sequence[float], tolerance: float
) -> Drops:
    """Drop a pair at places of a step. Return the results, or raise a SolverError if they exceed the tolerance."""
    # Most bad steps already fail at the first place. So this place is tried alone first.
    _check_tolerance(engine, pair, drop_at_places(engine, pair, step, places[:1]), tolerance)
    return _check_tolerance(engine, pair, drop_at_places(engine, pair, step, places), tolerance)


def _check_tolerance(engine: Engine, pair: SingleImpact, results: Drops, tolerance: float) -> Drops:
    """Return results that are within the tolerance; raise a SolverError if they are not."""
    if (error := results.error(pair)) > tolerance - ROUNDING:
        raise SolverError(
            engine.name, "unconverged", f"at the last step tried one of them is off by {error:.2g}"
        )
    return results
