"""Traps in the parameters of the contacts of a MuJoCo scene.

A trap is a rule of the engine by which a contact behaves otherwise than its parameters suggest.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.inspect_mujoco.drops import MeasuredContact
from impact_xval.compliant_baselines.inspect_mujoco.scene_contacts import Bodies, MujocoOption, SceneContact
from impact_xval.compliant_baselines.mapping import (
    MUJOCO_DEFAULT_SOLIMP,
    MUJOCO_DEFAULT_SOLREF,
    MUJOCO_IMPEDANCE,
    KelvinVoigtContact,
    MujocoContact,
)
from impact_xval.compliant_baselines.restitution import restitution

mujoco: Any = import_module("mujoco")  # type checkers do not see the names of the compiled module

#: Number of steps in a contact below which its restitution is wrong by 10 % or more.
FEWEST_STEPS = 30

#: A time step is good if a contact lasts for this number of steps.
GOOD_STEPS = 100

#: Largest relative change of an impedance with the depth at which it is taken for constant.
SAME_IMPEDANCE = 0.01

#: Largest impedance at which a solref (-stiffness, -damping) is N/m and N s/m over the mass, even if a third body
#: pushes.
FORCE_LEVEL = 0.01

#: Names of all traps, in the order in which findings are listed.
TRAPS = (
    "mixed-geoms",
    "mixed-default",
    "override",
    "discrete",
    "mixed-signs",
    "refsafe",
    "not-newton-per-metre",
    "damping-ratio",
    "solimp",
    "long-step",
    "tolerance",
    "gains-energy",
    "unkept",
)


class LongStep(NamedTuple):
    """A contact that is too short for the time step."""

    row: MeasuredContact
    #: Time in s that the step must resolve, and a phrase that names the process which takes this time.
    time: float
    what: str


class Trap(NamedTuple):
    """A trap of one contact."""

    #: One of `TRAPS`.
    name: str
    #: Sentence on what the engine does, and on how to avoid it.
    message: str


class Finding(NamedTuple):
    """A trap in a scene, with all contacts that have it."""

    #: One of `TRAPS`.
    trap: str
    #: Names of the contacts that have this trap.
    contacts: list[str]
    #: Sentence on what the engine does, and on how to avoid it.
    message: str


def gather_findings(traps: Sequence[tuple[list[str], Iterable[Trap]]]) -> list[Finding]:
    """Return the traps of a scene, gathered from the traps of its contacts and the contacts' names.

    Contacts whose trap has the same message share one finding.
    """
    contacts: dict[Trap, list[str]] = {}
    for names, traps_of_contact in traps:
        for trap in traps_of_contact:
            contacts.setdefault(trap, []).extend(names)
    in_order = sorted(contacts, key=lambda trap: TRAPS.index(trap.name))
    return [Finding(trap.name, contacts[trap], trap.message) for trap in in_order]


def traps_of_mixing(contacts: Sequence[SceneContact]) -> Iterator[Trap]:
    """Yield the trap that the default solref of one geom is averaged with the solref of the other geom.

    The contacts have the same parameters. A solref (-stiffness, -damping) is not averaged; its trap is in
    `traps_in_parameters`.
    """
    default = MUJOCO_DEFAULT_SOLREF
    averaged = [
        contact
        for contact in contacts
        if contact.bodies.rule == "mixed"
        and default in contact.solrefs
        and contact.solrefs[0] != contact.solrefs[1]
        and min(min(solref) for solref in contact.solrefs) > 0
    ]
    if not averaged:
        return
    first = averaged[0]
    of_default = first.solrefs.index(default)
    other, named = first.geom_names[of_default], first.geom_names[1 - of_default]
    solref = format_numbers(first.solrefs[1 - of_default])
    result = format_numbers(first.bodies.solref)
    more = f" ({len(averaged) - 1} more likewise)" if len(averaged) > 1 else ""
    yield Trap(
        "mixed-default",
        f"geom {named} has solref {solref}, and geom {other} has the default {format_numbers(default)}. The engine "
        f'averages them by solmix to {result}{more}. For {solref} write it in a <pair>, or write priority="1" in geom '
        f'{named}, or solmix="0" in geom {other}',
    )


def traps_in_parameters(
    option: MujocoOption, alike: Sequence[Bodies], rows: Sequence[MeasuredContact] = ()
) -> Iterator[Trap]:
    """Yield the traps in the parameters of contacts.

    Parameters
    ----------
    option
        The options of the scene.
    alike
        The bodies of contacts that have the same parameters.
    rows
        Measurements of some of these contacts. Values that were not measured come from formulas, and the text says so.
    """
    measured = [row for row in rows if row.restitution is not None]
    bodies = alike[0]
    solref, (dmin, dmax, *_) = bodies.solref, bodies.solimp
    step = option.timestep
    mixtures = dict.fromkeys(each.mixed for each in alike if each.mixed)
    if mixtures:
        first, *others = (" and ".join(map(str, mixed)) for mixed in mixtures)
        more = f" (and {len(others)} other mixtures)" if others else ""
        yield Trap(
            "mixed-geoms",
            f"solref {first}{more} are combined to {solref}, the smaller of each number. Use a <pair>",
        )
    if option.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE:
        yield Trap("override", f"every contact has solref {solref} instead of its own")
    is_discrete = _is_discrete(option)
    if is_discrete:
        yield Trap(
            "discrete",
            "forces are those at the end of a step: an elastic contact gives back less than it took, and refsafe "
            "replaces a solref that the step cannot resolve. Use Euler or implicitfast",
        )
    signs_differ = (solref[0] > 0) != (solref[1] > 0)
    if signs_differ:
        yield Trap(
            "mixed-signs",
            f"solref ({solref[0]:g}, {solref[1]:g}) has two signs, so the default (0.02, 1) replaces it. Legal are "
            "(time constant, damping ratio), both > 0, and (-stiffness, -damping), both <= 0",
        )
    first, second = MUJOCO_DEFAULT_SOLREF if signs_differ else solref
    effective = 2 * step if is_lengthened((first, second), option) else first
    if effective != first:
        yield Trap(
            "refsafe",
            f"the time constant of {first:g} s is shorter than two steps. The engine takes {effective:g} s, which is "
            f"a stiffness {(effective / first) ** 2:.3g} times lower. Shorten the step",
        )
    impedances = [row.impedances for row in measured] or [None]
    if first < 0 and not all(is_at_force_level(bodies.solimp, ends) for ends in impedances):
        yield Trap("not-newton-per-metre", _describe_direct_stiffness(-first, alike, measured))
    if min(solref) > 0 and looks_like_restitution(solref[1]):
        yield Trap("damping-ratio", describe_damping_ratio(solref, measured))
    if solref == MUJOCO_DEFAULT_SOLREF and not np.allclose(bodies.solimp, MUJOCO_DEFAULT_SOLIMP):
        solimp = format_numbers(bodies.solimp)
        shifts = "" if dmin == dmax else ". An impedance that changes with the depth only shifts it"
        yield Trap(
            "solimp",
            f"solimp ({solimp}) sets no restitution: e is {_format_restitution(solref[1], measured)}. The second "
            f"number of solref, a damping ratio, sets it{shifts}",
        )
    if not measured:
        duration = _duration_to_resolve((effective, second))
        if duration / step < FEWEST_STEPS:
            yield Trap(
                "long-step",
                f"by the formula a contact of {duration:.3g} s gets {duration / step:.2g} steps. So e depends on where "
                f"in a step the bodies touch. A step of {duration / GOOD_STEPS:.2g} s keeps it within about 1 %",
            )


def is_lengthened(solref: tuple[float, float], option: MujocoOption) -> bool:
    """Return True if the engine lengthens the time constant of a solref to the time of two steps (`refsafe`)."""
    has_refsafe = not _is_discrete(option) and not option.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE
    return bool(has_refsafe) and 0 < solref[0] < 2 * option.timestep and solref[1] > 0


def _is_discrete(option: MujocoOption) -> bool:
    """Return True if the integrator computes forces at the end of a step; it exists from MuJoCo 3.13 on."""
    return option.integrator == getattr(mujoco.mjtIntegrator, "mjINT_DISCRETE", None)


def is_at_force_level(solimp: Sequence[float], impedances: tuple[float, float] | None) -> bool:
    """Return True if the impedance is small and constant.

    A solref (-stiffness, -damping) is then N/m and N s/m over the mass.

    `impedances` are the least and greatest measured impedance. If they are None, solimp is tested. The engine
    multiplies the stiffness by (d/dmax)^2. So the stiffness differs from its number if the impedance d changes or stays
    away from dmax.
    """
    dmax = max(solimp[1], MUJOCO_IMPEDANCE)
    low, high = impedances or (max(solimp[0], MUJOCO_IMPEDANCE), dmax)
    return max(low, high) <= FORCE_LEVEL and all(abs(d / dmax - 1) <= SAME_IMPEDANCE for d in (low, high))


def _describe_direct_stiffness(
    stiffness: float, alike: Sequence[Bodies], measured: Sequence[MeasuredContact]
) -> str:
    """Return a sentence that gives the stiffness of a solref (-stiffness, -damping) in N/m."""
    dmin, dmax, *_ = alike[0].solimp
    springs = [row.stiffness for row in measured if row.stiffness is not None]
    impedances = [d for row in measured for d in row.impedances or ()]
    if springs:
        gets = f"get {format_extremes(springs)} N/m in the drops"
    else:
        gets = f"get at most {format_extremes([stiffness * other.scale for other in alike])} N/m"
    at = f"an impedance of {format_extremes(impedances)}" if impedances else f"solimp {dmin:g} to {dmax:g}"
    return (
        f"the stiffness {stiffness:g} is in 1/s^2. Two bodies alone {gets}. With {at} a third body that touches one of "
        "them changes the stiffness"
    )


def looks_like_restitution(damping_ratio: float) -> bool:
    """Return True if a damping ratio may have been written as a restitution, such as 0.5 or 0.85.

    Such a number is between 0 and 1 and has at most two significant digits. A damping ratio that was computed for a
    restitution, such as 0.255, usually has more digits.
    """
    return 0 < damping_ratio < 1 and math.isclose(float(f"{damping_ratio:.2g}"), damping_ratio, rel_tol=1e-9)


def describe_damping_ratio(solref: tuple[float, float], measured: Sequence[MeasuredContact] = ()) -> str:
    """Return a sentence with the restitution that the damping ratio of a solref gives."""
    return (
        f"the second number of solref ({solref[0]:g}, {solref[1]:g}) is a damping ratio, not a restitution: "
        f"{solref[1]:g} rebounds with {_format_restitution(solref[1], measured)}"
    )


def find_long_step(measured: Sequence[MeasuredContact], step: float) -> LongStep | None:
    """Return the measured contact that is shortest, if a step in s is too long for it; else None.

    The step is too long if a contact has fewer than `FEWEST_STEPS` steps. Contacts that the bodies do not leave are
    ignored, because they have no restitution that a step could change.
    """
    long_steps = [long for row in measured if (long := _least_resolved(row, step))]
    return min(long_steps, key=lambda long: long.time, default=None)


def _least_resolved(row: MeasuredContact, step: float) -> LongStep | None:
    """Return the process in a measured contact that is too short for the step; None if the step is short enough."""
    if row.duration is None:
        return None
    long = LongStep(row, row.duration, f"a contact of {row.duration:.3g} s")
    if row.damping:
        decay = 2 * math.pi / row.damping / (1 / row.masses[0] + 1 / row.masses[1])
        if decay < row.duration:
            long = LongStep(
                row, decay, f"the dashpot of {row.damping:.3g} N s/m, which brakes in {decay:.3g} s,"
            )
    return long if long.time < FEWEST_STEPS * step * (1 - 1e-9) else None


def _format_restitution(damping_ratio: float, measured: Sequence[MeasuredContact]) -> str:
    """Return the measured restitution as a text, or else the restitution by the formula."""
    ends = [e for row in measured for e in row.restitution_range or ()]
    return format_extremes(ends) if ends else f"{restitution(damping_ratio):.2g} by the formula"


def format_numbers(numbers: Sequence[float], digits: int = 6) -> str:
    """Return numbers as a text for MJCF."""
    return " ".join(f"{number:.{digits}g}" for number in numbers)


def format_extremes(values: Sequence[float]) -> str:
    """Return the least and the greatest of values as a text with three digits."""
    low, high = (f"{float(f'{value:.3g}'):g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _duration_to_resolve(solref: tuple[float, float]) -> float:
    """Return the time in s that the step must resolve, for two bodies alone at d = dmax; infinite without a spring.

    It is the duration of the contact, or the time in which a heavy dashpot brakes, if this is over before the contact
    ends.
    """
    k, c = (-number for number in MujocoContact(solref, MUJOCO_DEFAULT_SOLIMP).direct)
    if not k:
        return math.inf
    decay = 2 * math.pi / c if c else math.inf
    return min(KelvinVoigtContact(k, c, 1.0).duration, decay)
