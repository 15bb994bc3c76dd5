"""Search for the largest step at which an engine gives two bodies the contact asked for (docs/mapping.md).

Restitution and duration of a Kelvin-Voigt contact do not depend on the speed. In an engine they depend on the step, and
on the place within a step at which the bodies touch. The restitution depends on them because the first force comes
late, the duration because a user counts it in whole steps. A step is good if both errors are within the tolerance for
every place of the touch, and if the shorter steps that are tried are good too.

MuJoCo and PyBullet run only the printed text (`pasted_drops`). Drake runs the scenes of its adapter, which have the
numbers of the text.
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
from impact_xval.compliant_baselines.solref import Motion, contact_of_solref
from impact_xval.compliant_baselines.solver import SolverError
from impact_xval.model.inputs import Legal
from impact_xval.model.materials import MaterialContact

#: Allowed relative error of restitution and duration by default.
TOLERANCE = 0.01

#: Amount by which rounding may push an error over the tolerance: 99 steps of 0.001 s for a duration of 0.1 s are just
#: at it.
ROUNDING = 1e-9

#: Fraction of a step between its start and the first place that is tried. At the start itself rounding decides whether
#: the touch belongs to this step or to the one before.
END = 1e-8

#: Places of the touch that are tried, as fractions of a step: just after its start, just before its end, and evenly
#: spaced between them.
PLACES = (END, *(np.arange(1, 31) / 31).tolist(), 1 - END)

#: The places of `PLACES` that are tried during the search for a step.
FEW_PLACES = (*PLACES[:-1:7], PLACES[-1])

#: Number of times that the distance of places is halved around the least and the greatest restitution. Restitution is a
#: continuous, piecewise linear function of the place, and its corners may lie anywhere.
HALVINGS = 8

#: Most steps in a contact that are tried.
MOST_STEPS = 200_000

#: Digits of the steps that are tried: the series R10 of preferred numbers.
DIGITS = (80, 60, 50, 40, 30, 25, 20, 15, 12, 10)

#: The steps that are tried, in s, from the longest down.
STEPS = [float(f"{digits}e{power}") for power in range(3, -324, -1) for digits in DIGITS]

#: Legal ranges. Outside them positions or velocities of a drop drown in rounding, or its end is never reached.
_MASSES = Legal("masses", 1e-15, 1e15, "from 1e-15 to 1e+15 (kg), one of them inf for a fixed body")
_SPEED = Legal("speed", 1e-9, 1e9, "from 1e-09 to 1e+09 (m/s)")

#: Legal range of the allowed error. `MOST_STEPS` steps in a contact resolve the least error; with the largest error a
#: contact has three steps.
LEGAL_TOLERANCE = Legal("tolerance", 1e-4, 0.3, "from 0.0001 to 0.3")

#: Largest ratio of two masses.
LARGEST_RATIO = 1e12

#: Functions that run the text to paste, and nothing else, in an engine. The search for a step uses the first function
#: of an engine; the intervals that are reported hold for all of them.
DROP = {"mujoco": [drop_in_mujoco], "pybullet": [drop_in_pybullet, drop_on_flat_in_pybullet]}

#: Legal time steps.
LEGAL_STEP = Legal("step", 1e-12, 1e3, "from 1e-12 to 1000 (s)")

#: Number of durations per decade that are tried for a given step.
PER_DECADE = 40

#: The given step and the shorter steps that have to be good too, as fractions of the given step (see `SHORTER`).
SHORTER_STEPS = (1.0, 0.8, 0.63, 0.5, 0.4)

#: Most steps in a contact that are tried for a given step.
MOST_STEPS_OF_STIFFEST = 5_000

#: Number of shorter steps that have to be good too. The shortest one is 0.4 times the step that is found.
SHORTER = 4


@dataclass(frozen=True, slots=True)
class Pair:
    """Two bodies and the contact asked for between them, given by the numbers of `AskedContact` or by MuJoCo's own.

    Raises
    ------
    ValueError
        If a value is illegal; the message names the field, the value and the legal range.
    """

    #: Masses in kg; one of them may be infinite, which is a fixed body.
    masses: tuple[float, float]
    restitution: float | None = None
    #: Stiffness in N/m.
    stiffness: float | None = None
    #: Time in s from the first touch to the end of the force.
    duration: float | None = None
    #: Speed of approach in m/s; it decides how deep the bodies go, and whether an engine can take the contact.
    speed: float = 1.0
    #: Damping in N s/m.
    damping: float | None = None
    damping_ratio: float | None = None
    #: Depth at rest in m.
    sink: float | None = None
    #: MuJoCo's own numbers, which replace all numbers above.
    solref: MujocoContact | None = None
    #: Mass in kg whose weight the contact carries at rest; None: the mass of the lighter body.
    load: float | None = None
    #: The contact asked for. With `solref` this is the contact that has the same restitution and duration at this
    #: speed.
    contact: KelvinVoigtContact = field(init=False)
    #: Motion of the two bodies alone, without gravity, in the limit of small steps.
    motion: Motion = field(init=False)

    def __post_init__(self) -> None:
        _require_legal_masses(self.masses)
        if not _SPEED.includes(self.speed):
            raise ValueError(f"speed = {self.speed!r}; legal: {_SPEED.text}")
        quantities = {legal.name: getattr(self, legal.name) for legal in (*DAMPERS, *SPRINGS)}
        if self.solref is None:
            asked = AskedContact(**quantities)
            contact = asked.contact(self.mass, self.carried)
            e = contact.restitution if self.restitution is None else self.restitution
            # The greatest depth is the undamped one, decayed by sqrt(e): the decay of half the duration
            # (docs/theory.md, section 7).
            motion = Motion(e, contact.duration, self.speed * math.sqrt(e) / contact.omega)
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
    ) -> Pair:
        """Make the pair of two masses in kg whose contact is asked for."""
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
        """Reduced mass in kg."""
        small, large = sorted(self.masses)
        return small / (1 + small / large)

    @property
    def carried(self) -> float:
        """Mass in kg whose weight the contact carries at rest."""
        return min(self.masses) if self.load is None else self.load

    @property
    def penetration(self) -> float:
        """Greatest penetration in m at the speed of approach of this pair."""
        return self.motion.depth

    @property
    def depth_at_rest(self) -> float:
        """Penetration in m under the weight that the contact carries, at `GRAVITY`."""
        if self.solref is None:
            return self.carried * GRAVITY / self.contact.k
        return self.solref.equilibrium_depth(self.carried * GRAVITY / self.mass)


def _require_legal_masses(masses: Sequence[float]) -> None:
    """Raise a ValueError unless two masses in kg are legal, at most one of them infinite."""
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
    """Return the masses in kg of each contact of two or three bodies in a line, and the mass in kg that it carries.

    If the third body is fixed, the first two stand on it, one upon the other. Otherwise a contact carries the lighter
    body (None). A ValueError names the illegal value.
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
) -> tuple[Pair, MaterialContact | None]:
    """Make a pair from numbers, or from two bodies of given materials; their contact is linearised at the speed.

    A number that is not given is None. An explicit restitution overrides the restitution of the materials. A ValueError
    names the argument, the value and the legal range.
    """
    if not (materials or radii):
        if masses is None:
            raise ValueError("masses: not given; legal: a value, or materials and radii")
        return Pair(masses, restitution, stiffness, duration, speed), None
    for name, given in (("masses", masses), ("stiffness", stiffness), ("duration", duration)):
        if given is not None:
            raise ValueError(f"{name}: given beside materials or radii, which decide it; legal: one of both")
    touch = MaterialContact.of(materials, radii)
    e = touch.restitution if restitution is None else restitution
    return Pair((touch.upper.mass, touch.lower.mass), e, touch.linear(speed), speed=speed), touch


#: The numbers of a drop: restitution, and duration in s.
Numbers = TypeVar("Numbers", bound=tuple[float, ...])


class Drops(NamedTuple):
    """The results of drops that touch at different places within a step."""

    #: Time step in s.
    step: float
    #: Least and greatest restitution.
    restitution: tuple[float, float]
    #: Least and greatest duration in s: whole steps from the first to the last with force.
    duration: tuple[float, float]
    #: Number of drops.
    n: int

    def error(self, pair: Pair) -> float:
        """Return the greatest relative error of restitution and duration."""
        right = pair.motion
        ratios = [e / right.restitution for e in self.restitution]
        ratios += [duration / right.duration for duration in self.duration]
        return max(abs(ratio - 1) for ratio in ratios)


def drop_at_places(engine: Engine, pair: Pair, step: float, places: Sequence[float]) -> Drops:
    """Drop a pair in an engine, once for every place of the touch within a step; places are from 0 to 1."""
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
    most = 10 * math.ceil(pair.motion.duration / step) + 100
    if engine.name not in DROP:
        return [_result_of(engine.name, pair, run) for run in engine.run(adapted, most)]
    text = paste(engine.name, pair.contact, step, pair.solref)
    gaps = [place * pair.speed * step for place in places]
    light, heavy = sorted(pair.masses)
    drop, radius = DROP[engine.name][kind], radius_of(pair.penetration)
    results = drop(text, (light, heavy), radius, pair.speed, gaps, most)
    return [(restitution, steps * step) for restitution, steps in results]


def find_extremes(engine: Engine, pair: Pair, step: float) -> Drops:
    """Drop at all `PLACES` by all functions of `DROP`; search for the least and the greatest restitution."""
    drops: list[tuple[float, float]] = []
    for kind in range(len(DROP.get(engine.name, [None]))):
        measure = partial(measure_drops, engine, pair, step, kind=kind)
        drops += extremes_over_places(measure, components=[0])
    return _summarise(step, drops)


def extremes_over_places(
    measure: Callable[[Sequence[float]], Sequence[Numbers]], components: Sequence[int]
) -> list[Numbers]:
    """Measure at all `PLACES`, then at places ever closer to those with the least and the greatest component.

    `measure` returns one tuple of numbers for each place. `components` are the positions in the tuple of the numbers
    whose extremes are searched for.
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
    """Return the least and the greatest of restitutions and durations."""
    restitution, duration = ((min(values), max(values)) for values in zip(*results, strict=True))
    return Drops(step, restitution, duration, len(results))


def scenes_of(pair: Pair, step: float, places: Sequence[float]) -> list[Scene]:
    """Make a scene of two balls on a table for each place of the touch, in which one contact alone takes part.

    Every scene is the scene of a collision, so that the code that is tested is the code that collisions run. The start
    of the balls keeps the other contact out of the way. If one body is fixed, B2 meets the table while B1 leaves
    upwards at twice the speed. If both are free, B1 meets B2 high above the table, and their velocities are taken in a
    frame that rises at twice the speed.
    """
    (light, heavy), contact, speed = sorted(pair.masses), pair.contact, pair.speed
    far = 10 * speed * contact.period  # out of reach for the contact's whole duration, with room to spare
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


def _result_of(name: str, pair: Pair, run: Run) -> tuple[float, float]:
    """Return the restitution and the duration in s of a run."""
    if run.end != RunEnd.APART:
        if run.status == "crashed":
            raise SolverError(name, "crashed", run.problem())
        # A collision can be over with both bodies settled on each other. Their contact is not over then.
        raise SolverError(name, "timeout", f"not over after {run.n_steps} steps, {run.duration:.3g} s")
    upper, lower = run.velocities.tolist()
    loaded = np.flatnonzero(run.raw_states.state & (2 if pair.fixed else 1))
    if not loaded.size:
        raise SolverError(name, "unconverged", "no step with force: the bodies passed through each other")
    ends = np.append(run.raw_states.start[1:], run.n_steps)
    steps = int(ends[loaded[-1]] - run.raw_states.start[loaded[0]])
    return (lower if pair.fixed else upper - lower) / pair.speed, steps * run.scene.step


def find_largest_step(engine: Engine, pair: Pair, tolerance: float = TOLERANCE) -> Drops:
    """Find the largest of `STEPS` at which an engine gives the contact asked for, also at the next shorter steps.

    A SolverError says that the engine is missing or refuses the contact, or that no step is good.
    """
    _require_available(engine)
    # A count of whole steps is off by up to one step: a step longer than the tolerance times the duration could be good
    # only by luck.
    longest, shortest = pair.motion.duration * tolerance, pair.motion.duration / MOST_STEPS
    why = f"even with {MOST_STEPS} steps a duration is not known to this tolerance"
    good: list[float] = []  # consecutive steps, the largest first
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
    engine: Engine, pair: Pair, step: float, tolerance: float = TOLERANCE
) -> tuple[Pair, Drops]:
    """Find the stiffest contact that a step carries, and drop it at all places of the touch within the step.

    The contacts that are tried have increasing durations (`PER_DECADE`), and stiffnesses of three digits. The first
    contact that is good at this step and at shorter ones (`SHORTER_STEPS`) is the result.

    Parameters
    ----------
    engine
        The engine.
    pair
        Two bodies and the number that decides their damping. The spring of this pair is ignored.
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

    def pair_of(steps: float) -> Pair:
        """Return the pair whose contact lasts a number of steps, with a rounded stiffness."""
        lasting = replace(pair, stiffness=None, sink=None, duration=steps * step)
        return replace(lasting, duration=None, stiffness=_round_down(lasting.contact.k))

    steps = [10 ** (i / PER_DECADE) / tolerance for i in range(round(PER_DECADE * math.log10(MOST_STEPS)))]
    why, longest = "", 0.0
    for n in (n for n in steps if n <= MOST_STEPS_OF_STIFFEST):
        try:
            tried = pair_of(n)
        except ValueError as illegal:  # a longer contact with this damping may be damped too much
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
    """A contact and the drops that verify it."""

    pair: Pair
    #: Drops at the step of the result, at all places of the touch.
    drops: Drops
    #: Drops at a tenth of this step, at one place of the touch.
    fine: Drops


def verify_contacts(
    engine: Engine, pairs: Sequence[Pair], tolerance: float = TOLERANCE
) -> list[VerifiedContact]:
    """Find the largest step that is good for all pairs, and drop each pair at this step."""
    found = [find_largest_step(engine, pair, tolerance) for pair in pairs]
    step = min(drops.step for drops in found)
    return [
        _verified(engine, pair, drops if drops.step == step else find_extremes(engine, pair, step))
        for pair, drops in zip(pairs, found, strict=True)
    ]


def verify_stiffest(
    engine: Engine, pairs: Sequence[Pair], step: float, tolerance: float = TOLERANCE
) -> list[VerifiedContact]:
    """Find, for each pair, the stiffest contact that a step carries."""
    return [_verified(engine, *find_stiffest(engine, pair, step, tolerance)) for pair in pairs]


def _verified(engine: Engine, pair: Pair, drops: Drops) -> VerifiedContact:
    """Return a pair's drops together with a drop at a tenth of the step."""
    return VerifiedContact(pair, drops, drop_at_places(engine, pair, drops.step / 10, [END]))


def _require_available(engine: Engine) -> None:
    """Raise a SolverError if an engine cannot run on this machine."""
    reason = engine.unavailable()
    if reason is not None:
        raise SolverError(engine.name, "unavailable", reason)


def _good_drops(engine: Engine, pair: Pair, step: float, places: Sequence[float], tolerance: float) -> Drops:
    """Drop a pair at places of a step; raise a SolverError if a result is outside the tolerance."""
    # Most bad steps fail at the first place already.
    _check_tolerance(engine, pair, drop_at_places(engine, pair, step, places[:1]), tolerance)
    return _check_tolerance(engine, pair, drop_at_places(engine, pair, step, places), tolerance)


def _check_tolerance(engine: Engine, pair: Pair, results: Drops, tolerance: float) -> Drops:
    """Return drops that are within the tolerance; else raise a SolverError."""
    if (error := results.error(pair)) > tolerance - ROUNDING:
        raise SolverError(
            engine.name, "unconverged", f"at the last step tried one of them is off by {error:.2g}"
        )
    return results
