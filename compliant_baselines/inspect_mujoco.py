"""The contacts of a MuJoCo scene: the traps in their parameters, and what they do, measured (docs/mapping.md).

The engine documents each trap (XML reference, "Solver parameters" and the options; changelog of 3.13), and a test
measures its effect. A contact is dropped and loaded in a scene of its own: two spheres, or one and a plane for a fixed
body, on vertical slides, with the parameters as the engine combines them, and masses, inverse weights and options of
the user's scene. A sphere has one contact, where a box that lands on a face shares its load among four. A body on
joints has its mass in the direction in which it moves most easily, and there the damping and the dry friction of the
joints. The solver stops where it would stop for the two bodies in the user's scene: what it holds against its tolerance
is divided by the sum of the mass matrix's diagonal, of all that is solved together.
"""

from __future__ import annotations

import math
from copy import copy
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.engines.mujoco import Mujoco, mjcf
from impact_xval.compliant_baselines.mapping import (
    MUJOCO_DEFAULT_SOLIMP,
    MUJOCO_DEFAULT_SOLREF,
    KelvinVoigtContact,
    MujocoContact,
    mujoco_contact,
)
from impact_xval.compliant_baselines.restitution import contact_time, damping_ratio

mujoco: Any = import_module("mujoco")  # the names of the compiled module are invisible to a type checker

#: Places of the touch within a step, the first two far apart; two are enough for a contact of `LONG` steps.
PLACES = tuple((18 * i % 32 + 1) / 32 for i in range(16))
LONG = 250
#: Steps after which a drop is given up.
MOST_STEPS = 20_000
#: Relative change of a rate that is rounding, and steps without another change after which a contact is over.
ROUNDING, QUIET = 1e-12, 3
#: Steps in a contact below which its restitution is off by 10 % and more.
FEWEST_STEPS = 30
#: Impedance above which a contact is not at the level of forces.
FORCE_LEVEL = 0.01
#: Contacts that are measured, at most.
MOST_ROWS = 50
#: How far a contact may be from what was meant, in restitution and relatively in stiffness.
NEAR_E, NEAR_K = 0.02, 0.05
#: How far restitution may exceed 1, or change with the solver's tolerance (and the duration relatively): at 30 steps
#: in a contact an elastic one is up to 1.1e-3 off.
NEGLIGIBLE = 1.5e-3
#: Restitution of a contact that is not to rebound: no finite damping gives 0.
NO_REBOUND = 0.01

#: What decides a contact, by the name of the engine's arrays of pairs: attributes of its mjContact.
_PARAMETERS = {name: name for name in ("solref", "solimp", "friction", "solreffriction", "dim")}
_PARAMETERS |= {"margin": "includemargin"}
if hasattr(mujoco.MjContact, "adhesion"):  # from 3.11 on
    _PARAMETERS["adhesion"] = "adhesion"


#: The stage that makes the mass matrix, as the engine calls it: from 3.3 on it adds the inertia of tendons.
_MASS_MATRIX = "makeM" if hasattr(mujoco, "mj_makeM") else "crb"


class Losses(NamedTuple):
    """What the joints of a body take from its motion along the normal."""

    #: In N s/m and N; and the solref and solimp of the dry friction, of the joint that has most of it.
    damping: float = 0.0
    friction: float = 0.0
    solref: tuple[float, ...] = MUJOCO_DEFAULT_SOLREF
    solimp: tuple[float, ...] = MUJOCO_DEFAULT_SOLIMP


class Bodies(NamedTuple):
    """The two bodies of a contact, the lighter first: masses along the normal in kg, inf if fixed, `body_invweight0`.

    A `pair` with these numbers has this contact; `mixed` are the solrefs of two geoms, if any is direct and the engine
    has mixed them. The solver divides by `inertia`, the sum of the mass matrix's diagonal, what it holds against its
    tolerance.
    """

    masses: tuple[float, float]
    weights: tuple[tuple[float, ...], ...]
    pair: tuple[tuple[str, Any], ...]
    inertia: float
    losses: tuple[Losses, Losses] = (Losses(), Losses())
    mixed: tuple[Any, ...] | None = None

    @property
    def mass(self) -> float:
        """Reduced mass in kg."""
        return 1 / (1 / self.masses[0] + 1 / self.masses[1])

    @property
    def scale(self) -> float:
        """Mass in kg by which the engine scales a direct solref: one over the sum of the inverse weights."""
        return 1 / sum(weight[0] for weight in self.weights)


class Finding(NamedTuple):
    """A trap in a scene: its name, the contacts, and what the engine does, with the way out."""

    trap: str
    where: list[str]
    says: str


class Measured(NamedTuple):
    """Contacts that are alike, in SI units, masses in kg (inf: fixed); None where `reason` says why.

    Penetration is None without gravity too. `change` says what to write for what was probably meant, and what that was
    measured to give; empty if it is there. `note` says what of the joints is in the numbers.
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
    note: str = ""


def examine(speed: float, scene: Path) -> tuple[list[Measured], list[Finding]] | str:
    """Measure the contacts of a file, .mjb or MJCF, and look for traps; or say why MuJoCo does not take it."""
    load = mujoco.MjModel.from_binary_path if scene.suffix == ".mjb" else mujoco.MjModel.from_xml_path
    try:
        model = load(str(scene))
        return examine_model(model, speed)
    except Exception as error:  # of an engine that met what it does not expect
        return f"{scene}: MuJoCo does not compile it: {error}"


def examine_model(model: Any, speed: float = 1.0) -> tuple[list[Measured], list[Finding]]:
    """Measure the contacts of a compiled mujoco.MjModel, and look for traps in parameters and in what was measured."""
    examined = _examined(model, speed)
    measured_traps = _gathered([(row.where, traps) for row, traps in examined])
    return [row for row, _ in examined], [*inspect_model(model), *measured_traps]


def inspect_model(model: Any) -> list[Finding]:
    """Look for traps in the parameters of a compiled mujoco.MjModel."""
    return _gathered([(where, _traps(model.opt, bodies)) for bodies, where in contacts(model).items()])


def _gathered(traps: list[tuple[list[str], dict[str, Any]]]) -> list[Finding]:
    """Gather traps by contacts: one that many contacts share in the same words stands once, first by its name."""
    places: dict[tuple[str, str], list[str]] = {}
    for name in dict.fromkeys(name for _, of_contact in traps for name in of_contact):
        for where, of_contact in traps:
            if says := of_contact.get(name):
                places.setdefault((name, says), []).extend(where)
    return [Finding(trap, where, says) for (trap, says), where in places.items()]


def called(where: list[str]) -> str:
    """Name contacts that have something in common, shortly: the first, and how many others."""
    return where[0] + (f" and {len(where) - 1} more" if len(where) > 1 else "")


def _traps(option: Any, bodies: Bodies) -> dict[str, Any]:
    """All traps: of one that a contact has, what the engine does, with the way out; of another something false."""
    solref, (dmin, dmax, *_) = (dict(bodies.pair)[name] for name in ("solref", "solimp"))
    step = option.timestep
    mixed_signs = (solref[0] > 0) != (solref[1] > 0)
    first, second = MUJOCO_DEFAULT_SOLREF if mixed_signs else solref
    discrete = option.integrator == getattr(mujoco.mjtIntegrator, "mjINT_DISCRETE", None)  # from 3.13 on
    safe = not discrete and not option.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE
    acting = max(first, 2 * step) if safe and first > 0 else first
    k, c = (-number for number in MujocoContact((acting, second), MUJOCO_DEFAULT_SOLIMP).direct)
    # Of the pair alone, at d = dmax. A heavy dashpot decays faster than its contact ends; the step has to resolve that.
    duration = (
        min(KelvinVoigtContact(k, c, 1.0).duration, 2 * math.pi / c if c else math.inf) if k else math.inf
    )
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
    }


def contacts(model: Any) -> dict[Bodies, list[str]]:
    """Bodies of all contacts of a compiled model, alike ones together: what each contact is called, <pair>s first.

    The engine says which geoms can touch, and combines their parameters: in a copy of the scene all are at one place,
    and of a shape whose overlap it always finds.
    """
    near = copy(model)
    near.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    near.opt.enableflags &= ~_flag("mjtEnableBit", "mjENBL_SLEEP")
    near.body_margin[:] = 1e9  # what is apart is looked at, too
    near.geom_type[near.geom_type > int(mujoco.mjtGeom.mjGEOM_HFIELD)] = int(mujoco.mjtGeom.mjGEOM_SPHERE)
    data = mujoco.MjData(near)
    for stage in ("kinematics", "comPos", "tendon", _MASS_MATRIX, "factorM"):
        getattr(mujoco, f"mj_{stage}")(near, data)
    masses, losses = zip(*(_mass_and_losses(near, data, i) for i in range(model.nbody)), strict=True)
    data.geom_xpos[:] = 0
    mujoco.mj_collision(near, data)
    # A geom of -1 is a flex.
    met = {tuple(sorted(each.geom.tolist())): each for each in data.contact if each.geom.min() >= 0}
    pairs = np.sort([model.pair_geom1, model.pair_geom2], axis=0).T.tolist()
    named = {tuple(geoms): i for i, geoms in enumerate(pairs)}
    override = model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
    found: dict[Bodies, list[str]] = {}
    for geoms in sorted(met, key=lambda geoms: (named.get(geoms, model.npair), geoms)):
        a, b = sorted(model.geom_bodyid[[*geoms]].tolist(), key=masses.__getitem__)
        if masses[a] < math.inf:
            values = ((name, np.ravel(getattr(met[geoms], its))) for name, its in _PARAMETERS.items())
            pair = tuple((name, tuple(value.tolist())) for name, value in values)
            weights = _rounded(model.body_invweight0[a]), _rounded(model.body_invweight0[b])
            one, two = (tuple(model.geom_solref[geom].tolist()) for geom in geoms)
            kept = geoms in named or override or one == two or np.ptp(model.geom_priority[[*geoms]]) > 0
            mixed = None if kept or min(dict(pair)["solref"]) > 0 else (one, two)
            where = " and ".join(model.geom(geom).name or f"#{geom}" for geom in geoms)
            where = f"pair {model.pair(named[geoms]).name or where}" if geoms in named else f"geoms {where}"
            bodies = Bodies(
                (masses[a], masses[b]),
                weights,
                pair,
                _inertia(near, data, a, b),
                (losses[a], losses[b]),
                mixed,
            )
            found.setdefault(bodies, []).append(where)
    return found


def _mass_and_losses(model: Any, data: Any, body: int) -> tuple[float, Losses]:
    """Give the mass in kg in the direction in which a body moves most easily, and the losses of its joints there.

    The mass is one over the largest eigenvalue of J M^-1 J^T, with the Jacobian J of the centre of mass.
    """
    jacobian, solved = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
    mujoco.mj_solveM(model, data, solved, jacobian)
    eigenvalues, directions = np.linalg.eigh(jacobian @ solved.T)
    most = float(eigenvalues[-1])
    if most <= 0:
        return math.inf, Losses()
    # Rates of the joints when a push moves the body at 1 m/s in this direction.
    rates = np.abs(directions[:, -1] @ solved) / most
    friction = rates * model.dof_frictionloss
    losses = Losses()
    if friction.any() or (rates * model.dof_damping).any():
        joint = int(friction.argmax())
        damping, dry = _rounded([rates**2 @ model.dof_damping, friction.sum()])
        losses = Losses(damping, dry, _rounded(model.dof_solref[joint]), _rounded(model.dof_solimp[joint]))
    return _rounded(1 / most)[0], losses


def _inertia(model: Any, data: Any, *bodies: int) -> float:
    """Give what the solver divides its measures by: the sum of the diagonal of the mass matrix, in kg and kg m^2.

    It runs over all degrees of freedom that are solved together: those of the trees of two bodies, or, without islands,
    all of the scene.
    """
    dofs = np.arange(model.nv)
    if _has_islands(model.opt):
        trees = [tree for tree in model.body_treeid[[*bodies]].tolist() if tree >= 0]
        dofs = dofs[np.isin(model.dof_treeid, trees)]
    diagonal, row = [], np.empty(model.nv)
    for dof in dofs:
        mujoco.mj_mulM(model, data, row, (np.arange(model.nv) == dof).astype(float))
        diagonal.append(row[dof])
    return _rounded(sum(diagonal))[0]


def _has_islands(option: Any) -> bool:
    """Tell whether constraints are solved island by island: by default from 3.3 on, before where a flag asks for it."""
    if disables := _flag("mjtDisableBit", "mjDSBL_ISLAND"):
        return not option.disableflags & disables
    return bool(option.enableflags & _flag("mjtEnableBit", "mjENBL_ISLAND"))


def _flag(kind: str, name: str) -> int:
    """Give the bit of a flag of the engine's options; 0 in a version that has no such flag."""
    return int(getattr(getattr(mujoco, kind), name, 0))


def _rounded(values: Any) -> tuple[float, ...]:
    """Twelve digits: the same for bodies that are alike."""
    return tuple(float(f"{value:.12g}") for value in np.ravel(values))


def measure_model(model: Any, speed: float = 1.0) -> list[Measured]:
    """Measure the contacts of a compiled mujoco.MjModel, one of each combination of parameters and masses.

    The speed at which bodies meet, in m/s, matters to contacts whose impedance depends on the depth.
    """
    return [row for row, _ in _examined(model, speed)]


def _examined(model: Any, speed: float) -> list[tuple[Measured, dict[str, Any]]]:
    """Measure the contacts of a model; and, for each, the traps that measuring shows, as `_traps` gives them."""
    examined, gravity = [], float(np.linalg.norm(model.opt.gravity))
    with Mujoco().running():  # without its warnings
        for bodies, where in list(contacts(model).items())[:MOST_ROWS]:
            row, unkept = Measured(where, bodies.masses, note=_note(bodies)), ""
            try:
                drops = measured(bodies, model.opt, model.opt.timestep, speed, gravity)
                row = drops._replace(where=where, note=row.note)
                change, unkept = _change(bodies, model.opt, speed, row)
                row = row._replace(change=change)
            except Exception as error:  # of an engine that takes other numbers than these
                row = row._replace(reason=str(error))
            highest = max(row.restitution_range or (0.0,))
            traps = {
                "tolerance": _lost(bodies, model.opt, speed, row),
                "gains-energy": highest > 1 + NEGLIGIBLE
                and f"it gives back more than it took, e up to {highest:.6g}: shorten the step, or see the other traps",
                "unkept": unkept,
            }
            examined.append((row, traps))
    return examined


def _note(bodies: Bodies) -> str:
    """Say what of the joints is in the numbers; empty if there is nothing."""
    damping, friction = (sum(each) for each in zip(*(losses[:2] for losses in bodies.losses), strict=True))
    if not (damping or friction):
        return ""
    return (
        f"with the joints' damping of {damping:.4g} N s/m and dry friction of {friction:.4g} N along the normal "
        "(damping and frictionloss), while the lighter body moves and the other is met at rest"
    )


def _lost(bodies: Bodies, option: Any, speed: float, row: Measured) -> str:
    """Say what the solver's tolerance takes from a contact; empty where it takes nothing."""
    if option.tolerance <= 0:
        return ""
    try:
        exact = measured(bodies, option, option.timestep, speed, exact=True)
    except RuntimeError:
        return ""
    if row.restitution_range and exact.restitution_range and row.duration and exact.duration:
        apart = np.abs(np.subtract(row.restitution_range, exact.restitution_range)).max()
        if apart <= NEGLIGIBLE and abs(row.duration / exact.duration - 1) <= NEGLIGIBLE:
            return ""
    was = (
        "is not over" if row.restitution is None else f"has e = {row.restitution:.4g} in {row.duration:.3g} s"
    )
    return (
        f"the solver stops at {option.tolerance:g} of an absolute measure, over the inertia of the bodies: this "
        f"contact {was}, and with tolerance 0 e = {exact.restitution:.4g} in {exact.duration:.3g} s; use tolerance 0"
    )


def _change(bodies: Bodies, option: Any, speed: float, row: Measured) -> tuple[str, str]:
    """Say what to write for what was probably meant, and what that does; nothing where the contact is near it.

    And say, if the proposal does not give what was meant, that it does not. Where only the solver's tolerance is in the
    way, the proposal has its own.

    A direct solref was meant in N/m and N s/m, unless it is at the level of forces; a damping ratio as in textbooks,
    whose contact may pull, and has no rebound from a ratio of 1 on.
    """
    solref, solimp = (dict(bodies.pair)[name] for name in ("solref", "solimp"))
    (first, second), direct, longest = map(abs, solref), solref[0] < 0, math.inf
    if direct:
        unit = bodies.scale if solimp[0] <= FORCE_LEVEL and solref[1] <= 0 else 1.0
        meant = KelvinVoigtContact(first * unit, second * unit, bodies.mass)
        solref, solimp = mujoco_contact(meant._replace(mass=bodies.scale))
        asked = f"{meant.k:.4g} N/m and {meant.c:.4g} N s/m"
    elif first and second:
        e = math.exp(-math.pi * second / math.sqrt(1 - second**2)) if second < 1 else 0.0
        meant = KelvinVoigtContact.from_restitution(
            bodies.mass / (first * second) ** 2, max(e, NO_REBOUND), bodies.mass
        )
        solref = mujoco_contact(meant, "documented").solref
        longest = solref[0] / 2.2  # short enough for refsafe to leave a time constant as it is
        asked = f"e = {e:.2g}" if e > NO_REBOUND else f"no rebound (e = {NO_REBOUND})"
    else:
        return "", ""
    off = max(abs(e - meant.restitution) for e in row.restitution_range or ())
    soft = direct and (row.stiffness is None or abs(row.stiffness / meant.k - 1) > NEAR_K)
    if off <= NEAR_E and not soft:
        return "", ""
    step = min(option.timestep, float(f"{min(meant.duration / 100, longest):.2g}"))
    pair = ("solref", solref), ("solimp", solimp), ("dim", 1)
    numbers = (" ".join(f"{number:.6g}" for number in each) for each in (solref, solimp))
    paste = '<pair condim="1" solref="{}" solimp="{}"/>'.format(*numbers)
    proposed, gives, kept = bodies._replace(pair=pair), "", False
    for exact in (False, True):
        try:
            then = measured(proposed, option, step, speed, exact=exact)
        except RuntimeError as error:
            gives = f"was not measured: {error}"
            continue
        k = math.nan if then.stiffness is None else then.stiffness
        off = max(abs(e - meant.restitution) for e in then.restitution_range or (math.inf,))
        kept = off <= NEAR_E and not (direct and not abs(k / meant.k - 1) <= NEAR_K)
        gives = f"gives e = {then.restitution:.3g} and {k:.4g} N/m"
        if kept:
            paste += ' with <option tolerance="0"/>' * exact
            break
    change = f"for {asked}: {paste} and a step of {step:g} s, which {gives}"
    return change, "" if kept else f"the pair proposed {gives}, not {asked} (e = {meant.restitution:.3g})"


def _alone(bodies: Bodies, option: Any, step: float, speed: float, exact: bool = False) -> Any:
    """Compile two bodies in a scene of their own, with the user's options: heights are those of the gap between them.

    The lighter one is above. The radius is the depth that a drop at this speed could reach before it is given up.
    """
    fixed, radius = math.isinf(bodies.masses[1]), speed * step * MOST_STEPS
    model = mujoco.MjModel.from_xml_string(mjcf(2 - fixed, table=fixed))
    for name, value in bodies.pair:
        getattr(model, f"pair_{name}")[:] = value
    model.geom_size[1:, 0] = model.geom_rbound[1:] = radius
    model.body_pos[1:, 2] = (radius, -radius)[: model.nv]
    model.body_mass[1:] = bodies.masses[: model.nv]
    mujoco.mj_setConst(model, mujoco.MjData(model))  # what follows from the masses, weights apart
    model.body_invweight0[1:] = bodies.weights[: model.nv]
    for dof, losses in enumerate(bodies.losses[: model.nv]):
        model.dof_damping[dof], model.dof_frictionloss[dof] = losses.damping, losses.friction
        model.dof_solref[dof], model.dof_solimp[dof] = losses.solref, losses.solimp
    own = model.opt
    _copy_options(option, own)
    own.timestep, own.gravity, own.density, own.viscosity = step, np.zeros(3), 0.0, 0.0
    # What the solver holds against it is divided by the inertia of what is solved together.
    own.tolerance = 0.0 if exact else option.tolerance * bodies.inertia / sum(bodies.masses[: model.nv])
    # A run that goes wrong does not start again, and a slow body does not sleep.
    own.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    own.enableflags &= ~_flag("mjtEnableBit", "mjENBL_SLEEP")
    return model


def _copy_options(option: Any, own: Any) -> None:
    """Give one model the options of another, of which older versions cannot assign the whole."""
    for name in dir(option):
        value = getattr(option, name)
        if isinstance(value, np.ndarray):
            getattr(own, name)[:] = value
        elif isinstance(value, int | float):
            setattr(own, name, value)


def measured(
    bodies: Bodies, option: Any, step: float, speed: float, gravity: float = 0.0, exact: bool = False
) -> Measured:
    """Measure bodies alone, dropped at a speed in m/s at a step in s, and at rest in a gravity in m/s^2.

    `exact`: with a tolerance of 0 instead of the scene's.
    """
    model = _alone(bodies, option, step, speed, exact)
    drops = [_drop(model, place, speed) for place in PLACES[:2]]
    if min(steps for _, steps in drops) < LONG:
        drops += [_drop(model, place, speed) for place in PLACES[2:]]
    e, steps = np.mean(drops, axis=0).tolist()
    k = c = None
    if e > 0:
        zeta = damping_ratio(min(e, 1.0))
        k = bodies.mass * (contact_time(zeta) / (steps * step)) ** 2
        c = 2 * zeta * math.sqrt(k * bodies.mass)
    spread, rest = (min(drops)[0], max(drops)[0]), _rest(model, bodies.masses[0] * gravity)
    return Measured([], bodies.masses, e, spread, steps * step, steps, k, c, rest)


def _drop(model: Any, place: float, speed: float) -> tuple[float, int]:
    """Restitution, and steps from the first to the last with force; a place from 0 to 1 within a step."""
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = model.pair_margin[0] + place * speed * model.opt.timestep, -speed
    approach, rebound, before, first, last, rounding = speed, 0.0, -speed, 0, 0, ROUNDING * speed
    # Joints may slow the bodies too: what they do without contact is not a contact's.
    slowed = bool(model.dof_damping.any() or model.dof_frictionloss.any())
    for n in range(1, MOST_STEPS + 1):
        mujoco.mj_step(model, data)
        rate = float(data.qvel[0] - data.qvel[1:].sum())
        if _pushed(data) if slowed else abs(rate - before) > rounding:
            approach = approach if first else -before
            first, last, rebound = first or n, n, rate
        elif first and n - last >= QUIET and rate >= -rounding:
            return max(rebound, 0.0) / approach, last - first + 1
        before = rate
    raise RuntimeError(f"{'not over' if first else 'no force'} within {MOST_STEPS} steps")


def _pushed(data: Any) -> bool:
    """Tell whether a contact had a force in the step taken."""
    of_contacts = data.efc_type >= int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)
    return bool(data.efc_force[of_contacts].any())


def _rest(model: Any, load: float) -> float | None:
    """Depth in m at which bodies that are `_alone` carry a load in N; None if they carry none, or there is no load."""
    model.dof_frictionloss[:] = 0  # dry friction would carry a load at any depth
    data, touch = mujoco.MjData(model), float(model.pair_margin[0])

    def carried(depth: float) -> bool:
        mujoco.mj_resetData(model, data)
        data.qpos[0] = touch - depth
        data.qfrc_applied[:] = (-load, load)[: model.nv]
        mujoco.mj_forward(model, data)
        return data.qacc[0] > data.qacc[1:].sum()

    low, high = 0.0, float(model.geom_size[1, 0])
    if not load or not carried(high):
        return None
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (low, middle) if carried(middle) else (middle, high)
    return high - touch
