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

import itertools
import math
from collections.abc import Iterator
from importlib import import_module
from typing import Any, NamedTuple

from impact_xval.compliant_baselines.diagnosis.diagnosis import Finding, finding, long_step

#: Impedance from which a contact counts as not of the level of forces.
FORCE_LEVEL = 0.01

#: Geom pairs looked at, at most.
MOST_PAIRS = 100_000


class _Geom(NamedTuple):
    """What a geom brings to a contact: its solref, solimp (five numbers), share in a mixture and priority."""

    solref: tuple[float, ...]
    solimp: tuple[float, ...]
    solmix: float
    priority: int


class _Contact(NamedTuple):
    """A contact as the engine would make it: solref, least and greatest impedance, sum of inverse weights."""

    where: str
    solref: tuple[float, ...]
    dmin: float
    dmax: float
    inverse_mass: float
    mixed: tuple[_Geom, _Geom] | None = None  # of two geoms whose different solrefs the engine combines


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
    contacts = [*_pairs(model), *_geom_pairs(model)]
    if not contacts:
        return []
    findings = [
        finding("mixed-geoms", c.where, one=c.mixed[0].solref, two=c.mixed[1].solref, combined=c.solref)
        for c in contacts
        if c.mixed and min(c.solref) <= 0
    ]
    if option.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE:
        solref, (dmin, dmax, *_) = tuple(option.o_solref.tolist()), option.o_solimp.tolist()
        findings.append(finding("override", "option flag", solref=solref))
        contacts = [c._replace(solref=solref, dmin=dmin, dmax=dmax) for c in contacts]
    discrete = option.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
    if discrete:
        findings.append(finding("discrete", "option integrator"))
    safe = not option.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE
    for contact in contacts:
        findings += _of_contact(contact, float(option.timestep), safe and not discrete)
    if option.solver == mujoco.mjtSolver.mjSOL_CG and option.tolerance > 0:
        findings.append(finding("tolerance", "option solver", tolerance=option.tolerance))
    return _once(findings)


def _pairs(model: Any) -> Iterator[_Contact]:
    for i in range(model.npair):
        a, b = int(model.pair_geom1[i]), int(model.pair_geom2[i])
        name = model.pair(i).name or f"{geom_name(model, a)} and {geom_name(model, b)}"
        solref, solimp = model.pair_solref[i].tolist(), model.pair_solimp[i].tolist()
        yield _Contact(f"pair {name}", tuple(solref), solimp[0], solimp[1], _inverse_mass(model, a, b))


def _geom_pairs(model: Any) -> Iterator[_Contact]:
    """Contacts that two geoms make without a <pair>; one for each combination of parameters."""
    seen: set[tuple[_Geom, _Geom, float]] = set()
    for a, b in touching_geoms(model):
        one, two, inverse_mass = _geom(model, a), _geom(model, b), _inverse_mass(model, a, b)
        if inverse_mass == 0 or (one, two, inverse_mass) in seen:
            continue
        seen.add((one, two, inverse_mass))
        where = f"geoms {geom_name(model, a)} and {geom_name(model, b)}"
        if one.priority != two.priority:
            first = max(one, two, key=lambda geom: geom.priority)
            yield _Contact(where, first.solref, first.solimp[0], first.solimp[1], inverse_mass)
            continue
        share = one.solmix / (one.solmix + two.solmix) if one.solmix + two.solmix > 0 else 0.5
        solref = tuple(map(min, one.solref, two.solref))
        if one.solref[0] > 0 and two.solref[0] > 0:
            solref = _weighted(share, one.solref, two.solref)
        mixed = (one, two) if one.solref != two.solref else None
        dmin, dmax, *_ = _weighted(share, one.solimp, two.solimp)
        yield _Contact(where, solref, dmin, dmax, inverse_mass, mixed)


def _geom(model: Any, i: int) -> _Geom:
    solref, solimp = tuple(model.geom_solref[i].tolist()), tuple(model.geom_solimp[i].tolist())
    return _Geom(solref, solimp, float(model.geom_solmix[i]), int(model.geom_priority[i]))


def _weighted(share: float, one: tuple[float, ...], two: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(share * x + (1 - share) * y for x, y in zip(one, two, strict=True))


def touching_geoms(model: Any) -> Iterator[tuple[int, int]]:
    """List the geoms that can touch without a <pair>, as the engine filters them; of `MOST_PAIRS` pairs.

    Left out are geoms whose contype and conaffinity do not match, of bodies without a joint between them, of a body
    and its parent (unless the parent is fixed, or `filterparent` is off), of bodies that <exclude> names, and the two
    kinds of geoms, planes and height fields, that do not collide with each other
    (MuJoCo documentation, "Computation", section "Collision detection").
    """
    mujoco: Any = import_module("mujoco")
    own = {frozenset((int(a), int(b))) for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)}
    excluded = set(model.exclude_signature.tolist())
    parents = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    flat = {int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)}
    body, weld = model.geom_bodyid.tolist(), model.body_weldid.tolist()
    above = [weld[parent] for parent in model.body_parentid.tolist()]
    type_, affinity = model.geom_contype.tolist(), model.geom_conaffinity.tolist()
    kind = model.geom_type.tolist()
    for a, b in itertools.islice(itertools.combinations(range(model.ngeom), 2), MOST_PAIRS):
        one, two = sorted((body[a], body[b]))
        weld_one, weld_two = weld[one], weld[two]
        if (
            frozenset((a, b)) in own
            or not (type_[a] & affinity[b] or type_[b] & affinity[a])
            or weld_one == weld_two
            or (kind[a] in flat and kind[b] in flat)
            or (one << 16) + two in excluded
        ):
            continue
        chained = weld_one == above[weld_two] or weld_two == above[weld_one]
        if not (parents and weld_one and weld_two and chained):
            yield a, b


def _of_contact(contact: _Contact, step: float, safe: bool) -> list[Finding]:
    where, (first, second) = contact.where, contact.solref
    findings: list[Finding] = []
    if (first > 0) != (second > 0):
        findings.append(finding("mixed-signs", where, first=first, second=second))
        first, second = 0.02, 1.0
    if first > 0:
        if safe and first < 2 * step:
            findings.append(finding("refsafe", where, time_constant=first, step=step))
            first = 2 * step
        # stiffness (d/(dmax tc dr))^2 and damping 2 d/(dmax tc) of the pair alone, at d = dmax
        return findings + long_step(where, 1 / (first * second), 2 / first, step)
    if contact.dmin > FORCE_LEVEL and first < 0 and contact.inverse_mass > 0:
        k = -first / contact.inverse_mass
        facts = {"direct": -first, "stiffness": k, "dmin": contact.dmin, "dmax": contact.dmax}
        findings.append(finding("not-newton-per-metre", where, **facts))
    return findings + long_step(where, math.sqrt(-first), -second, step)


def _inverse_mass(model: Any, a: int, b: int) -> float:
    return float(sum(model.body_invweight0[model.geom_bodyid[geom], 0] for geom in (a, b)))


def geom_name(model: Any, geom: int) -> str:
    """Name a geom, by its number if it has no name."""
    return model.geom(geom).name or f"#{geom}"


def _once(findings: list[Finding]) -> list[Finding]:
    """Name a trap once for all the contacts of which the same words hold."""
    places: dict[tuple[str, str], list[str]] = {}
    for found in findings:
        places.setdefault((found.trap, found.says), []).append(found.where)
    return [
        Finding(trap, first + (f" and {len(others)} more" if others else ""), says)
        for (trap, says), (first, *others) in places.items()
    ]
