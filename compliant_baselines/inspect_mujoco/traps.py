"""Traps in the parameters of the contacts of a MuJoCo scene."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.inspect_mujoco.scene_contacts import Bodies
from impact_xval.compliant_baselines.mapping import (
    MUJOCO_DEFAULT_SOLIMP,
    MUJOCO_DEFAULT_SOLREF,
    KelvinVoigtContact,
    MujocoContact,
)
from impact_xval.compliant_baselines.restitution import restitution

mujoco: Any = import_module("mujoco")  # the names of the compiled module are invisible to a type checker

#: Steps in a contact below which its restitution is off by 10 % and more.
FEWEST_STEPS = 30

#: Largest impedance at which direct numbers count in N/m and N s/m over the mass, also where a third body pushes.
FORCE_LEVEL = 0.01

#: Names of all traps, in the order in which they are listed.
TRAPS = (
    "mixed-geoms",
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


class Trap(NamedTuple):
    """A trap of one contact."""

    #: One of `TRAPS`.
    name: str
    #: What the engine does, with the way out.
    message: str


class Finding(NamedTuple):
    """A trap in a scene."""

    #: One of `TRAPS`.
    trap: str
    #: Names of the contacts that have it.
    contacts: list[str]
    #: What the engine does, with the way out.
    message: str


def gather_findings(traps: Sequence[tuple[list[str], Iterable[Trap]]]) -> list[Finding]:
    """Gather the traps of contacts, given with the contacts' names.

    A trap that many contacts share in the same words is one finding.
    """
    contacts: dict[Trap, list[str]] = {}
    for names, traps_of_contact in traps:
        for trap in traps_of_contact:
            contacts.setdefault(trap, []).extend(names)
    in_order = sorted(contacts, key=lambda trap: TRAPS.index(trap.name))
    return [Finding(trap.name, contacts[trap], trap.message) for trap in in_order]


def traps_in_parameters(
    option: Any, alike: Sequence[Bodies], measured_restitution: tuple[float, float] | None = None
) -> Iterator[Trap]:
    """Yield the traps in the parameters of contacts.

    Parameters
    ----------
    option
        The options of the scene.
    alike
        The bodies of contacts of the same parameters.
    measured_restitution
        Least and greatest that drops gave; None if the contacts were not measured.
    """
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
    is_discrete = option.integrator == getattr(mujoco.mjtIntegrator, "mjINT_DISCRETE", None)  # from 3.13 on
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
    has_refsafe = not is_discrete and not option.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE
    effective = max(first, 2 * step) if has_refsafe and first > 0 else first
    if effective != first:
        yield Trap(
            "refsafe",
            f"the time constant of {first:g} s is shorter than two steps. The engine takes {effective:g} s, which is "
            f"a stiffness {(effective / first) ** 2:.3g} times lower. Shorten the step",
        )
    if first < 0 and dmin > FORCE_LEVEL:
        low, high = (f"{-first * scale:.4g}" for scale in _extremes(each.scale for each in alike))
        springs = low if low == high else f"{low} to {high}"
        yield Trap(
            "not-newton-per-metre",
            f"the stiffness {-first:g} is in 1/s^2. Two bodies alone get at most {springs} N/m, and with solimp "
            f"{dmin:g} to {dmax:g} a third body changes that",
        )
    if min(solref) > 0 and solref[1] != MUJOCO_DEFAULT_SOLREF[1]:
        yield Trap("damping-ratio", describe_damping_ratio(solref, measured_restitution))
    if solref == MUJOCO_DEFAULT_SOLREF and not np.allclose(bodies.solimp, MUJOCO_DEFAULT_SOLIMP):
        solimp = " ".join(f"{number:g}" for number in bodies.solimp)
        yield Trap(
            "solimp",
            f"solimp ({solimp}) sets no restitution: e is {_format_restitution(solref[1])} by the formula"
            f"{_format_measured(measured_restitution)}. The second number of solref sets it, a damping ratio",
        )
    duration = _duration_to_resolve((effective, second))
    if duration / step < FEWEST_STEPS:
        yield Trap(
            "long-step",
            f"by the formula a contact of {duration:.3g} s gets {duration / step:.2g} steps. So e depends on where in "
            f"a step the bodies touch{_format_measured(measured_restitution)}. A step of {duration / 100:.2g} s keeps "
            "it within about 1 %",
        )


def describe_damping_ratio(
    solref: tuple[float, float], measured_restitution: tuple[float, float] | None = None
) -> str:
    """Say what restitution the damping ratio of a solref gives, and that it is no restitution."""
    return (
        f"the second number of solref ({solref[0]:g}, {solref[1]:g}) is a damping ratio, not a restitution: "
        f"{solref[1]:g} rebounds with {_format_restitution(solref[1])} by the formula"
        f"{_format_measured(measured_restitution)}"
    )


def _format_restitution(damping_ratio: float) -> str:
    """Write the restitution that a damping ratio gives to a contact that may push but not pull."""
    return f"{restitution(damping_ratio):.2g}"


def _format_measured(restitutions: tuple[float, float] | None) -> str:
    """Write what was measured beside a formula; empty if nothing was."""
    if restitutions is None:
        return ""
    low, high = (f"{e:.3g}" for e in restitutions)
    return f", {low} measured" if low == high else f", {low} to {high} measured"


def _extremes(values: Iterable[float]) -> tuple[float, float]:
    """Return the least and the greatest value."""
    ordered = sorted(values)
    return ordered[0], ordered[-1]


def _duration_to_resolve(solref: tuple[float, float]) -> float:
    """Return the time in s that the step has to resolve, for a pair alone at d = dmax; infinite without a spring.

    It is the duration of the contact, or the decay of a heavy dashpot, which is over before its contact ends.
    """
    k, c = (-number for number in MujocoContact(solref, MUJOCO_DEFAULT_SOLIMP).direct)
    if not k:
        return math.inf
    decay = 2 * math.pi / c if c else math.inf
    return min(KelvinVoigtContact(k, c, 1.0).duration, decay)
