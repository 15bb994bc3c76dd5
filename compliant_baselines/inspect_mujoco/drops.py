"""Measurement of a contact of a MuJoCo scene: a drop and a load at rest, in a separate scene of two bodies.

The scene has two spheres, or a sphere and a plane for a fixed body, on vertical slides. It has the parameters of the
contact as the engine combines them, and masses, inverse weights and options of the user's scene. A sphere has one point
of contact. A box that lands on a face has four points, which share the load at rest. The solver stops at the same
accuracy as for the two bodies in the user's scene.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.engines.arrangement import line_of_balls
from impact_xval.compliant_baselines.engines.mujoco import mjcf
from impact_xval.compliant_baselines.inspect_mujoco.scene_contacts import Bodies, MujocoOption, flag
from impact_xval.compliant_baselines.restitution import contact_time, damping_ratio

mujoco: Any = import_module("mujoco")  # the names of the compiled module are invisible to a type checker

#: Places of the touch within a step that are tried, from 0 to 1; the first two are far apart.
PLACES = tuple((18 * i % 32 + 1) / 32 for i in range(16))

#: Number of steps in a contact from which the first two places are enough.
LONG = 250

#: Steps after which a drop is given up.
MOST_STEPS = 20_000

#: Largest relative change of a rate that counts as rounding.
ROUNDING = 1e-12

#: Steps without force after which a contact is over.
QUIET_STEPS = 3

#: Speed, over the speed of approach, below which bodies that joints brake count as standing still.
STANDSTILL = 1e-3

#: Fewest steps, and least fraction of the steps since the touch, for which bodies have to stand still in the contact.
STANDING_STEPS, STANDING_SHARE = 50, 0.5


class MeasuredContact(NamedTuple):
    """Measurement of contacts that are alike, in SI units; if a number is None, `reason` says why."""

    #: Names of the contacts.
    names: list[str]
    #: Masses of the two bodies in kg, the lighter first; inf for a fixed body.
    masses: tuple[float, float]
    #: Mean restitution over the places of the touch within a step; 0 if the bodies do not leave the contact.
    restitution: float | None = None
    #: Least and greatest restitution over these places.
    restitution_range: tuple[float, float] | None = None
    #: Duration in s: whole steps from the first to the last with force. None if the bodies do not leave the contact.
    duration: float | None = None
    steps: float | None = None
    #: Stiffness in N/m and damping in N s/m of the spring and dashpot with this restitution and duration.
    stiffness: float | None = None
    damping: float | None = None
    #: Depth in m at which the contact carries the weight of the lighter body. None without gravity, and if the body
    #: rests above the surface.
    penetration: float | None = None
    #: Number of points of contact that share this weight.
    points: int = 1
    #: Greatest depth in m that a drop reached; None if the bodies turned above the surface.
    depth: float | None = None
    #: Greatest force in N along the normal in a step of a drop.
    force: float | None = None
    #: Least and greatest impedance of the contact while a drop had force.
    impedances: tuple[float, float] | None = None
    #: Parameters to write for another contact, with the results of its drops; empty if nothing needs a change.
    change: str = ""
    #: Why the contact was not measured; empty if it was.
    reason: str = ""
    #: Note on the effect of joints in the numbers, and on numbers that are left out; empty if there is none.
    note: str = ""

    @property
    def stays_in_contact(self) -> bool:
        """True if the bodies were measured and did not leave the contact."""
        return self.restitution is not None and self.duration is None

    @property
    def outcome(self) -> str:
        """The results of the drops in words."""
        if self.restitution is None:
            return "the contact does not end"
        if self.duration is None:
            return "no rebound"
        return f"e = {self.restitution:.4g} in {self.duration:.3g} s"


class Drop(NamedTuple):
    """Result of one drop."""

    restitution: float
    #: Steps from the first to the last with force; None if the bodies stand still in the contact.
    steps: int | None
    #: Greatest depth in m, negative above the surface.
    depth: float
    #: Greatest force in N along the normal in a step.
    force: float
    #: The impedances in the steps with force.
    impedances: list[float]


def measure_contact(
    bodies: Bodies, option: MujocoOption, step: float, speed: float, gravity: float = 0.0, exact: bool = False
) -> MeasuredContact:
    """Measure two bodies alone, dropped and at rest.

    Parameters
    ----------
    bodies
        The bodies and their contact.
    option
        The options of the user's scene.
    step, speed, gravity
        Time step in s, speed of approach in m/s, and gravity at rest in m/s^2.
    exact
        True for a solver tolerance of 0 in place of the scene's tolerance.

    Raises
    ------
    RuntimeError
        If a drop is not over, or meets no force.
    """
    model = _compile_alone(bodies, option, step, speed, exact)
    drops = [_drop(model, bodies.mass, place, speed) for place in PLACES[:2]]
    if any(drop.steps is not None and drop.steps < LONG for drop in drops):
        drops += [_drop(model, bodies.mass, place, speed) for place in PLACES[2:]]
    restitutions, counts = [drop.restitution for drop in drops], [drop.steps for drop in drops]
    e = float(np.mean(restitutions))
    steps = float(np.mean([n for n in counts if n])) if all(counts) else None
    k = c = None
    if e > 0 and steps:
        zeta = damping_ratio(min(e, 1.0))
        k = bodies.mass * (contact_time(zeta) / (steps * step)) ** 2
        c = 2 * zeta * math.sqrt(k * bodies.mass)
    margin = float(model.pair_margin[0])
    notes: list[str] = []
    if steps is None:
        notes.append(
            "no rebound: the joints brake the bodies to a standstill in the contact, which has no duration then"
        )
    at_rest = _equilibrium_depth(model, bodies.masses[0] * gravity / bodies.points)
    if at_rest is not None and at_rest <= 0:
        notes.append(
            f"at rest the bodies are {-at_rest:.3g} m apart: the force begins at the margin of {margin:g} m"
        )
        at_rest = None
    depth = max(drop.depth for drop in drops)
    impedances = [impedance for drop in drops for impedance in drop.impedances]
    return MeasuredContact(
        names=[],
        masses=bodies.masses,
        restitution=e,
        restitution_range=(min(restitutions), max(restitutions)),
        duration=steps and steps * step,
        steps=steps,
        stiffness=k,
        damping=c,
        penetration=at_rest,
        points=bodies.points,
        depth=depth if depth > 0 else None,
        force=max(drop.force for drop in drops),
        impedances=(min(impedances), max(impedances)) if impedances else None,
        note="; ".join(notes),
    )


def _compile_alone(bodies: Bodies, option: MujocoOption, step: float, speed: float, exact: bool) -> Any:
    """Compile two bodies in a scene of their own, with the user's options; the lighter one is above.

    The height coordinate is the gap between them. The radius is the depth that a drop at this speed could reach before
    it is given up.
    """
    fixed, radius = math.isinf(bodies.masses[1]), speed * step * MOST_STEPS
    model = mujoco.MjModel.from_xml_string(mjcf(line_of_balls(1 if fixed else 2, fixed)))
    for name, value in bodies.pair:
        getattr(model, f"pair_{name}")[:] = value
    model.geom_size[1:, 0] = model.geom_rbound[1:] = radius
    model.body_pos[1:, 2] = (radius, -radius)[: model.nv]
    model.body_mass[1:] = bodies.masses[: model.nv]
    mujoco.mj_setConst(model, mujoco.MjData(model))  # computes numbers that follow from masses
    model.body_invweight0[1:] = bodies.weights[: model.nv]
    for dof, losses in enumerate(bodies.losses[: model.nv]):
        model.dof_damping[dof], model.dof_frictionloss[dof] = losses.damping, losses.friction
        model.dof_solref[dof], model.dof_solimp[dof] = losses.solref, losses.solimp
    _copy_options(option, model.opt)
    model.opt.timestep = step
    model.opt.gravity, model.opt.density, model.opt.viscosity = np.zeros(3), 0.0, 0.0
    # Before the solver compares a measure with its tolerance, it divides the measure by the inertia of all bodies that
    # are solved together.
    model.opt.tolerance = 0.0 if exact else option.tolerance * bodies.inertia / sum(bodies.masses[: model.nv])
    # A failed run is not reset automatically, and a slow body does not sleep.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    model.opt.enableflags &= ~flag("mjtEnableBit", "mjENBL_SLEEP")
    return model


def _copy_options(source: object, target: object) -> None:
    """Copy the options of one model to another, one by one: older versions cannot assign all at once."""
    for name in dir(source):
        value = getattr(source, name)
        if isinstance(value, np.ndarray):
            getattr(target, name)[:] = value
        elif isinstance(value, int | float):
            setattr(target, name, value)


def _drop(model: Any, mass: float, place: float, speed: float) -> Drop:
    """Drop once two bodies of a reduced mass in kg, touching at a place from 0 to 1 within a step.

    The speed of approach is the speed at the touch. Joints may brake a body so hard that at first no contact force is
    needed: the speed at the first step with force may be any small part of the speed of approach. Joints may also brake
    a body so hard that it comes to rest in the contact, or creeps out of it for ever.
    """
    data, step = mujoco.MjData(model), float(model.opt.timestep)
    data.qpos[0], data.qvel[0] = model.pair_margin[0] + place * speed * step, -speed
    rounding = ROUNDING * speed
    # Joints may slow the bodies down even without contact.
    slowed_by_joints = bool(model.dof_damping.any() or model.dof_frictionloss.any())
    approach, rebound, before = 0.0, 0.0, -speed
    height, force = math.inf, 0.0  # least height and greatest force so far
    impedances: list[float] = []
    first_step = last_step = 0  # steps with force; 0: no force yet
    standing = 0  # latest steps in which the bodies stand still

    def finish(restitution: float, steps: int | None) -> Drop:
        return Drop(restitution, steps, -height, force, impedances)

    for n in range(1, MOST_STEPS + 1):
        mujoco.mj_step(model, data)
        rate = float(data.qvel[0] - data.qvel[1:].sum())
        height = min(height, float(data.qpos[0] - data.qpos[1:].sum()))
        if slowed_by_joints:
            normal_force = _normal_force(model, data)
            touches, has_force = normal_force is not None, bool(normal_force)
        else:
            normal_force = mass * (rate - before) / step
            touches = has_force = abs(rate - before) > rounding
        if touches and not approach:
            approach = -before
        if has_force:
            first_step = first_step or n
            last_step, rebound = n, rate
            force = max(force, normal_force or 0.0)
            if _is_active(data):
                impedances.append(float(data.efc_KBIP[data.contact.efc_address[0], 2]))
        elif first_step and n - last_step >= QUIET_STEPS and rate >= -rounding:
            return finish(max(rebound, 0.0) / approach, last_step - first_step + 1)
        if slowed_by_joints and first_step:
            standing = standing + 1 if abs(rate) <= STANDSTILL * approach else 0
            if standing >= max(STANDING_STEPS, STANDING_SHARE * (n - first_step)):
                return finish(0.0, None)
        before = rate
    raise RuntimeError(f"{'not over' if first_step else 'no force'} within {MOST_STEPS} steps")


def _is_active(data: Any) -> bool:
    """Return True if the contact was a constraint in the last step."""
    return data.ncon > 0 and data.contact.efc_address[0] >= 0


def _normal_force(model: Any, data: Any) -> float | None:
    """Return the force in N along the normal in the last step; None if the bodies did not touch."""
    if not _is_active(data):
        return None
    wrench = np.zeros(6)
    mujoco.mj_contactForce(model, data, 0, wrench)
    return float(wrench[0])


def _equilibrium_depth(model: Any, load: float) -> float | None:
    """Return the depth in m at which two bodies alone carry a load in N; None without a load, or if they carry none."""
    model.dof_frictionloss[:] = 0  # dry friction would carry a load at any depth
    data, touch = mujoco.MjData(model), float(model.pair_margin[0])

    def carries_load(depth: float) -> bool:
        mujoco.mj_resetData(model, data)
        data.qpos[0] = touch - depth
        data.qfrc_applied[:] = (-load, load)[: model.nv]
        mujoco.mj_forward(model, data)
        return data.qacc[0] > data.qacc[1:].sum()

    low, high = 0.0, float(model.geom_size[1, 0])
    if not load or not carries_load(high):
        return None
    while low < (middle := 0.5 * (low + high)) < high:
        if carries_load(middle):
            high = middle
        else:
            low = middle
    return high - touch
