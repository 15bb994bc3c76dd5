"""The contacts that a MuJoCo scene can have, and each of them in a scene of its own, dropped and loaded there.

There two spheres, or one and a plane for a fixed body, are on vertical slides; parameters as the engine combines them,
masses, inverse weights and options are those of the user's scene. A sphere has one contact, where a box that lands on a
face shares its load among four. A body on joints has its mass in the direction in which it moves most easily.
"""

from __future__ import annotations

import math
from copy import copy
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.engines.mujoco import mjcf
from impact_xval.compliant_baselines.restitution import contact_time, damping_ratio

mujoco: Any = import_module("mujoco")  # the names of the compiled module are invisible to a type checker

#: Places of the touch within a step, the first two far apart; two are enough for a contact of `LONG` steps.
PLACES = tuple((18 * i % 32 + 1) / 32 for i in range(16))
LONG = 250
#: Steps after which a drop is given up.
MOST_STEPS = 20_000
#: Relative change of a rate that is rounding, and steps without another change after which a contact is over.
ROUNDING, QUIET = 1e-12, 3

#: What decides a contact, by the name of the engine's arrays of pairs: attributes of its mjContact.
_PARAMETERS = {name: name for name in ("solref", "solimp", "friction", "solreffriction", "adhesion", "dim")}
_PARAMETERS |= {"margin": "includemargin"}


class Bodies(NamedTuple):
    """The two bodies of a contact, the lighter first: masses along the normal in kg, inf if fixed, `body_invweight0`.

    A `pair` with these numbers has this contact; `mixed` are the solrefs of two geoms, if any is direct and the engine
    has mixed them.
    """

    masses: tuple[float, float]
    weights: tuple[tuple[float, ...], ...]
    pair: tuple[tuple[str, Any], ...]
    mixed: tuple[Any, ...] | None = None

    @property
    def mass(self) -> float:
        """Reduced mass in kg."""
        return 1 / (1 / self.masses[0] + 1 / self.masses[1])

    @property
    def scale(self) -> float:
        """Mass in kg by which the engine scales a direct solref: one over the sum of the inverse weights."""
        return 1 / sum(weight[0] for weight in self.weights)


def contacts(model: Any) -> dict[Bodies, list[str]]:
    """Bodies of all contacts of a compiled model, alike ones together: what each contact is called, <pair>s first.

    The engine says which geoms can touch, and combines their parameters: in a copy of the scene all are at one place,
    and of a shape whose overlap it always finds.
    """
    near = copy(model)
    near.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    near.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    near.body_margin[:] = 1e9  # what is apart is looked at, too
    near.geom_type[near.geom_type > int(mujoco.mjtGeom.mjGEOM_HFIELD)] = int(mujoco.mjtGeom.mjGEOM_SPHERE)
    data = mujoco.MjData(near)
    for stage in ("kinematics", "comPos", "tendon", "makeM", "factorM"):
        getattr(mujoco, f"mj_{stage}")(near, data)
    masses = [_mass(near, data, i) for i in range(model.nbody)]
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
            found.setdefault(Bodies((masses[a], masses[b]), weights, pair, mixed), []).append(where)
    return found


def _mass(model: Any, data: Any, body: int) -> float:
    """Mass in the direction in which a body moves most easily, in kg: one over the largest eigenvalue of J M^-1 J^T."""
    jacobian, solved = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
    mujoco.mj_solveM(model, data, solved, jacobian)
    most = float(np.linalg.eigvalsh(jacobian @ solved.T)[-1])
    return _rounded(1 / most)[0] if most > 0 else math.inf


def _rounded(values: Any) -> tuple[float, ...]:
    """Twelve digits: the same for bodies that are alike."""
    return tuple(float(f"{value:.12g}") for value in np.ravel(values))


def _alone(bodies: Bodies, option: Any, step: float, speed: float) -> Any:
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
    model.opt = option  # a copy
    own = model.opt
    own.timestep, own.gravity, own.density, own.viscosity = step, np.zeros(3), 0.0, 0.0
    # A run that goes wrong does not start again, and a slow body does not sleep.
    own.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    own.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    return model


def measured(bodies: Bodies, option: Any, step: float, speed: float, gravity: float = 0.0) -> dict[str, Any]:
    """Measure bodies alone, dropped at a speed in m/s at a step in s, and at rest in a gravity in m/s^2.

    Restitution, its range, duration and steps, k and c of a contact with the same, and penetration.
    """
    model = _alone(bodies, option, step, speed)
    drops = [_drop(model, place, speed) for place in PLACES[:2]]
    if min(steps for _, steps in drops) < LONG:
        drops += [_drop(model, place, speed) for place in PLACES[2:]]
    e, steps = np.mean(drops, axis=0).tolist()
    duration = steps * step
    spread = min(drops)[0], max(drops)[0]
    found = {"restitution": e, "restitution_range": spread, "duration": duration, "steps": steps}
    if e > 0:
        zeta = damping_ratio(min(e, 1.0))
        k = bodies.mass * (contact_time(zeta) / duration) ** 2
        found |= {"stiffness": k, "damping": 2 * zeta * math.sqrt(k * bodies.mass)}
    return found | {"penetration": _rest(model, bodies.masses[0] * gravity)}


def _drop(model: Any, place: float, speed: float) -> tuple[float, int]:
    """Restitution, and steps from the first to the last change of the rate; a place from 0 to 1 within a step."""
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = model.pair_margin[0] + place * speed * model.opt.timestep, -speed
    before, first, last, rounding = -speed, 0, 0, ROUNDING * speed
    for n in range(1, MOST_STEPS + 1):
        mujoco.mj_step(model, data)
        rate = float(data.qvel[0] - data.qvel[1:].sum())
        if abs(rate - before) > rounding:
            first, last = first or n, n
        elif first and n - last >= QUIET and rate >= -rounding:
            return max(rate, 0.0) / speed, last - first + 1
        before = rate
    raise RuntimeError(f"{'not over' if first else 'no force'} within {MOST_STEPS} steps")


def _rest(model: Any, load: float) -> float | None:
    """Depth in m at which bodies that are `_alone` carry a load in N; None if they carry none, or there is no load."""
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
