"""The contacts of a MuJoCo scene: the traps in their parameters, a row of `TRAPS` each, and what they do, measured.

The engine documents each trap (XML reference, "Solver parameters" and the options; changelog of 3.13). For each, a test
sets the trap and measures its effect.

Dropped, without gravity, at several places of the touch within a step, a contact has a mean restitution and duration.
Its stiffness and damping are those of F = max(0, k delta + c delta') with the same two (`restitution`); the
engine's own law may be another. Loaded, it is at the depth where the engine has no acceleration under the weight of the
lighter body, in the gravity of the scene.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.contacts_mujoco import Alone, Bodies, called, contacts
from impact_xval.compliant_baselines.engines.mujoco import Mujoco
from impact_xval.compliant_baselines.mapping import Contact, mujoco_contact
from impact_xval.compliant_baselines.restitution import contact_time

#: Steps in a contact below which its restitution is off by 10 % and more.
FEWEST_STEPS = 30

#: Impedance above which a contact is not at the level of forces.
FORCE_LEVEL = 0.01

#: Contacts that are measured, at most.
MOST_ROWS = 50

#: How far a contact may be from what was meant, in restitution and relatively in stiffness.
NEAR_E, NEAR_K = 0.02, 0.05

#: Restitution of a contact that is not to rebound: no finite damping gives 0.
NO_REBOUND = 0.01


@dataclass(frozen=True, slots=True)
class Finding:
    """A trap in a scene: its name, the contact, and what the engine does, with the way out."""

    trap: str
    where: str
    says: str

    def __str__(self) -> str:
        return f"{self.trap}: {self.where}: {self.says}"


@dataclass(frozen=True, slots=True)
class Measured:
    """A contact in SI units, masses in kg (inf: fixed); None where `reason` says why, penetration without gravity too.

    `change` says what to write for what was probably meant, and what that was measured to give; empty if it is there.
    """

    where: str
    masses: tuple[float, float]
    restitution: float | None = None
    restitution_range: tuple[float, float] | None = None
    duration: float | None = None
    steps: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    penetration: float | None = None
    change: str = ""
    reason: str = ""


#: Traps: the name, how one is seen in a contact `c` (see `_facts`), and what the engine does, with the way out.
TRAPS: tuple[tuple[str, Callable[[Any], Any], str], ...] = (
    (
        "mixed-geoms",
        lambda c: c.mixed,
        "solref {c.mixed[0]} and {c.mixed[1]} are combined to {c.solref}, the smaller of each number; use a <pair>",
    ),
    ("override", lambda c: c.override, "every contact has solref {c.solref} instead of its own"),
    (
        "discrete",
        lambda c: c.discrete,
        "contacts are taken at the end of the step: an elastic one gives back less than it took, and refsafe replaces "
        "what the step cannot resolve; use Euler or implicitfast",
    ),
    (
        "mixed-signs",
        lambda c: c.mixed_signs,
        "solref ({c.solref[0]:g}, {c.solref[1]:g}) is neither (time constant, damping ratio), both positive, nor "
        "(-stiffness, -damping), both <= 0: the default (0.02, 1) replaces it",
    ),
    (
        "refsafe",
        lambda c: c.refsafe,
        "a time constant of {c.first:g} s is shorter than two steps of {c.step:g} s and becomes {c.two_steps:g} "
        "s, a stiffness {c.lower:.3g} times lower; shorten the step",
    ),
    (
        "not-newton-per-metre",
        lambda c: c.stiffness > 0 and c.dmin > FORCE_LEVEL,
        "a direct stiffness of {c.direct:g} is in 1/s^2: alone, this pair has {c.stiffness:.4g} N/m at most, and under "
        "solimp {c.dmin:g} to {c.dmax:g} a third body that pushes changes it; for N/m take impact-xval contact",
    ),
    (
        "long-step",
        lambda c: c.steps < FEWEST_STEPS,
        "a contact of {c.duration:.3g} s gets {c.steps:.2g} steps of {c.step:.3g} s; some "
        f"{FEWEST_STEPS} are the least for its restitution to be within 10 %, "
        "{c.hundredth:.2g} s the step for about 1 % (see impact-xval contact)",
    ),
    (
        "tolerance",
        lambda c: c.cg_tolerance > 0,
        "CG stops at {c.cg_tolerance:g} of an absolute measure: a contact whose accelerations are small gets part of "
        "its force, or none; use Newton, or tolerance 0",
    ),
)


def inspect_model(model: Any) -> list[Finding]:
    """Look for traps in a compiled mujoco.MjModel; one that many contacts share in the same words stands once."""
    facts = [_facts(model.opt, where[0], bodies) for bodies, where in contacts(model).items()]
    places: dict[tuple[str, str], list[str]] = {}
    for (trap, seen, says), c in itertools.product(TRAPS, facts):
        if seen(c):
            places.setdefault((trap, says.format(c=c)), []).append(c.where)
    return [Finding(trap, called(where), says) for (trap, says), where in places.items()]


def _facts(option: Any, where: str, bodies: Bodies) -> SimpleNamespace:
    """Facts of a contact under the names that `TRAPS` uses, in SI units."""
    mujoco: Any = import_module("mujoco")
    parameters = dict(bodies.pair)
    solref, mixed, (dmin, dmax, *_) = parameters["solref"], bodies.mixed, parameters["solimp"]
    override = option.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE
    step, two_steps = option.timestep, 2 * option.timestep
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
    duration = contact_time(rate / (2 * omega)) / omega if omega > 0 else math.inf
    if rate > 2 * omega > 0:  # a heavy dashpot decays fast, and the step has to resolve that too
        duration = min(duration, 2 * math.pi / rate)
    return SimpleNamespace(
        **locals(),
        cg_tolerance=option.tolerance if option.solver == mujoco.mjtSolver.mjSOL_CG else 0.0,
        direct=-first,
        stiffness=-first / bodies.inverse_weight,
        lower=(two_steps / first) ** 2 if refsafe else 1.0,
        steps=duration / step,
        hundredth=duration / 100,
    )


def measure_model(model: Any, speed: float = 1.0) -> list[Measured]:
    """Measure the contacts of a compiled model (mujoco.MjModel), one of each combination of parameters and masses.

    The speed at which bodies meet, in m/s, matters to contacts whose impedance depends on the depth.
    """
    rows, gravity = [], float(np.linalg.norm(model.opt.gravity))
    with Mujoco().running():  # without its warnings
        for bodies, where in itertools.islice(contacts(model).items(), MOST_ROWS):
            row = Measured(called(where), bodies.masses)
            try:
                alone = Alone(bodies, model.opt, model.opt.timestep, speed)
                row = replace(row, **alone.dropped(), penetration=alone.rest(bodies.masses[0] * gravity))
                rows.append(replace(row, change=_change(alone, row)))
            except Exception as error:  # of an engine that takes other numbers than these
                rows.append(replace(row, reason=str(error)))
    return rows


def _change(alone: Alone, row: Measured) -> str:
    """Say what to write for what was probably meant, and what that does; nothing where the contact is near it.

    A direct solref was meant in N/m and N s/m, unless it is at the level of forces; a damping ratio as in textbooks,
    whose contact may pull, and has no rebound from a ratio of 1 on.
    """
    bodies, given = alone.bodies, dict(alone.bodies.pair)
    solref, solimp = given["solref"], given["solimp"]
    first, second = map(abs, solref)
    direct = solref[0] < 0
    if direct:
        forces = solimp[0] <= FORCE_LEVEL and solref[1] <= 0
        unit = 1 / bodies.inverse_weight if forces else 1.0
        meant = Contact(first * unit, second * unit, bodies.mass)
        own = mujoco_contact(replace(meant, mass=1 / bodies.inverse_weight))
        solref, solimp, safe = own.solref, own.solimp, math.inf
        asked = f"{meant.k:.4g} N/m and {meant.c:.4g} N s/m"
    elif first and second:
        e = math.exp(-math.pi * second / math.sqrt(1 - second**2)) if second < 1 else 0.0
        meant = Contact.from_restitution(bodies.mass / (first * second) ** 2, max(e, NO_REBOUND), bodies.mass)
        solref = mujoco_contact(meant, "documented").solref
        safe = solref[0] / 2.2  # short enough for refsafe to leave a time constant as it is
        asked = f"e = {e:.2g}" if e > NO_REBOUND else f"no rebound (e = {NO_REBOUND})"
    else:
        return ""
    off = max(abs(e - meant.restitution) for e in row.restitution_range or ())
    soft = direct and (row.stiffness is None or abs(row.stiffness / meant.k - 1) > NEAR_K)
    if off <= NEAR_E and not soft:
        return ""
    step = min(alone.step, float(f"{min(meant.duration / 100, safe):.2g}"))
    pair = ("solref", solref), ("solimp", solimp), ("condim", 1)
    try:
        then = Alone(bodies._replace(pair=pair), alone.option, step, alone.speed).dropped()
        gives = f"gives e = {then['restitution']:.3g} and {then.get('stiffness', math.nan):.4g} N/m"
    except RuntimeError as error:
        gives = f"was not measured: {error}"
    numbers = (" ".join(f"{number:.6g}" for number in each) for each in (solref, solimp))
    paste = '<pair condim="1" solref="{}" solimp="{}"/>'.format(*numbers)
    return f"for {asked}: {paste} and a step of {step:g} s, which {gives}"
