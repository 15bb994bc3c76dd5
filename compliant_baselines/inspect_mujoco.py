"""The contacts of a MuJoCo scene and the traps in their parameters, a row of `TRAPS` each.

The engine documents each trap (XML reference, "Solver parameters" and the options; changelog of 3.13). For each, a test
sets the trap and measures its effect.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from operator import itemgetter
from types import SimpleNamespace
from typing import Any, NamedTuple

from impact_xval.compliant_baselines.contacts_mujoco import Bodies, called, contacts

#: Steps in a contact below which its restitution is off by 10 % and more.
FEWEST_STEPS = 30

#: Impedance above which a contact is not at the level of forces.
FORCE_LEVEL = 0.01


@dataclass(frozen=True, slots=True)
class Finding:
    """A trap in a scene: its name, the contact or option, and what the engine does, with the way out."""

    trap: str
    where: str
    says: str

    def __str__(self) -> str:
        return f"{self.trap}: {self.where}: {self.says}"


class _Trap(NamedTuple):
    """A trap: how it is seen in a contact `c` (see `_facts`), what the engine does with the way out, and the place."""

    name: str
    seen: Callable[[Any], Any]
    says: str
    where: str = "{c.where}"


TRAPS = (
    _Trap(
        "mixed-geoms",
        lambda c: c.mixed,
        "solref {c.mixed[0]} and {c.mixed[1]} are combined to {c.mixed[2]}, the smaller of each number; use a <pair>",
    ),
    _Trap(
        "override",
        lambda c: c.override,
        "every contact has solref {c.solref} instead of its own",
        "option flag",
    ),
    _Trap(
        "discrete",
        lambda c: c.discrete,
        "contacts are taken at the end of the step: an elastic one gives back less than it took, and refsafe replaces "
        "what the step cannot resolve; use Euler or implicitfast",
        "option integrator",
    ),
    _Trap(
        "mixed-signs",
        lambda c: c.mixed_signs,
        "solref ({c.solref[0]:g}, {c.solref[1]:g}) is neither (time constant, damping ratio), both positive, nor "
        "(-stiffness, -damping), both <= 0: the default (0.02, 1) replaces it",
    ),
    _Trap(
        "refsafe",
        lambda c: c.refsafe,
        "a time constant of {c.first:g} s is shorter than two steps of {c.step:g} s and becomes {c.two_steps:g} "
        "s, a stiffness {c.lower:.3g} times lower; shorten the step",
    ),
    _Trap(
        "not-newton-per-metre",
        lambda c: c.stiffness > 0 and c.dmin > FORCE_LEVEL,
        "a direct stiffness of {c.direct:g} is in 1/s^2: alone, this pair has {c.stiffness:.4g} N/m at most, and under "
        "solimp {c.dmin:g} to {c.dmax:g} a third body that pushes changes it; for N/m take impact-xval contact",
    ),
    _Trap(
        "long-step",
        lambda c: c.steps < FEWEST_STEPS,
        "a contact of {c.duration:.3g} s gets {c.steps:.2g} steps of {c.step:.3g} s; some "
        f"{FEWEST_STEPS} are the least for its restitution to be within 10 %, "
        "{c.hundredth:.2g} s the step for about 1 % (see impact-xval contact)",
    ),
    _Trap(
        "tolerance",
        lambda c: c.cg_tolerance > 0,
        "CG stops at {c.cg_tolerance:g} of an absolute measure: a contact whose accelerations are small gets part of "
        "its force, or none; use Newton, or tolerance 0",
        "option solver",
    ),
)


def inspect_model(model: Any) -> list[Finding]:
    """Look for traps in a compiled mujoco.MjModel; one that many contacts share in the same words stands once."""
    facts = [_facts(model.opt, where[0], alike) for alike, where in contacts(model).items()]
    places: dict[tuple[str, str], dict[str, None]] = {}
    for trap, c in itertools.product(TRAPS, facts):
        if trap.seen(c):
            places.setdefault((trap.name, trap.says.format(c=c)), {})[trap.where.format(c=c)] = None
    return [Finding(trap, called([*where]), says) for (trap, says), where in places.items()]


def _combined(one: dict[str, Any], two: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Solref and solimp of two geoms; where direct solrefs differ, also both and their combination."""
    if one["priority"] != two["priority"]:
        one = two = max(one, two, key=itemgetter("priority"))
    total = one["solmix"] + two["solmix"]
    share = one["solmix"] / total if total > 0 else 0.5
    solref, solimp = (
        tuple(a if a == b else share * a + (1 - share) * b for a, b in zip(one[name], two[name], strict=True))
        for name in ("solref", "solimp")
    )
    direct = min(one["solref"][0], two["solref"][0]) <= 0
    if direct:
        solref = tuple(map(min, one["solref"], two["solref"]))
    mixed = one["solref"] != two["solref"] and min(solref) <= 0
    return solref, solimp, (one["solref"], two["solref"], solref) if mixed else None


def _facts(option: Any, where: str, bodies: Bodies) -> SimpleNamespace:
    """Facts of a contact under the names that `TRAPS` uses, in SI units."""
    mujoco: Any = import_module("mujoco")
    own, inverse_mass = dict(bodies.pair), bodies.inverse_weight
    solref, solimp, mixed = (
        (own["solref"], own["solimp"], None) if own else _combined(*map(dict, bodies.geoms))
    )
    step, two_steps = option.timestep, 2 * option.timestep
    override = option.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE
    if override:
        solref, solimp = tuple(option.o_solref.tolist()), tuple(option.o_solimp.tolist())
    mixed_signs = (solref[0] > 0) != (solref[1] > 0)
    first, second = (0.02, 1.0) if mixed_signs else solref
    discrete = option.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
    safe = not discrete and not option.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE
    refsafe = safe and 0 < first < two_steps
    if first > 0:  # stiffness (d/(dmax tc dr))^2 and damping 2 d/(dmax tc) of the pair alone, at d = dmax
        acting = two_steps if refsafe else first
        omega, rate = 1 / (acting * second), 2 / acting
    else:
        omega, rate = math.sqrt(-first), -second
    duration = math.pi / omega if omega > 0 else math.inf
    if rate > 2 * omega > 0:  # a heavy dashpot decays fast, and the step has to resolve that too
        duration = min(duration, 2 * math.pi / rate)
    return SimpleNamespace(
        **locals(),
        cg_tolerance=option.tolerance if option.solver == mujoco.mjtSolver.mjSOL_CG else 0.0,
        dmin=solimp[0],
        dmax=solimp[1],
        direct=-first,
        stiffness=-first / inverse_mass if inverse_mass > 0 else 0.0,
        lower=(two_steps / first) ** 2 if refsafe else 1.0,
        steps=duration / step if step > 0 else math.inf,
        hundredth=duration / 100,
    )
