"""The contacts of a MuJoCo scene and the traps in their parameters, a row of `TRAPS` each.

The engine documents each trap (XML reference, "Solver parameters" and the options; changelog of 3.13). For each, a test
sets the trap and measures its effect.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.contacts_mujoco import Bodies, places
from impact_xval.compliant_baselines.mapping import Contact, mujoco_contact

#: Steps in a contact below which its restitution is off by 10 % and more.
FEWEST_STEPS = 30

#: Impedance above which a contact is not at the level of forces.
FORCE_LEVEL = 0.01

#: Restitution of a contact that is not to rebound: no finite damping gives 0.
NO_REBOUND = 0.01


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
    """Look for traps in a compiled model.

    Parameters
    ----------
    model : mujoco.MjModel
        The user's.

    Returns
    -------
    list of Finding
        Empty if there are none; a trap that many contacts share in the same words stands once.
    """
    contacts = [_facts(model.opt, *contact) for contact in _contacts(model)]
    places: dict[tuple[str, str], dict[str, None]] = {}
    for trap, c in itertools.product(TRAPS, contacts):
        if trap.seen(c):
            places.setdefault((trap.name, trap.says.format(c=c)), {})[trap.where.format(c=c)] = None
    return [
        Finding(trap, first + (f" and {len(others)} more" if others else ""), says)
        for (trap, says), (first, *others) in places.items()
    ]


def _contacts(model: Any) -> Iterator[tuple[Any, ...]]:
    """Place, sum of inverse weights, solref, solimp, and what is mixed of a contact; one of each combination."""
    parameters = model.geom_solref, model.geom_solimp, model.geom_solmix, model.geom_priority
    rows, seen = np.column_stack(parameters), set()
    for where, (a, b), pair in places(model):
        inverse_mass = float(model.body_invweight0[model.geom_bodyid[[a, b]], 0].sum())
        if pair is not None:  # its own, of which nothing is mixed
            yield (
                where,
                inverse_mass,
                tuple(model.pair_solref[pair].tolist()),
                model.pair_solimp[pair].tolist(),
                None,
            )
            continue
        key = rows[a].tobytes(), rows[b].tobytes(), inverse_mass
        if inverse_mass > 0 and key not in seen:
            seen.add(key)
            yield where, inverse_mass, *_combined(rows[a], rows[b])


def _combined(one: np.ndarray, two: np.ndarray) -> tuple[Any, Any, Any]:
    """Solref and solimp of two geoms; where direct solrefs differ, also both and their combination."""
    if one[8] != two[8]:
        one = two = max(one, two, key=lambda row: row[8])
    total = one[7] + two[7]
    share = one[7] / total if total > 0 else 0.5
    row = np.where(one == two, one, share * one + (1 - share) * two)
    if min(one[0], two[0]) <= 0:
        row[:2] = np.minimum(one[:2], two[:2])
    solrefs = [tuple(each[:2].tolist()) for each in (one, two, row)]
    mixed = solrefs[0] != solrefs[1] and min(solrefs[2]) <= 0
    return solrefs[2], row[2:7].tolist(), solrefs if mixed else None


def _facts(
    option: Any, where: str, inverse_mass: float, solref: Any, solimp: Any, mixed: Any
) -> SimpleNamespace:
    """Facts of a contact under the names that `TRAPS` uses, in SI units."""
    mujoco: Any = import_module("mujoco")
    step, two_steps = option.timestep, 2 * option.timestep
    override = option.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE
    if override:
        solref, solimp = tuple(option.o_solref.tolist()), option.o_solimp.tolist()
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


@dataclass(frozen=True, slots=True)
class Meant:
    """What was probably meant by a solref, and the <pair> that gives it; whether the solref was direct."""

    contact: Contact
    solref: tuple[float, float]
    solimp: tuple[float, ...]
    direct: bool

    @property
    def pair(self) -> tuple[tuple[str, Any], ...]:
        """Attributes of the <pair>."""
        return ("solref", self.solref), ("solimp", self.solimp), ("condim", 1)

    @property
    def longest_step(self) -> float:
        """A hundredth of the contact, in s, and short enough for refsafe to leave a time constant as it is."""
        safe = math.inf if self.direct else self.solref[0] / 2.2
        return float(f"{min(self.contact.duration / 100, safe):.2g}")

    def __str__(self) -> str:
        c = self.contact
        asked = f"{c.k:.4g} N/m and {c.c:.4g} N s/m" if self.direct else f"e = {c.restitution:.2g}"
        if c.restitution < 1.01 * NO_REBOUND and not self.direct:
            asked = f"no rebound ({asked})"
        words = (" ".join(f"{number:.6g}" for number in numbers) for numbers in (self.solref, self.solimp))
        return 'for {}: <pair condim="1" solref="{}" solimp="{}"/>'.format(asked, *words)


def meant(solref: tuple[float, float], solimp: tuple[float, ...], bodies: Bodies) -> Meant | None:
    """Guess what was meant: direct numbers in N/m and N s/m, or a damping ratio as in textbooks; None if neither.

    Direct numbers at the level of forces are taken for what they are. A textbook's contact may pull, and has no rebound
    from a ratio of 1 on.
    """
    first, second = map(abs, solref)
    if solref[0] < 0:
        forces = solimp[0] <= FORCE_LEVEL and solref[1] <= 0
        weight = bodies.inverse_weight if forces else 1.0
        contact = Contact(first / weight, second / weight, bodies.mass)
        own = mujoco_contact(replace(contact, mass=1 / bodies.inverse_weight))
        return Meant(contact, own.solref, own.solimp, direct=True)
    if not first or not second:
        return None
    e = math.exp(-math.pi * second / math.sqrt(1 - second**2)) if second < 1 else 0.0
    contact = Contact.from_restitution(bodies.mass / (first * second) ** 2, max(e, NO_REBOUND), bodies.mass)
    return Meant(contact, (1 / (contact.zeta * contact.omega), contact.zeta), solimp, direct=False)
