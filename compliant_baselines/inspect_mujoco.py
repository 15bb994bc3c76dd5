"""The contacts of a MuJoCo scene: the traps in their parameters, see `_traps`, and what they do, measured.

The engine documents each trap (XML reference, "Solver parameters" and the options; changelog of 3.13), and a test
measures its effect. Restitution and duration are the means of drops without gravity, touching at several places within
a step; k and c those of F = max(0, k delta + c delta') with the same two, whatever the engine's own law. At rest a
contact carries the weight of the lighter body, in the gravity of the scene.
"""

from __future__ import annotations

import math
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.contacts_mujoco import Bodies, contacts, measured, mujoco
from impact_xval.compliant_baselines.engines.mujoco import Mujoco
from impact_xval.compliant_baselines.mapping import (
    MUJOCO_DEFAULT_SOLIMP,
    MUJOCO_DEFAULT_SOLREF,
    Contact,
    MujocoContact,
    mujoco_contact,
)

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


class Finding(NamedTuple):
    """A trap in a scene: its name, the contacts, and what the engine does, with the way out."""

    trap: str
    where: list[str]
    says: str


class Measured(NamedTuple):
    """Contacts that are alike, in SI units, masses in kg (inf: fixed); None where `reason` says why.

    Penetration is None without gravity too.

    `change` says what to write for what was probably meant, and what that was measured to give; empty if it is there.
    """

    where: list[str]
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


def examine(speed: float, scene: Path) -> tuple[list[Measured], list[Finding]] | str:
    """Measure the contacts of a file, .mjb or MJCF, and look for traps; or say why MuJoCo does not take it."""
    load = mujoco.MjModel.from_binary_path if scene.suffix == ".mjb" else mujoco.MjModel.from_xml_path
    try:
        model = load(str(scene))
        return measure_model(model, speed), inspect_model(model)
    except Exception as error:  # of an engine that met what it does not expect
        return f"{scene}: MuJoCo does not compile it: {error}"


def inspect_model(model: Any) -> list[Finding]:
    """Look for traps in a compiled mujoco.MjModel; one that many contacts share in the same words stands once."""
    found = contacts(model)
    places: dict[tuple[str, str], list[str]] = {}
    # By trap, and then by contact.
    for of_trap in zip(*(_traps(model.opt, bodies).items() for bodies in found), strict=True):
        for where, (trap, says) in zip(found.values(), of_trap, strict=True):
            if says:
                places.setdefault((trap, says), []).extend(where)
    return [Finding(trap, where, says) for (trap, says), where in places.items()]


def called(where: list[str]) -> str:
    """Name contacts that have something in common, shortly: the first, and how many others."""
    return where[0] + (f" and {len(where) - 1} more" if len(where) > 1 else "")


def _traps(option: Any, bodies: Bodies) -> dict[str, Any]:
    """All traps: of one that a contact has, what the engine does, with the way out; of another something false."""
    solref, (dmin, dmax, *_) = (dict(bodies.pair)[name] for name in ("solref", "solimp"))
    step, tolerance = option.timestep, option.tolerance
    mixed_signs = (solref[0] > 0) != (solref[1] > 0)
    first, second = MUJOCO_DEFAULT_SOLREF if mixed_signs else solref
    discrete = option.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
    safe = not discrete and not option.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE
    acting = max(first, 2 * step) if safe and first > 0 else first
    k, c = (-number for number in MujocoContact((acting, second), MUJOCO_DEFAULT_SOLIMP).direct)
    # Of the pair alone, at d = dmax. A heavy dashpot decays faster than its contact ends; the step has to resolve that.
    duration = min(Contact(k, c, 1.0).duration, 2 * math.pi / c if c else math.inf) if k else math.inf
    stiffness = -first * bodies.scale
    return {
        "mixed-geoms": bodies.mixed
        and f"solref {' and '.join(map(str, bodies.mixed))} are combined to {solref}, the smaller of each number; use "
        "a <pair>",
        "override": option.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE
        and f"every contact has solref {solref} instead of its own",
        "discrete": discrete
        and "contacts are taken at the end of the step: an elastic one gives back less than it took, and refsafe "
        "replaces what the step cannot resolve; use Euler or implicitfast",
        "mixed-signs": mixed_signs
        and f"solref ({solref[0]:g}, {solref[1]:g}) is neither (time constant, damping ratio), both positive, nor "
        "(-stiffness, -damping), both <= 0: the default (0.02, 1) replaces it",
        "refsafe": acting != first
        and f"a time constant of {first:g} s is shorter than two steps of {step:g} s and becomes {acting:g} s, a "
        f"stiffness {(acting / first) ** 2:.3g} times lower; shorten the step",
        "not-newton-per-metre": stiffness > 0
        and dmin > FORCE_LEVEL
        and f"a direct stiffness of {-first:g} is in 1/s^2: the spring of this pair alone has {stiffness:.4g} N/m at "
        f"most, and under solimp {dmin:g} to {dmax:g} a third body changes it; for N/m take impact-xval contact",
        "long-step": duration / step < FEWEST_STEPS
        and f"a contact of {duration:.3g} s gets {duration / step:.2g} steps of {step:.3g} s; some {FEWEST_STEPS} are "
        f"the least for its restitution to be within 10 %, {duration / 100:.2g} s the step for about 1 % (see "
        "impact-xval contact)",
        "tolerance": option.solver == mujoco.mjtSolver.mjSOL_CG
        and tolerance > 0
        and f"CG stops at {tolerance:g} of an absolute measure: a contact whose accelerations are small gets part of "
        "its force, or none; use Newton, or tolerance 0",
    }


def measure_model(model: Any, speed: float = 1.0) -> list[Measured]:
    """Measure the contacts of a compiled model (mujoco.MjModel), one of each combination of parameters and masses.

    The speed at which bodies meet, in m/s, matters to contacts whose impedance depends on the depth.
    """
    rows, gravity = [], float(np.linalg.norm(model.opt.gravity))
    with Mujoco().running():  # without its warnings
        for bodies, where in list(contacts(model).items())[:MOST_ROWS]:
            row = Measured(where, bodies.masses)
            try:
                row = row._replace(**measured(bodies, model.opt, model.opt.timestep, speed, gravity))
                rows.append(row._replace(change=_change(bodies, model.opt, speed, row)))
            except Exception as error:  # of an engine that takes other numbers than these
                rows.append(row._replace(reason=str(error)))
    return rows


def _change(bodies: Bodies, option: Any, speed: float, row: Measured) -> str:
    """Say what to write for what was probably meant, and what that does; nothing where the contact is near it.

    A direct solref was meant in N/m and N s/m, unless it is at the level of forces; a damping ratio as in textbooks,
    whose contact may pull, and has no rebound from a ratio of 1 on.
    """
    solref, solimp = (dict(bodies.pair)[name] for name in ("solref", "solimp"))
    (first, second), direct, longest = map(abs, solref), solref[0] < 0, math.inf
    if direct:
        unit = bodies.scale if solimp[0] <= FORCE_LEVEL and solref[1] <= 0 else 1.0
        meant = Contact(first * unit, second * unit, bodies.mass)
        solref, solimp = astuple(mujoco_contact(replace(meant, mass=bodies.scale)))
        asked = f"{meant.k:.4g} N/m and {meant.c:.4g} N s/m"
    elif first and second:
        e = math.exp(-math.pi * second / math.sqrt(1 - second**2)) if second < 1 else 0.0
        meant = Contact.from_restitution(bodies.mass / (first * second) ** 2, max(e, NO_REBOUND), bodies.mass)
        solref = mujoco_contact(meant, "documented").solref
        longest = solref[0] / 2.2  # short enough for refsafe to leave a time constant as it is
        asked = f"e = {e:.2g}" if e > NO_REBOUND else f"no rebound (e = {NO_REBOUND})"
    else:
        return ""
    off = max(abs(e - meant.restitution) for e in row.restitution_range or ())
    soft = direct and (row.stiffness is None or abs(row.stiffness / meant.k - 1) > NEAR_K)
    if off <= NEAR_E and not soft:
        return ""
    step = min(option.timestep, float(f"{min(meant.duration / 100, longest):.2g}"))
    pair = ("solref", solref), ("solimp", solimp), ("dim", 1)
    try:
        then = measured(bodies._replace(pair=pair), option, step, speed)
        gives = f"gives e = {then['restitution']:.3g} and {then.get('stiffness', math.nan):.4g} N/m"
    except RuntimeError as error:
        gives = f"was not measured: {error}"
    numbers = (" ".join(f"{number:.6g}" for number in each) for each in (solref, solimp))
    paste = '<pair condim="1" solref="{}" solimp="{}"/>'.format(*numbers)
    return f"for {asked}: {paste} and a step of {step:g} s, which {gives}"
