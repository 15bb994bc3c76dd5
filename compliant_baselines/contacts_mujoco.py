"""The contacts that a MuJoCo scene can have, and each of them in a scene of its own.

That scene has two spheres on vertical slides; a fixed body is a plane. What decides a contact is that of the user's
scene: attributes of the geoms, which the engine combines here as there, or of the <pair>; masses and inverse weights. A
sphere has one contact, where a box that lands on a face shares its load among four. A body on joints counts with its
mass in the direction in which it moves most easily.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

#: Geom pairs looked at, at most.
MOST_PAIRS = 100_000

#: Attributes of a geom and of a <pair> that decide a contact, besides the condim of a <pair>.
_GEOM = ("solref", "solimp", "solmix", "priority", "margin", "gap", "friction", "condim", "adhesion")
_PAIR = ("solref", "solimp", "margin", "gap", "friction", "solreffriction", "adhesion")

#: Names and values of attributes.
_Attributes = tuple[tuple[str, Any], ...]


class Bodies(NamedTuple):
    """The two bodies of a contact, the lighter first."""

    #: Along the normal, in kg; inf if fixed.
    masses: tuple[float, float]
    #: `body_invweight0` of each.
    weights: tuple[tuple[float, ...], ...]
    #: Attributes of the geom of each, and of the <pair>; empty without one.
    geoms: tuple[_Attributes, ...]
    pair: _Attributes

    @property
    def mass(self) -> float:
        """Reduced mass in kg."""
        return 1 / (1 / self.masses[0] + 1 / self.masses[1])

    @property
    def inverse_weight(self) -> float:
        """Sum of the inverse weights by which the engine scales a direct solref, in 1/kg."""
        return sum(weight[0] for weight in self.weights)


def places(model: Any) -> Iterator[tuple[str, tuple[int, int], int | None]]:
    """List the contacts of a compiled model: those of <pair>s, then geoms that can touch without one.

    Of each what it is called, its geoms by number, and the number of its <pair>, None without one.

    Left out are geoms whose contype and conaffinity do not match, of bodies without a joint between them, of a body and
    its parent (unless that is fixed, or the filter off), of bodies that <exclude> names, and flat ones among themselves
    (the engine's chapter "Computation", section "Collision detection").
    """
    mujoco: Any = import_module("mujoco")
    off = mujoco.mjtDisableBit
    if model.opt.disableflags & (off.mjDSBL_CONTACT | off.mjDSBL_CONSTRAINT):
        return
    pairs = [(int(a), int(b)) for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)]
    for i, (a, b) in enumerate(pairs):
        yield f"pair {model.pair(i).name or _names(model, a, b)}", (a, b), i
    own, excluded = {frozenset(pair) for pair in pairs}, set(model.exclude_signature.tolist())
    filters = not model.opt.disableflags & off.mjDSBL_FILTERPARENT
    flat = {int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)}
    weld = model.body_weldid.tolist()
    above = [weld[parent] for parent in model.body_parentid.tolist()]
    columns = model.geom_bodyid, model.geom_contype, model.geom_conaffinity, model.geom_type
    geoms = list(enumerate(zip(*(column.tolist() for column in columns), strict=True)))
    for (a, one), (b, two) in itertools.islice(itertools.combinations(geoms, 2), MOST_PAIRS):
        (body_a, type_a, affinity_a, shape_a), (body_b, type_b, affinity_b, shape_b) = one, two
        low, high = weld[body_a], weld[body_b]
        kin = filters and low and high and (low == above[body_b] or high == above[body_a])
        meet = (type_a & affinity_b or type_b & affinity_a) and not (shape_a in flat and shape_b in flat)
        signature = (min(body_a, body_b) << 16) + max(body_a, body_b)
        if meet and low != high and not kin and signature not in excluded and frozenset((a, b)) not in own:
            yield f"geoms {_names(model, a, b)}", (a, b), None


def _names(model: Any, *geoms: int) -> str:
    return " and ".join(model.geom(geom).name or f"#{geom}" for geom in geoms)


def contacts(model: Any) -> dict[Bodies, list[str]]:
    """Bodies of all contacts but those of two fixed ones, alike ones together: what each contact is called."""
    mujoco: Any = import_module("mujoco")
    data = mujoco.MjData(model)
    # What inertia needs, without collisions.
    for stage in (
        mujoco.mj_kinematics,
        mujoco.mj_comPos,
        mujoco.mj_tendon,
        mujoco.mj_makeM,
        mujoco.mj_factorM,
    ):
        stage(model, data)
    masses = [_mass(model, data, i) for i in range(model.nbody)]
    weights = [_rounded(weight) for weight in model.body_invweight0]
    geoms = [_read(model, "geom", i, _GEOM) for i in range(model.ngeom)]
    found: dict[Bodies, list[str]] = {}
    for where, both, pair in places(model):
        one, two = sorted(both, key=lambda geom: masses[model.geom_bodyid[geom]])
        a, b = model.geom_bodyid[[one, two]].tolist()
        own: _Attributes = ()
        if pair is not None:
            own = (*_read(model, "pair", pair, _PAIR), ("condim", int(model.pair_dim[pair])))
        if math.isfinite(masses[a]):
            alike = Bodies((masses[a], masses[b]), (weights[a], weights[b]), (geoms[one], geoms[two]), own)
            found.setdefault(alike, []).append(where)
    return found


def called(where: list[str]) -> str:
    """Name places that have something in common: the first, and how many others."""
    return where[0] + (f" and {len(where) - 1} more" if len(where) > 1 else "")


def _mass(model: Any, data: Any, body: int) -> float:
    """Mass in the direction in which a body moves most easily, in kg: one over the largest eigenvalue of J M^-1 J^T."""
    if model.body_weldid[body] == 0 or not model.nv:
        return math.inf
    mujoco: Any = import_module("mujoco")
    jacobian, solved = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
    mujoco.mj_solveM(model, data, solved, jacobian)
    most = float(np.linalg.eigvalsh(jacobian @ solved.T)[-1])
    return _rounded(1 / most)[0] if most > 0 else math.inf


def _rounded(values: Any) -> tuple[float, ...]:
    """Twelve digits: the same for bodies that are alike."""
    return tuple(float(f"{value:.12g}") for value in np.ravel(values))


def _read(model: Any, what: str, i: int, names: tuple[str, ...]) -> _Attributes:
    values = (getattr(model, f"{what}_{name}")[i].tolist() for name in names)
    return tuple((n, tuple(v) if isinstance(v, list) else v) for n, v in zip(names, values, strict=True))


def alone(bodies: Bodies, radius: float) -> Any:
    """Compile a scene of two bodies that touch at a height of zero, the lighter one above; radius in m."""
    mujoco: Any = import_module("mujoco")
    spec, kinds = mujoco.MjSpec(), mujoco.mjtGeom
    for name, mass, height, attributes in zip(
        "AB", bodies.masses, (radius, -radius), bodies.geoms, strict=True
    ):
        body, shape = spec.worldbody, {"type": kinds.mjGEOM_PLANE, "size": (0, 0, 1)}
        if math.isfinite(mass):
            inertial = {"mass": mass, "inertia": (mass, mass, mass), "explicitinertial": True}
            body = spec.worldbody.add_body(name=name, pos=(0, 0, height), **inertial)
            body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, 1))
            shape = {"type": kinds.mjGEOM_SPHERE, "size": (radius, 0, 0)}
        meets = 0 if bodies.pair else 1
        body.add_geom(name=name, contype=meets, conaffinity=meets, **shape, **dict(attributes))
    if bodies.pair:
        spec.add_pair(geomname1="A", geomname2="B", **dict(bodies.pair))
    model = spec.compile()
    model.body_invweight0[1:] = bodies.weights[: model.nbody - 1]
    return model
