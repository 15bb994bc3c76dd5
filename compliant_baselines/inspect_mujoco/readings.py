"""Contacts that a user may have meant by a solref, parameters for these contacts, and their measurements.

Direct numbers are a solref (-stiffness, -damping). They can be read in two ways: the user wants the present behaviour
of the contact, or meant the numbers in N/m and N s/m. Each reading is written as a <pair> with a small impedance. Its
numbers are then forces over the mass, and a third body does not change the contact. If a solref is a time constant and
a damping ratio, there is no reading. Instead damping ratios are listed with their restitutions, as advice.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any, Literal, NamedTuple

from impact_xval.compliant_baselines.inspect_mujoco.drops import MeasuredContact, measure_contact
from impact_xval.compliant_baselines.inspect_mujoco.scene_contacts import Bodies, MujocoOption
from impact_xval.compliant_baselines.inspect_mujoco.traps import (
    GOOD_STEPS,
    describe_damping_ratio,
    format_numbers,
    is_at_force_level,
    looks_like_restitution,
)
from impact_xval.compliant_baselines.mapping import KelvinVoigtContact, mujoco_contact
from impact_xval.compliant_baselines.restitution import contact_time, damping_ratio

mujoco: Any = import_module("mujoco")  # type checkers do not see the names of the compiled module

#: Largest difference between a measured restitution and the one that was meant.
NEAR_E = 0.02

#: Largest relative difference between a measured stiffness or duration and the one that was meant.
NEAR_K = 0.05

#: Restitution that is written for a contact without rebound, because no finite damping gives 0.
NO_REBOUND = 0.01

#: Smallest number of steps in a time constant. The engine's refsafe changes time constants below 2 steps; this number
#: leaves some room.
_REFSAFE_STEPS = 2.2

#: Largest relative difference between the measured restitution of advice and the one asked for.
ADVICE_TOLERANCE = 0.01

#: Largest number of solrefs that are tried to get a restitution.
_MOST_CORRECTIONS = 6

#: The advice lists damping ratios for these restitutions.
_USUAL_RESTITUTIONS = (0.5, 0.9)

Kind = Literal["keep", "newton-metre"]


class Reading(NamedTuple):
    """A contact that a user may have meant, with parameters for it and the results of their drops; SI units."""

    kind: Kind
    #: Numbers of the contact that was meant.
    stiffness: float
    damping: float
    restitution: float
    duration: float
    #: Parameters to write in a <pair>: solref, solimp, condim and friction.
    solref: tuple[float, float]
    solimp: tuple[float, float, float, float, float]
    condim: int
    friction: tuple[float, ...]
    #: Longest time step in s at which these parameters are good.
    step: float
    #: True if the solver's tolerance must be 0.
    zero_tolerance: bool
    #: Mean and range of the restitution over the instants of touch within a step; None if it was not measured.
    measured_restitution: float | None
    measured_range: tuple[float, float] | None
    measured_duration: float | None
    #: True if the drops have the restitution and duration that were meant; else `problem` says what they have.
    is_kept: bool
    problem: str

    @property
    def pair(self) -> str:
        """The <pair> to write, without the names of its geoms."""
        attributes = " ".join(f'{name}="{text}"' for name, text in self.attributes.items())
        return f"<pair {attributes}/>"

    @property
    def attributes(self) -> dict[str, str]:
        """Attributes of the <pair> as texts; friction is missing in a frictionless contact."""
        attributes = {"condim": str(self.condim)}
        if self.condim > 1:
            attributes["friction"] = format_numbers(self.friction)
        return attributes | {"solref": format_numbers(self.solref), "solimp": format_numbers(self.solimp)}

    @property
    def text(self) -> str:
        """A phrase with the contact that was meant, the text to write, and the results of its drops."""
        meant = f"{self.stiffness:.4g} N/m and {self.damping:.4g} N s/m"
        if self.kind == "keep":
            meant = f"e = {self.restitution:.3g} in {self.duration:.3g} s as now"
        tolerance = ' with <option tolerance="0"/>' if self.zero_tolerance else ""
        gives = self.problem
        if self.measured_duration is not None:
            gives = f"which gives e = {self.measured_restitution:.3g} in {self.measured_duration:.3g} s"
        return f"for {meant}: {self.pair}{tolerance} and a step of {self.step:g} s, {gives}"


class RatioAdvice(NamedTuple):
    """Damping ratios with their restitutions, as advice on a solref with a time constant and a damping ratio."""

    #: The present solref of the contact.
    solref: tuple[float, float]
    #: Pairs of a restitution and the solref that gives this restitution with the present duration of the contact. The
    #: numbers are rounded to three digits. No damping ratio among them looks like a restitution.
    choices: list[tuple[float, tuple[float, float]]]
    #: Longest time step in s that is good for all these solrefs.
    step: float
    #: Mean restitution of the drops with each of these solrefs; None if a drop failed.
    measured: list[float | None]

    @property
    def problem(self) -> str:
        """A phrase that names the solrefs that miss their restitution; ``""`` if there are none."""
        missed = [
            f"solref {format_numbers(solref)} proposed for e = {e:g} gives "
            + ("no result" if measured is None else f"{measured:.3g}")
            for (e, solref), measured in zip(self.choices, self.measured, strict=True)
            if not _is_near(measured, e)
        ]
        return "; ".join(missed)

    @property
    def text(self) -> str:
        """The advice as a sentence."""
        first, *others = (
            f'{e:g} write {solref[1]:g} (solref="{format_numbers(solref)}")' for e, solref in self.choices
        )
        drops = " and ".join("no rebound" if e is None else f"{e:.3g}" for e in self.measured)
        return (
            f"For e = {', for '.join([first, *others])}: the same duration; at a step of {self.step:g} s drops give "
            f"{drops}"
        )


def read_direct_numbers(
    bodies: Bodies, option: MujocoOption, speed: float, measured: MeasuredContact, kept: MeasuredContact
) -> tuple[Reading | None, Reading | None]:
    """Return both readings of a solref (-stiffness, -damping): the present behaviour, and N/m and N s/m.

    The present behaviour is `kept`. Both readings are None if the solref is a time constant and a damping ratio, or if
    the contact already has the stiffness and damping of the solref in N/m and N s/m. The first reading is also None if
    the bodies do not leave the contact.
    """
    if bodies.solref[0] >= 0:
        return None, None
    meant = meaning_in_newton_metre(bodies, option, measured.impedances)
    assert measured.restitution_range is not None
    off = max(abs(e - meant.restitution) for e in measured.restitution_range)
    is_stiff_as_meant = measured.stiffness is not None and abs(measured.stiffness / meant.k - 1) <= NEAR_K
    if off <= NEAR_E and is_stiff_as_meant:
        return None, None
    keep = None
    if kept.duration is not None:
        keep = verify_reading("keep", bodies, option, speed, contact_of(kept, bodies))
    return keep, verify_reading("newton-metre", bodies, option, speed, meant)


def meaning_in_newton_metre(
    bodies: Bodies, option: MujocoOption, impedances: tuple[float, float] | None
) -> KelvinVoigtContact:
    """Return the contact that a solref (-stiffness, -damping) means if its numbers are read in N/m and N s/m.

    If the impedance is small and constant, the engine's numbers are forces: N/m and N s/m over the mass. Then they are
    multiplied by the mass and by the factor of the friction cone. `impedances` are the measured impedances, which show
    if they are small and constant.
    """
    solref = bodies.solref
    is_force = is_at_force_level(bodies.solimp, impedances) and solref[1] <= 0
    unit = bodies.scale * _cone_factor(bodies, option) if is_force else 1.0
    return KelvinVoigtContact(abs(solref[0]) * unit, abs(solref[1]) * unit, bodies.mass)


def contact_of(measured: MeasuredContact, bodies: Bodies) -> KelvinVoigtContact:
    """Return the spring and dashpot with the measured restitution and duration, for these bodies."""
    assert measured.restitution is not None
    assert measured.duration is not None
    e = min(max(measured.restitution, NO_REBOUND), 1.0)
    stiffness = bodies.mass * (contact_time(damping_ratio(e)) / measured.duration) ** 2
    return KelvinVoigtContact.from_restitution(stiffness, e, bodies.mass)


def write_reading(kind: Kind, bodies: Bodies, option: MujocoOption, meant: KelvinVoigtContact) -> Reading:
    """Return a contact as a <pair> with a small constant impedance, not measured yet; condim and friction are kept."""
    pair = dict(bodies.pair)
    solref, solimp = mujoco_contact(meant._replace(mass=bodies.scale * _cone_factor(bodies, option)))
    return Reading(
        kind=kind,
        stiffness=meant.k,
        damping=meant.c,
        restitution=meant.restitution,
        duration=meant.duration,
        solref=solref,
        solimp=solimp,
        condim=int(pair["dim"][0]),
        friction=pair["friction"],
        step=min(option.timestep, round_down(meant.duration / GOOD_STEPS)),
        zero_tolerance=False,
        measured_restitution=None,
        measured_range=None,
        measured_duration=None,
        is_kept=False,
        problem="was not measured",
    )


def _cone_factor(bodies: Bodies, option: MujocoOption) -> float:
    """Return the factor by which a friction cone multiplies the force along the normal at a small impedance.

    For a pyramidal cone the factor is (condim - 1)/(mu^2 (1 + mu^2)). The cone has 2 (condim - 1) edges. The
    regularisation of an edge is 2 mu^2 times that of the normal. The inverse weight in it is (1 + mu^2) times that of
    the bodies (the engine's mj_diagApprox and mj_makeImpedance).
    """
    pair = dict(bodies.pair)
    condim, mu = int(pair["dim"][0]), pair["friction"][0]
    if condim == 1 or option.cone != mujoco.mjtCone.mjCONE_PYRAMIDAL:
        return 1.0
    return (condim - 1) / (mu**2 * (1 + mu**2))


def verify_reading(
    kind: Kind, bodies: Bodies, option: MujocoOption, speed: float, meant: KelvinVoigtContact
) -> Reading:
    """Return a reading with the results of its drops, and with tolerance 0 if the scene's tolerance changes it."""
    reading = write_reading(kind, bodies, option, meant)
    written = bodies._replace(
        pair=tuple((dict(bodies.pair) | {"solref": reading.solref, "solimp": reading.solimp}).items())
    )
    for exact in (False, True):
        try:
            row = measure_contact(written, option, reading.step, speed, exact=exact)
        except RuntimeError as error:
            reading = reading._replace(problem=f"was not measured: {error}")
            continue
        is_kept = is_as_meant(row, meant)
        reading = reading._replace(
            measured_restitution=row.restitution,
            measured_range=row.restitution_range,
            measured_duration=row.duration,
            zero_tolerance=exact and is_kept,
            is_kept=is_kept,
            problem=""
            if is_kept
            else (
                f"the pair proposed gives {row.outcome}, not e = {meant.restitution:.3g} in {meant.duration:.3g} s"
            ),
        )
        if is_kept:
            break
    return reading


def is_as_meant(row: MeasuredContact, meant: KelvinVoigtContact) -> bool:
    """Return True if the drops have the restitution and duration that were meant."""
    if row.restitution_range is None or row.duration is None:
        return False
    off = max(abs(e - meant.restitution) for e in row.restitution_range)
    return off <= NEAR_E and abs(row.duration / meant.duration - 1) <= NEAR_K


def advise_on_ratio(
    bodies: Bodies, option: MujocoOption, speed: float, measured: MeasuredContact
) -> RatioAdvice | None:
    """Return damping ratios that give other restitutions with the measured duration; None for direct solrefs."""
    time_constant, ratio = bodies.solref
    if min(time_constant, ratio) <= 0 or not measured.duration:
        return None
    # A user who took the damping ratio for a restitution wants the restitution with this number.
    wished = [ratio] if looks_like_restitution(ratio) else []
    wished += [e for e in _USUAL_RESTITUTIONS if e not in wished and not _is_near(measured.restitution, e)]
    choices = [
        (e, round_solref(_find_solref(bodies, option, speed, e, measured.duration))) for e in wished[:2]
    ]
    step = min(_step_of_choice(option, measured.duration, solref) for _, solref in choices)
    return RatioAdvice(
        (time_constant, ratio),
        choices,
        step,
        [_measure_choice(bodies, option, speed, step, c) for _, c in choices],
    )


def describe_ratio(advice: RatioAdvice, measured: MeasuredContact) -> str:
    """Return a sentence on what a contact's damping ratio does, and on the damping ratios of other restitutions."""
    return f"{describe_damping_ratio(advice.solref, [measured])}. {advice.text}"


def _is_near(measured: float | None, e: float) -> bool:
    """Return True if a measured restitution differs from e by at most the fraction `ADVICE_TOLERANCE`."""
    return measured is not None and abs(measured / e - 1) <= ADVICE_TOLERANCE


def _find_solref(
    bodies: Bodies, option: MujocoOption, speed: float, e: float, duration: float
) -> tuple[float, float]:
    """Return a time constant in s and a damping ratio with which drops have a restitution and a duration in s.

    The first guess is exact if the impedance is constant. Further guesses are corrected by measurements, because ln e
    is nearly proportional to the damping ratio, and the duration to the time constant. The best guess is returned.
    """
    zeta, stretch = damping_ratio(e), 1.0
    by_formula = (duration / (contact_time(zeta) * zeta), zeta)
    # Relative errors of the restitutions that were measured, each with its solref.
    measured: list[tuple[float, tuple[float, float]]] = []
    for _ in range(_MOST_CORRECTIONS):
        solref = (stretch * duration / (contact_time(zeta) * zeta), zeta)
        try:
            row = measure_contact(
                _bodies_with(bodies, solref), option, _step_of_choice(option, duration, solref), speed
            )
        except RuntimeError:
            break
        if row.restitution is None or row.duration is None:
            break
        error = abs(row.restitution / e - 1)
        measured.append((error, solref))
        if error <= ADVICE_TOLERANCE / 4 or not 0 < row.restitution < 1:
            break
        zeta *= math.log(e) / math.log(row.restitution)
        stretch *= duration / row.duration
    return min(measured)[1] if measured else by_formula


def round_solref(solref: tuple[float, float]) -> tuple[float, float]:
    """Round a time constant in s and a damping ratio to three digits.

    A damping ratio that would then have two digits or fewer gets a neighbouring number with three digits, because
    `looks_like_restitution` is true of the rounded number. A damping ratio of 1 or more gets four digits.
    """
    time_constant, ratio = solref
    rounded = float(f"{ratio:.{3 if ratio < 1 else 4}g}")
    if looks_like_restitution(rounded):
        unit = 10.0 ** (math.floor(math.log10(rounded)) - 2)
        rounded = float(f"{rounded + math.copysign(unit, ratio - rounded):.3g}")
    return float(f"{time_constant:.3g}"), rounded


def _step_of_choice(option: MujocoOption, duration: float, solref: tuple[float, float]) -> float:
    """Return a good step in s for a contact of a duration in s; it is at most the scene's step."""
    return min(float(option.timestep), round_down(min(duration / GOOD_STEPS, solref[0] / _REFSAFE_STEPS)))


def _bodies_with(bodies: Bodies, solref: tuple[float, float]) -> Bodies:
    """Return the bodies and parameters of a contact with another solref."""
    return bodies._replace(pair=tuple((dict(bodies.pair) | {"solref": solref}).items()))


def _measure_choice(
    bodies: Bodies, option: MujocoOption, speed: float, step: float, solref: tuple[float, float]
) -> float | None:
    """Drop a contact with another solref, and return its restitution; None if a drop fails."""
    try:
        return measure_contact(_bodies_with(bodies, solref), option, step, speed).restitution
    except RuntimeError:
        return None


def round_down(step: float) -> float:
    """Round a time step down to two digits."""
    exponent = math.floor(math.log10(step)) - 1
    return float(f"{math.floor(step / 10.0**exponent * (1 + 1e-12))}e{exponent}")
