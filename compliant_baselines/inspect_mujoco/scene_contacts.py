"""The contacts of a compiled MuJoCo scene, with the masses, parameters and joints of their bodies.

The mass of a body on joints depends on the direction. Here it is the mass in the direction in which the body moves most
easily. Damping and dry friction of the joints are computed for the same direction.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from copy import copy
from importlib import import_module
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.mapping import MUJOCO_DEFAULT_SOLIMP, MUJOCO_DEFAULT_SOLREF

mujoco: Any = import_module("mujoco")  # type checkers do not see the names of the compiled module

#: Parameters of a contact: the name in the engine's arrays of pairs (without ``pair_``), and the name in its mjContact.
_PARAMETERS = {
    "solref": "solref",
    "solimp": "solimp",
    "friction": "friction",
    "solreffriction": "solreffriction",
    "dim": "dim",
    "margin": "includemargin",
    # this parameter exists from MuJoCo 3.11 on
    **({"adhesion": "adhesion"} if hasattr(mujoco.MjContact, "adhesion") else {}),
}

#: Name of the engine's function that computes the mass matrix. From MuJoCo 3.3 on it also adds the inertia of tendons.
_MASS_MATRIX = "makeM" if hasattr(mujoco, "mj_makeM") else "crb"

#: Largest number of geoms of a scene in which the contacts of all geoms are examined. In a larger scene only some geoms
#: of each kind are examined.
MOST_GEOMS = 60

#: Number of geoms of a kind that are examined in a larger scene: so many on the lightest bodies, and on the heaviest.
GEOMS_PER_END = 2

#: A margin in m that is larger than any scene. With it the engine finds the contacts of distant geoms too.
_EVERYWHERE = 1e9


#: Where the parameters of a contact come from: a <pair>, the flag `override`, the geom of higher priority, two geoms
#: with the same parameters, or two geoms whose parameters the engine mixes.
RULES = ("pair", "override", "priority", "same", "mixed")


class MujocoOption(Protocol):
    """The members of `mujoco.MjOption` that are read."""

    #: Time step in s.
    timestep: float
    tolerance: float
    integrator: int
    cone: int
    disableflags: int
    enableflags: int


class Losses(NamedTuple):
    """Damping and dry friction that the joints of a body add to its motion along the normal."""

    #: Damping in N s/m.
    damping: float = 0.0
    #: Dry friction in N.
    friction: float = 0.0
    #: Parameters of the dry friction of the joint in which it is largest.
    solref: tuple[float, ...] = MUJOCO_DEFAULT_SOLREF
    solimp: tuple[float, ...] = MUJOCO_DEFAULT_SOLIMP


class Bodies(NamedTuple):
    """The two bodies of a contact, the lighter one first, and the parameters of the contact."""

    #: Masses along the normal in kg; inf for a fixed body.
    masses: tuple[float, float]
    #: The engine's inverse weights of each body (`body_invweight0`).
    weights: tuple[tuple[float, ...], ...]
    #: Parameters of the contact as a <pair> would have them, by the names of the engine's arrays.
    pair: tuple[tuple[str, Any], ...]
    #: Sum of the diagonal of the mass matrix. The solver divides its measure of convergence by this sum, and then
    #: compares the measure with its tolerance.
    inertia: float
    losses: tuple[Losses, Losses] = (Losses(), Losses())
    #: The solrefs of the two geoms, if the engine has mixed them and at least one is direct; else None.
    mixed: tuple[tuple[float, float], tuple[float, float]] | None = None
    #: Where the parameters come from, one of `RULES`.
    rule: str = "pair"
    #: Number of points of contact if one body lies flat on the other one.
    points: int = 1

    @property
    def parameters(self) -> tuple[tuple[str, Any], ...]:
        """The parameters of the contact without friction and without the bodies, and the rule that combines them."""
        return (*((name, value) for name, value in self.pair if "friction" not in name), ("rule", self.rule))

    @property
    def mass(self) -> float:
        """Reduced mass in kg."""
        return 1 / (1 / self.masses[0] + 1 / self.masses[1])

    @property
    def scale(self) -> float:
        """Mass in kg by which the engine multiplies a direct solref: one over the sum of the inverse weights."""
        return 1 / sum(weight[0] for weight in self.weights)

    @property
    def solref(self) -> tuple[float, float]:
        """The solref of the contact."""
        return dict(self.pair)["solref"]

    @property
    def solimp(self) -> tuple[float, float, float, float, float]:
        """The solimp of the contact."""
        return dict(self.pair)["solimp"]


class SceneContact(NamedTuple):
    """A contact of a scene, with its two geoms and the bodies to which they belong."""

    name: str
    #: The two geoms, the smaller number first.
    geoms: tuple[int, int]
    bodies: Bodies
    geom_names: tuple[str, str]
    #: The solref of each geom.
    solrefs: tuple[tuple[float, float], tuple[float, float]]


def read_contacts(model: Any) -> dict[Bodies, list[str]]:
    """Find the contacts of a compiled model, and return their names by the bodies and parameters that they share.

    In a scene with more than `MOST_GEOMS` geoms only some geoms of each kind are examined.
    """
    found: dict[Bodies, list[str]] = {}
    for contact in find_contacts(model):
        found.setdefault(contact.bodies, []).append(contact.name)
    return found


def find_contacts(model: Any, selected: Iterable[int] | None = None) -> list[SceneContact]:
    """Return the contacts of a compiled model; contacts of <pair>s come first.

    The engine itself decides which geoms can touch, and combines their parameters. To this end all geoms in a copy of
    the scene are moved to one place, and get a shape whose overlap the engine always finds. `selected` are the geoms
    that are examined in addition to the geoms of <pair>s; by default these are `select_geoms`.
    """
    near = _everything_near(model)
    _make_others_pass(near, {*(select_geoms(model) if selected is None else selected)})
    data = mujoco.MjData(near)
    for stage in ("kinematics", "comPos", "tendon", _MASS_MATRIX, "factorM"):
        getattr(mujoco, f"mj_{stage}")(near, data)
    data.geom_xpos[:] = 0
    mujoco.mj_collision(near, data)
    # A geom number of -1 stands for a flex, a soft body.
    touching = {
        tuple(sorted(geoms)): n for n, geoms in enumerate(data.contact.geom.tolist()) if min(geoms) >= 0
    }
    columns = [
        (name, getattr(data.contact, field).reshape(len(data.contact), -1).tolist())
        for name, field in _PARAMETERS.items()
    ]
    pair_geoms = np.sort([model.pair_geom1, model.pair_geom2], axis=0).T.tolist()
    pairs = {tuple(geoms): i for i, geoms in enumerate(pair_geoms)}
    of_bodies, rules, bodies_of_geoms = _BodyNumbers(near, data), _Rules(model), model.geom_bodyid.tolist()
    contacts: list[SceneContact] = []
    for geoms in sorted(touching, key=lambda geoms: (pairs.get(geoms, model.npair), geoms)):
        light, heavy = sorted((bodies_of_geoms[geom] for geom in geoms), key=of_bodies.mass)
        if of_bodies.mass(light) == math.inf:
            continue
        pair = tuple((name, tuple(values[touching[geoms]])) for name, values in columns)
        rule = rules.of(geoms, geoms in pairs)
        bodies = Bodies(
            masses=(of_bodies.mass(light), of_bodies.mass(heavy)),
            weights=(of_bodies.weights(light), of_bodies.weights(heavy)),
            pair=pair,
            inertia=of_bodies.inertia(light, heavy),
            losses=(of_bodies.losses(light), of_bodies.losses(heavy)),
            mixed=rules.mixed_solrefs(geoms, rule, dict(pair)["solref"]),
            rule=rule,
            points=_points_at_rest(model, geoms),
        )
        first, second = geoms
        contacts.append(
            SceneContact(
                name=_name_of(model, geoms, pairs.get(geoms)),
                geoms=geoms,
                bodies=bodies,
                geom_names=(name_of_geom(model, first), name_of_geom(model, second)),
                solrefs=(rules.solrefs[first], rules.solrefs[second]),
            )
        )
    return contacts


def name_of_geom(model: Any, geom: int) -> str:
    """Return the name of a geom, or its number after a "#" if it has none."""
    return model.geom(geom).name or f"#{geom}"


def select_geoms(model: Any) -> list[int]:
    """Return the indices of the geoms to examine. In a large scene they are at most `MOST_GEOMS`, some of each kind.

    Geoms of a kind have the same contact parameters. Those on the lightest and the heaviest bodies are taken.
    """
    geoms = list(range(model.ngeom))
    if model.ngeom <= MOST_GEOMS:
        return geoms
    fields = (
        "solref",
        "solimp",
        "solmix",
        "priority",
        "condim",
        "friction",
        "margin",
        "gap",
        "contype",
        "conaffinity",
    )
    is_fixed = model.body_weldid[model.geom_bodyid] == 0
    columns = [np.asarray(getattr(model, f"geom_{name}"), float).reshape(model.ngeom, -1) for name in fields]
    _, kinds = np.unique(np.column_stack([*columns, is_fixed]), axis=0, return_inverse=True)
    kinds = np.ravel(kinds)
    weights = model.body_invweight0[model.geom_bodyid, 0]
    selected: list[int] = []
    for kind in range(kinds.max() + 1):
        of_kind = np.flatnonzero(kinds == kind)
        # Only one geom of each body, because two geoms of one body do not touch.
        _, firsts = np.unique(model.geom_bodyid[of_kind], return_index=True)
        by_weight = of_kind[firsts][np.argsort(weights[of_kind[firsts]], kind="stable")].tolist()
        ends = [*by_weight[:GEOMS_PER_END], *by_weight[-GEOMS_PER_END:]]
        selected += [geom for geom in dict.fromkeys(ends)]
    return sorted(selected[:MOST_GEOMS])


def _make_others_pass(near: Any, selected: set[int]) -> None:
    """Let all geoms except the selected ones pass through each other."""
    if len(selected) == near.ngeom:
        return
    passes = np.ones(near.ngeom, bool)
    passes[[*selected]] = False
    near.geom_contype[passes] = near.geom_conaffinity[passes] = 0
    has_selected = np.zeros(near.nbody, bool)
    has_selected[near.geom_bodyid[~passes]] = True
    near.body_contype[~has_selected] = near.body_conaffinity[~has_selected] = 0


def _everything_near(model: Any) -> Any:
    """Return a copy of a model in which any two geoms can be made to touch."""
    near = copy(model)
    near.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    near.opt.enableflags &= ~flag("mjtEnableBit", "mjENBL_SLEEP")
    near.body_margin[:] = _EVERYWHERE
    near.geom_type[near.geom_type > int(mujoco.mjtGeom.mjGEOM_HFIELD)] = int(mujoco.mjtGeom.mjGEOM_SPHERE)
    return near


class _Rules:
    """The rules by which the engine combines the parameters of two geoms."""

    def __init__(self, model: Any) -> None:
        self._is_overridden = bool(model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_OVERRIDE))
        self._priorities = model.geom_priority.tolist()
        #: The solref of each geom.
        self.solrefs: list[tuple[float, float]] = list(map(tuple, model.geom_solref.tolist()))
        self._solimps = model.geom_solimp.tolist()

    def of(self, geoms: tuple[int, ...], is_pair: bool) -> str:
        """Return where the parameters of a contact come from, one of `RULES`."""
        first, second = geoms
        if self._is_overridden:
            return "override"
        if is_pair:
            return "pair"
        if self._priorities[first] != self._priorities[second]:
            return "priority"
        is_same = all(numbers[first] == numbers[second] for numbers in (self.solrefs, self._solimps))
        return "same" if is_same else "mixed"

    def mixed_solrefs(
        self, geoms: tuple[int, int], rule: str, solref: Sequence[float]
    ) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Return the solrefs of two geoms if the engine has mixed them to a direct solref; else None."""
        first, second = (self.solrefs[geom] for geom in geoms)
        if rule != "mixed" or first == second or min(solref) > 0:
            return None
        return first, second


#: Number of points of contact when a geom of this type lies flat on a plane or a box, on its longest side or on its
#: face. Other geoms have one point; for a mesh the number depends on the mesh.
_POINTS_ON_PLANE = {"mjGEOM_BOX": 4, "mjGEOM_CAPSULE": 2, "mjGEOM_CYLINDER": 3}
_POINTS_ON_BOX = {"mjGEOM_BOX": 4, "mjGEOM_CAPSULE": 2, "mjGEOM_CYLINDER": 4}


def _points_at_rest(model: Any, geoms: tuple[int, int]) -> int:
    """Return the number of points of contact when one of two geoms lies flat on the other one."""
    types = [mujoco.mjtGeom(int(model.geom_type[geom])).name for geom in geoms]
    for under, over in (types, types[::-1]):
        if under == "mjGEOM_PLANE":
            return _POINTS_ON_PLANE.get(over, 1)
    return max(
        (_POINTS_ON_BOX.get(over, 1) for under, over in (types, types[::-1]) if under == "mjGEOM_BOX"),
        default=1,
    )


def _name_of(model: Any, geoms: tuple[int, ...], pair: int | None) -> str:
    """Return a name for a contact: that of its <pair>, or one made of the names of its geoms."""
    names = " and ".join(name_of_geom(model, geom) for geom in geoms)
    return f"geoms {names}" if pair is None else f"pair {model.pair(pair).name or names}"


def _mass_and_losses(model: Any, data: Any, body: int) -> tuple[float, Losses]:
    """Return the mass in kg of a body in the direction in which it moves most easily, and what its joints add there.

    The mass is one over the largest eigenvalue of J M^-1 J^T, with the Jacobian J of the body's centre of mass and the
    mass matrix M of the scene.
    """
    jacobian, solved = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
    mujoco.mj_solveM(model, data, solved, jacobian)
    eigenvalues, directions = np.linalg.eigh(jacobian @ solved.T)
    largest = float(eigenvalues[-1])
    if largest <= 0:
        return math.inf, Losses()
    # Velocities of the joints when a push moves the body at 1 m/s in this direction.
    rates = np.abs(directions[:, -1] @ solved) / largest
    friction = rates * model.dof_frictionloss
    losses = Losses()
    if friction.any() or (rates * model.dof_damping).any():
        joint = int(friction.argmax())
        damping, dry = _round([rates**2 @ model.dof_damping, friction.sum()])
        losses = Losses(damping, dry, _round(model.dof_solref[joint]), _round(model.dof_solimp[joint]))
    return _round(1 / largest)[0], losses


class _BodyNumbers:
    """Masses, joint losses and inertias of the bodies of a model. Each number is computed when it is first needed."""

    def __init__(self, model: Any, data: Any) -> None:
        self._model, self._data = model, data
        self._of_bodies: dict[int, tuple[float, Losses]] = {}
        self._weights: dict[int, tuple[float, ...]] = {}
        self._inertias: dict[tuple[int, ...], float] = {}
        self._inertia_of_trees = np.bincount(model.dof_treeid, _mass_diagonal(model, data), minlength=1)
        self._has_islands = _has_islands(model.opt)
        self._trees = model.body_treeid.tolist()

    def mass(self, body: int) -> float:
        """Return the mass of a body in kg, in the direction in which it moves most easily."""
        return self._of_body(body)[0]

    def losses(self, body: int) -> Losses:
        """Return the damping and dry friction that joints add to the motion of a body in this direction."""
        return self._of_body(body)[1]

    def weights(self, body: int) -> tuple[float, ...]:
        """Return the engine's inverse weights of a body (`body_invweight0`)."""
        if body not in self._weights:
            self._weights[body] = _round(self._model.body_invweight0[body])
        return self._weights[body]

    def _of_body(self, body: int) -> tuple[float, Losses]:
        if body not in self._of_bodies:
            self._of_bodies[body] = _mass_and_losses(self._model, self._data, body)
        return self._of_bodies[body]

    def inertia(self, *bodies: int) -> float:
        """Return the sum of the mass matrix's diagonal, in kg and kg m^2, by which the solver divides its measures.

        The sum is over all degrees of freedom that are solved together: those of the trees of the two bodies, or those
        of the whole scene if the solver does not divide it into islands.
        """
        trees = tuple(sorted({self._trees[body] for body in bodies} - {-1})) if self._has_islands else ()
        if trees not in self._inertias:
            of_trees = self._inertia_of_trees[[*trees]] if self._has_islands else self._inertia_of_trees
            self._inertias[trees] = _round(of_trees.sum())[0]
        return self._inertias[trees]


def _mass_diagonal(model: Any, data: Any) -> NDArray[np.float64]:
    """Return the diagonal of the mass matrix, in kg and kg m^2.

    Degrees of freedom of different trees do not act on each other, unless a tendon with inertia connects them. So one
    product with the matrix gives one entry for each tree at once.
    """
    nv = int(model.nv)
    rounds = np.arange(nv)
    if nv and not getattr(model, "tendon_armature", np.zeros(0)).any():
        _, first_dofs, trees = np.unique(model.dof_treeid, return_index=True, return_inverse=True)
        rounds = rounds - first_dofs[np.ravel(trees)]
    diagonal, row = np.zeros(nv), np.empty(nv)
    for n in range(int(rounds.max(initial=-1)) + 1):
        mujoco.mj_mulM(model, data, row, (rounds == n).astype(float))
        diagonal[rounds == n] = row[rounds == n]
    return diagonal


def _has_islands(option: MujocoOption) -> bool:
    """Return True if the solver divides the scene into islands: by default from 3.3 on, before with a flag."""
    if disables := flag("mjtDisableBit", "mjDSBL_ISLAND"):
        return not option.disableflags & disables
    return bool(option.enableflags & flag("mjtEnableBit", "mjENBL_ISLAND"))


def flag(kind: str, name: str) -> int:
    """Return the bit of a flag of the engine's options; 0 in a version that has no such flag."""
    return int(getattr(getattr(mujoco, kind), name, 0))


def _round(values: Any) -> tuple[float, ...]:
    """Return numbers rounded to twelve digits. So equal bodies get equal numbers in spite of rounding."""
    return tuple(float(f"{value:.12g}") for value in np.ravel(values))
