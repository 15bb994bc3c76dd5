"""Measurement of a contact of a MuJoCo scene: a drop and a load at rest, in a separate scene of two bodies.

The separate scene has two spheres on vertical slides; a fixed body is a plane. The contact has the parameters that the
engine combines in the user's scene. Masses, inverse weights and options are also those of the user's scene. A sphere
has one point of contact. A box that lies on a face has four points, which share the load at rest. The solver stops at
the same accuracy as it would for the two bodies in the user's scene.
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

mujoco: Any = import_module("mujoco")  # type checkers do not see the names of the compiled module

#: Instants within a step at which the bodies touch, as fractions of the step. The first two are far apart.
PLACES = tuple((18 * i % 32 + 1) / 32 for i in range(16))

#: Number of steps in a contact from which only the first two of `PLACES` are tried.
LONG = 250

#: Largest number of steps of a drop. A drop that is not over then is given up.
MOST_STEPS = 20_000

#: Largest change of the relative velocity in a step, over the speed of approach, that is taken for rounding.
ROUNDING = 1e-12

#: Number of steps without force after which a contact is over.
QUIET_STEPS = 3

#: Speed, over the speed of approach, below which bodies that joints slow down are taken for standing still.
STANDSTILL = 1e-3

#: Bodies come to rest in the contact if they stand still for this number of steps, and for this fraction of the steps
#: since the touch.
STANDING_STEPS, STANDING_SHARE = 50, 0.5


class MeasuredContact(NamedTuple):
    """Measurement of contacts with equal parameters and bodies, in SI units; `reason` says why a value is None."""

    #: Names of the contacts.
    names: list[str]
    #: Masses of the two bodies in kg, the lighter body first; inf for a fixed body.
    masses: tuple[float, float]
    #: Mean restitution over all instants within a step at which the bodies touch; 0 if the bodies do not leave the
    #: contact.
    restitution: float | None = None
    #: Least and greatest restitution over these instants.
    restitution_range: tuple[float, float] | None = None
    #: Duration in s, as whole steps from the first step with force to the last. None if the bodies do not leave the
    #: contact.
    duration: float | None = None
    steps: float | None = None
    #: Stiffness in N/m and damping in N s/m of the spring and dashpot with this restitution and duration.
    stiffness: float | None = None
    damping: float | None = None
    #: Depth in m at which the contact carries the weight of the lighter body. None without gravity, or if the body
    #: rests above the surface.
    penetration: float | None = None
    #: Number of points of contact that share this weight.
    points: int = 1
    #: Greatest depth in m in a drop; None if the bodies turned round above the surface.
    depth: float | None = None
    #: Greatest force in N along the normal in a drop, as the mean over a step.
    force: float | None = None
    #: Least and greatest impedance of the contact while a drop had force.
    impedances: tuple[float, float] | None = None
    #: Text with parameters for another contact and the results of its drops; empty if nothing needs a change.
    change: str = ""
    #: Reason why the contact was not measured; empty if it was.
    reason: str = ""
    #: Note on how joints change the measured values, and on missing values; empty if there is nothing to note.
    note: str = ""

    @property
    def stays_in_contact(self) -> bool:
        """True if the bodies were measured and did not leave the contact."""
        return self.restitution is not None and self.duration is None

    @property
    def outcome(self) -> str:
        """The results of the drops as a phrase."""
        if self.restitution is None:
            return "the contact does not end"
        if self.duration is None:
            return "no rebound"
        return f"e = {self.restitution:.4g} in {self.duration:.3g} s"


class Drop(NamedTuple):
    """Result of one drop."""

    restitution: float
    #: Number of steps from the first step with force to the last; None if the bodies stand still in the contact.
    steps: int | None
    #: Greatest depth in m; negative if the bodies stay above the surface.
    depth: float
    #: Greatest force in N along the normal in a step.
    force: float
    #: Impedances of the contact in the steps with force.
    impedances: list[float]


def measure_contact(
    bodies: Bodies, option: MujocoOption, step: float, speed: float, gravity: float = 0.0, exact: bool = False
) -> MeasuredContact:
    """Measure a contact between two bodies alone, in drops and under a load at rest.

    Parameters
    ----------
    bodies
        The bodies and their contact.
    option
        The options of the user's scene.
    step, speed, gravity
        Time step in s, speed of approach in m/s, and gravity at rest in m/s^2.
    exact
        True for a solver tolerance of 0 instead of the scene's tolerance.

    Raises
    ------
    RuntimeError
        If a drop is not over after `MOST_STEPS` steps, or meets no force.
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
    """Return a compiled scene of two bodies with the user's options. The lighter body is above the heavier body.

    The relative height of the bodies is the gap between them. The radius is the depth that a drop at this speed could
    reach before it is given up.
    """
    fixed, radius = math.isinf(bodies.masses[1]), speed * step * MOST_STEPS
    model = mujoco.MjModel.from_xml_string(mjcf(line_of_balls(1 if fixed else 2, fixed)))
    for name, value in bodies.pair:
        getattr(model, f"pair_{name}")[:] = value
    model.geom_size[1:, 0] = model.geom_rbound[1:] = radius
    model.body_pos[1:, 2] = (radius, -radius)[: model.nv]
    model.body_mass[1:] = bodies.masses[: model.nv]
    mujoco.mj_setConst(model, mujoco.MjData(model))  # computes numbers that follow from the masses
    model.body_invweight0[1:] = bodies.weights[: model.nv]
    for dof, losses in enumerate(bodies.losses[: model.nv]):
        model.dof_damping[dof], model.dof_frictionloss[dof] = losses.damping, losses.friction
        model.dof_solref[dof], model.dof_solimp[dof] = losses.solref, losses.solimp
    _copy_options(option, model.opt)
    model.opt.timestep = step
    model.opt.gravity, model.opt.density, model.opt.viscosity = np.zeros(3), 0.0, 0.0
    # The solver divides its measure of convergence by the inertia of all bodies that it solves together, and then
    # compares it with the tolerance.
    model.opt.tolerance = 0.0 if exact else option.tolerance * bodies.inertia / sum(bodies.masses[: model.nv])
    # A failed run is not reset automatically, and a slow body does not sleep.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    model.opt.enableflags &= ~flag("mjtEnableBit", "mjENBL_SLEEP")
    return model


def _copy_options(source: object, target: object) -> None:
    """Copy the options one by one, because older versions of MuJoCo cannot copy them all at once."""
    for name in dir(source):
        value = getattr(source, name)
        if isinstance(value, np.ndarray):
            getattr(target, name)[:] = value
        elif isinstance(value, int | float):
            setattr(target, name, value)


def _drop(model: Any, mass: float, place: float, speed: float) -> Drop:
    """Drop two bodies of a reduced mass in kg once; they touch at a place from 0 to 1 within a step.

    The speed of approach is that at the touch. Joints may slow a body down so much that at first no contact force is
    needed. So the speed at the first step with force may be a very small part of the speed of approach. Joints may also
    slow a body down so much that it comes to rest in the contact, or leaves it ever more slowly.
    """
    data, step = mujoco.MjData(model), float(model.opt.timestep)
    data.qpos[0], data.qvel[0] = model.pair_margin[0] + place * speed * step, -speed
    rounding = ROUNDING * speed
    # Joints may slow the bodies down even without contact.
    slowed_by_joints = bool(model.dof_damping.any() or model.dof_frictionloss.any())
    approach, rebound, before = 0.0, 0.0, -speed
    height, force = math.inf, 0.0  # least height in m and greatest force in N so far
    impedances: list[float] = []
    first_step = last_step = 0  # first and last step with force; 0 if there was no force yet
    standing = 0  # number of last steps in which the bodies stand still

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
    """Return True if the engine computed a force for the contact in the last step."""
    return data.ncon > 0 and data.contact.efc_address[0] >= 0


def _normal_force(model: Any, data: Any) -> float | None:
    """Return the force in N along the normal in the last step; None if the bodies did not touch."""
    if not _is_active(data):
        return None
    wrench = np.zeros(6)
    mujoco.mj_contactForce(model, data, 0, wrench)
    return float(wrench[0])


def _equilibrium_depth(model: Any, load: float) -> float | None:
    """Return the depth in m at which two bodies alone carry a load in N; None if there is no load or no such depth."""
    model.dof_frictionloss[:] = 0  # without this, dry friction would carry a load at any depth
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
