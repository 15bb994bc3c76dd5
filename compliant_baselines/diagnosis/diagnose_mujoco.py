"""The traps of MuJoCo, looked for in a compiled model.

Each is documented by the engine (XML reference, "Solver parameters" and the options; changelog of 3.13), and each is
shown by a test that sets it and measures what it does:

* ``mixed-signs``: a solref of one positive and one negative number is replaced by the default (0.02, 1).
* ``refsafe``: a time constant shorter than two steps is replaced by two steps.
* ``discrete``: the integrator takes contact forces at the end of the step, which dissipates, and its refsafe
  replaces stiff rows of the direct format too.
* ``not-newton-per-metre``: direct numbers are accelerations per length. Under the default solimp the force also depends
  on the masses that push from behind.
* ``mixed-geoms``: direct numbers of two geoms are combined by element-wise minimum.
* ``override``: the override flag replaces every contact's parameters.
* ``tolerance``: an absolute number; under CG it ends the solver before a soft contact has all its force.
* ``long-step``: a step too long for the stiffest contact.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from importlib import import_module
from typing import Any, NamedTuple

from impact_xval.compliant_baselines.diagnosis.diagnosis import Finding, step_finding

#: Impedance from which a contact counts as not of the level of forces.
FORCE_LEVEL = 0.01

#: Geom pairs looked at, at most.
MOST_PAIRS = 100_000


class _Contact(NamedTuple):
    """A contact as the engine would make it: solref, least and greatest impedance, sum of inverse weights."""

    where: str
    solref: tuple[float, float]
    dmin: float
    dmax: float
    inverse_mass: float


def diagnose_mujoco(model: Any) -> list[Finding]:
    """Look for traps in a compiled model.

    Parameters
    ----------
    model : mujoco.MjModel
        The user's.

    Returns
    -------
    list of Finding
        Empty if there are none; a trap that many contacts share is told once.
    """
    mujoco: Any = import_module("mujoco")
    option = model.opt
    findings: list[Finding] = []
    contacts = [*_pairs(model), *_geom_pairs(model, findings)]
    overridden = bool(option.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE)
    if overridden and contacts:
        findings.append(
            Finding(
                "override",
                "option flag",
                f"every contact has solref {tuple(option.o_solref)} instead of its own",
            )
        )
        o_solref, o_solimp = tuple(map(float, option.o_solref)), option.o_solimp
        contacts = [
            c._replace(solref=o_solref, dmin=float(o_solimp[0]), dmax=float(o_solimp[1])) for c in contacts
        ]
    discrete = option.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
    if discrete and contacts:
        findings.append(
            Finding(
                "discrete",
                "option integrator",
                "contacts are taken at the end of the step: an elastic one gives back less than it took, and refsafe "
                "replaces what the step cannot resolve; use Euler or implicitfast",
            )
        )
    safe = not option.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE
    for contact in contacts:
        findings += _of_contact(contact, float(option.timestep), safe and not discrete)
    if contacts and option.solver == mujoco.mjtSolver.mjSOL_CG and option.tolerance > 0:
        findings.append(
            Finding(
                "tolerance",
                "option solver",
                f"CG stops at {option.tolerance:g} of an absolute measure: a contact whose accelerations are small "
                "gets part of its force, or none; use Newton, or tolerance 0",
            )
        )
    return _once(findings)


def _pairs(model: Any) -> Iterator[_Contact]:
    for i in range(model.npair):
        geoms = (int(model.pair_geom1[i]), int(model.pair_geom2[i]))
        name = model.pair(i).name or " and ".join(_name(model, geom) for geom in geoms)
        solref, solimp = model.pair_solref[i], model.pair_solimp[i]
        yield _Contact(
            f"pair {name}",
            (float(solref[0]), float(solref[1])),
            float(solimp[0]),
            float(solimp[1]),
            _inverse_mass(model, geoms),
        )


def _geom_pairs(model: Any, findings: list[Finding]) -> Iterator[_Contact]:
    """Contacts that two geoms make without a <pair>; one for each combination of parameters."""
    own = {frozenset((int(a), int(b))) for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)}
    seen: set[tuple[Any, ...]] = set()
    looked = 0
    for a in range(model.ngeom):
        for b in range(a + 1, model.ngeom):
            if looked >= MOST_PAIRS:
                return
            looked += 1
            if frozenset((a, b)) in own or not _collide(model, a, b):
                continue
            inverse = _inverse_mass(model, (a, b))
            key = tuple(
                (
                    *map(float, model.geom_solref[g]),
                    *map(float, model.geom_solimp[g]),
                    float(model.geom_solmix[g]),
                )
                for g in (a, b)
            )
            if (key, inverse) in seen or inverse == 0:
                continue
            seen.add((key, inverse))
            where = f"geoms {_name(model, a)} and {_name(model, b)}"
            solref, solimp, mixed = _mixed(model, a, b)
            if mixed and min(solref) <= 0:
                findings.append(
                    Finding(
                        "mixed-geoms",
                        where,
                        f"solref {key[0][:2]} and {key[1][:2]} are combined to {solref}, the smaller of each number; "
                        "use a <pair>",
                    )
                )
            yield _Contact(where, solref, solimp[0], solimp[1], inverse)


def _collide(model: Any, a: int, b: int) -> bool:
    body_a, body_b = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
    if model.body_weldid[body_a] == model.body_weldid[body_b]:
        return False
    return bool(
        (model.geom_contype[a] & model.geom_conaffinity[b])
        or (model.geom_contype[b] & model.geom_conaffinity[a])
    )


def _mixed(model: Any, a: int, b: int) -> tuple[tuple[float, float], tuple[float, float], bool]:
    """Parameters of two geoms' contact, and whether the engine combined different ones."""
    refs = [tuple(map(float, model.geom_solref[g])) for g in (a, b)]
    imps = [tuple(map(float, model.geom_solimp[g][:2])) for g in (a, b)]
    priorities = [int(model.geom_priority[g]) for g in (a, b)]
    if priorities[0] != priorities[1]:
        first = priorities.index(max(priorities))
        return (refs[first][0], refs[first][1]), (imps[first][0], imps[first][1]), False
    weights = [float(model.geom_solmix[g]) for g in (a, b)]
    share = weights[0] / sum(weights) if sum(weights) > 0 else 0.5
    if refs[0][0] > 0 and refs[1][0] > 0:
        ref = [share * x + (1 - share) * y for x, y in zip(*refs, strict=True)]
    else:
        ref = [min(x, y) for x, y in zip(*refs, strict=True)]
    imp = [share * x + (1 - share) * y for x, y in zip(*imps, strict=True)]
    return (ref[0], ref[1]), (imp[0], imp[1]), refs[0] != refs[1]


def _of_contact(contact: _Contact, step: float, safe: bool) -> list[Finding]:
    first, second = contact.solref
    findings: list[Finding] = []
    if (first > 0) != (second > 0):
        findings.append(
            Finding(
                "mixed-signs",
                contact.where,
                f"solref ({first:g}, {second:g}) is neither (time constant, damping ratio), both positive, nor "
                "(-stiffness, -damping), both <= 0: the default (0.02, 1) replaces it",
            )
        )
        first, second = 0.02, 1.0
    if first > 0:
        if safe and first < 2 * step:
            findings.append(
                Finding(
                    "refsafe",
                    contact.where,
                    f"a time constant of {first:g} s is shorter than two steps of {step:g} s and becomes "
                    f"{2 * step:g} s, a stiffness {(2 * step / first) ** 2:.3g} times lower; shorten the step",
                )
            )
            first = 2 * step
        # stiffness (d/(dmax tc dr))^2 and damping 2 d/(dmax tc) of the pair alone, at d = dmax
        omega, rate = 1 / (first * second), 2 / first
    else:
        omega, rate = math.sqrt(-first), -second
        if contact.dmin > FORCE_LEVEL and first < 0 and contact.inverse_mass > 0:
            k = -first / contact.inverse_mass
            findings.append(
                Finding(
                    "not-newton-per-metre",
                    contact.where,
                    f"a direct stiffness of {-first:g} is in 1/s^2: alone, this pair has {k:.4g} N/m at most, and "
                    f"under solimp {contact.dmin:g} to {contact.dmax:g} a third body that pushes changes it; for N/m "
                    "take impact-xval contact",
                )
            )
    long = step_finding(contact.where, omega, rate, step)
    return [*findings, *([long] if long else [])]


def _inverse_mass(model: Any, geoms: tuple[int, int]) -> float:
    return float(sum(model.body_invweight0[model.geom_bodyid[geom], 0] for geom in geoms))


def _name(model: Any, geom: int) -> str:
    return model.geom(geom).name or f"#{geom}"


def _once(findings: list[Finding]) -> list[Finding]:
    """Tell a trap once for all the contacts it is said of in the same words."""
    by_words: dict[tuple[str, str], list[str]] = {}
    for finding in findings:
        by_words.setdefault((finding.trap, finding.says), []).append(finding.where)
    return [
        Finding(trap, places[0] + (f" and {len(places) - 1} more" if len(places) > 1 else ""), says)
        for (trap, says), places in by_words.items()
    ]
