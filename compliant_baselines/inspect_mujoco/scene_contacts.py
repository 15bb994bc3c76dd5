"""The contacts of a compiled MuJoCo scene, and the masses, parameters and joints of their bodies.

A body on joints has its mass in the direction in which it moves most easily. Damping and dry friction of the joints
count in that direction.
"""

from __future__ import annotations

import math
from copy import copy
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.mapping import MUJOCO_DEFAULT_SOLIMP, MUJOCO_DEFAULT_SOLREF

mujoco: Any = import_module("mujoco")  # the names of the compiled module are invisible to a type checker

#: The parameters of a contact: the engine's array of pairs (without ``pair_``) and the attribute of its mjContact.
_PARAMETERS = {
    "solref": "solref",
    "solimp": "solimp",
    "friction": "friction",
    "solreffriction": "solreffriction",
    "dim": "dim",
    "margin": "includemargin",
    **({"adhesion": "adhesion"} if hasattr(mujoco.MjContact, "adhesion") else {}),  # from 3.11 on
}

#: The stage that makes the mass matrix, as the engine calls it; from 3.3 on it adds the inertia of tendons.
_MASS_MATRIX = "makeM" if hasattr(mujoco, "mj_makeM") else "crb"

#: Distance in m below which all geoms count as touching, so that contacts of distant geoms are found too.
_EVERYWHERE = 1e9


class Losses(NamedTuple):
    """Damping and dry friction that the joints of a body oppose to its motion along the normal."""

    #: In N s/m.
    damping: float = 0.0
    #: Dry friction in N.
    friction: float = 0.0
    #: Of the dry friction, of the joint that has most of it.
    solref: tuple[float, ...] = MUJOCO_DEFAULT_SOLREF
    solimp: tuple[float, ...] = MUJOCO_DEFAULT_SOLIMP


class Bodies(NamedTuple):
    """The two bodies of a contact, the lighter first, and the parameters of the contact."""

    #: Along the normal, in kg; inf if fixed.
    masses: tuple[float, float]
    #: The engine's `body_invweight0` of each.
    weights: tuple[tuple[float, ...], ...]
    #: Parameters of a `pair` that has this contact, by the names of the engine's arrays.
    pair: tuple[tuple[str, Any], ...]
    #: Sum of the mass matrix's diagonal; the solver divides by it what it compares with its tolerance.
    inertia: float
    losses: tuple[Losses, Losses] = (Losses(), Losses())
    #: The solrefs of two geoms, if one of them is direct and the engine has mixed them.
    mixed: tuple[Any, ...] | None = None

    @property
    def mass(self) -> float:
        """Reduced mass in kg."""
        return 1 / (1 / self.masses[0] + 1 / self.masses[1])

    @property
    def scale(self) -> float:
        """Mass in kg by which the engine scales a direct solref: one over the sum of the inverse weights."""
        return 1 / sum(weight[0] for weight in self.weights)

    @property
    def solref(self) -> tuple[float, float]:
        """The solref of the contact."""
        return dict(self.pair)["solref"]

    @property
    def solimp(self) -> tuple[float, float, float, float, float]:
        """The solimp of the contact."""
        return dict(self.pair)["solimp"]


def read_contacts(model: Any) -> dict[Bodies, list[str]]:
    """Find all contacts of a compiled model; give their bodies, and the names of the contacts that are alike.

    The engine itself says which geoms can touch, and combines their parameters. In a copy of the scene all geoms are at
    one place, and have a shape whose overlap the engine always finds. <pair>s come first.
    """
    near = _everything_near(model)
    data = mujoco.MjData(near)
    for stage in ("kinematics", "comPos", "tendon", _MASS_MATRIX, "factorM"):
        getattr(mujoco, f"mj_{stage}")(near, data)
    masses, losses = zip(*(_mass_and_losses(near, data, i) for i in range(model.nbody)), strict=True)
    data.geom_xpos[:] = 0
    mujoco.mj_collision(near, data)
    # A geom of -1 is a flex.
    touching = {
        tuple(sorted(contact.geom.tolist())): contact for contact in data.contact if contact.geom.min() >= 0
    }
    pair_geoms = np.sort([model.pair_geom1, model.pair_geom2], axis=0).T.tolist()
    pairs = {tuple(geoms): i for i, geoms in enumerate(pair_geoms)}
    found: dict[Bodies, list[str]] = {}
    for geoms in sorted(touching, key=lambda geoms: (pairs.get(geoms, model.npair), geoms)):
        light, heavy = sorted(model.geom_bodyid[[*geoms]].tolist(), key=masses.__getitem__)
        if masses[light] == math.inf:
            continue
        values = ((name, np.ravel(getattr(touching[geoms], field))) for name, field in _PARAMETERS.items())
        pair = tuple((name, tuple(value.tolist())) for name, value in values)
        bodies = Bodies(
            masses=(masses[light], masses[heavy]),
            weights=(_round(model.body_invweight0[light]), _round(model.body_invweight0[heavy])),
            pair=pair,
            inertia=_inertia(near, data, light, heavy),
            losses=(losses[light], losses[heavy]),
            mixed=_mixed_solrefs(model, geoms, geoms in pairs, dict(pair)["solref"]),
        )
        found.setdefault(bodies, []).append(_name_of(model, geoms, pairs.get(geoms)))
    return found


def _everything_near(model: Any) -> Any:
    """Copy a model so that every two of its geoms can be made to touch."""
    near = copy(model)
    near.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    near.opt.enableflags &= ~flag("mjtEnableBit", "mjENBL_SLEEP")
    near.body_margin[:] = _EVERYWHERE
    near.geom_type[near.geom_type > int(mujoco.mjtGeom.mjGEOM_HFIELD)] = int(mujoco.mjtGeom.mjGEOM_SPHERE)
    return near


def _mixed_solrefs(model: Any, geoms: tuple[int, ...], is_pair: bool, solref: Any) -> tuple[Any, ...] | None:
    """Return the solrefs of two geoms if the engine has mixed them and the result is direct; else None."""
    is_overridden = bool(model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_OVERRIDE))
    first, second = (tuple(model.geom_solref[geom].tolist()) for geom in geoms)
    one_has_priority = np.ptp(model.geom_priority[[*geoms]]) > 0
    if is_pair or is_overridden or first == second or one_has_priority or min(solref) > 0:
        return None
    return first, second


def _name_of(model: Any, geoms: tuple[int, ...], pair: int | None) -> str:
    """Name a contact by its <pair>, if it has one, or by its geoms."""
    names = " and ".join(model.geom(geom).name or f"#{geom}" for geom in geoms)
    return f"geoms {names}" if pair is None else f"pair {model.pair(pair).name or names}"


def _mass_and_losses(model: Any, data: Any, body: int) -> tuple[float, Losses]:
    """Return the mass in kg in the direction in which a body moves most easily, and the losses of its joints there.

    The mass is one over the largest eigenvalue of J M^-1 J^T, with the Jacobian J of the centre of mass.
    """
    jacobian, solved = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
    mujoco.mj_solveM(model, data, solved, jacobian)
    eigenvalues, directions = np.linalg.eigh(jacobian @ solved.T)
    largest = float(eigenvalues[-1])
    if largest <= 0:
        return math.inf, Losses()
    # Rates of the joints when a push moves the body at 1 m/s in this direction.
    rates = np.abs(directions[:, -1] @ solved) / largest
    friction = rates * model.dof_frictionloss
    losses = Losses()
    if friction.any() or (rates * model.dof_damping).any():
        joint = int(friction.argmax())
        damping, dry = _round([rates**2 @ model.dof_damping, friction.sum()])
        losses = Losses(damping, dry, _round(model.dof_solref[joint]), _round(model.dof_solimp[joint]))
    return _round(1 / largest)[0], losses


def _inertia(model: Any, data: Any, *bodies: int) -> float:
    """Return the sum of the diagonal of the mass matrix, in kg and kg m^2, by which the solver divides its measures.

    It runs over all degrees of freedom that are solved together: the trees of the two bodies, or the whole scene where
    it is not solved island by island.
    """
    dofs: NDArray[np.intp] = np.arange(int(model.nv))
    if _has_islands(model.opt):
        trees = [tree for tree in model.body_treeid[[*bodies]].tolist() if tree >= 0]
        dofs = dofs[np.isin(model.dof_treeid, trees)]
    diagonal: list[float] = []
    row, unit_vectors = np.empty(int(model.nv)), np.eye(int(model.nv))
    for dof in dofs.tolist():
        mujoco.mj_mulM(model, data, row, unit_vectors[dof])
        diagonal.append(float(row[dof]))
    return _round(sum(diagonal))[0]


def _has_islands(option: Any) -> bool:
    """Tell whether constraints are solved island by island: by default from 3.3 on, before where a flag asks for it."""
    if disables := flag("mjtDisableBit", "mjDSBL_ISLAND"):
        return not option.disableflags & disables
    return bool(option.enableflags & flag("mjtEnableBit", "mjENBL_ISLAND"))


def flag(kind: str, name: str) -> int:
    """Return the bit of a flag of the engine's options; 0 in a version that has no such flag."""
    return int(getattr(getattr(mujoco, kind), name, 0))


def _round(values: Any) -> tuple[float, ...]:
    """Round to twelve digits, which are the same for bodies that are alike."""
    return tuple(float(f"{value:.12g}") for value in np.ravel(values))
