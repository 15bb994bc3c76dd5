"""A contact of a MuJoCo scene, dropped and loaded in a scene of its own.

The scene has two spheres, or a sphere and a plane for a fixed body, on vertical slides. It has the parameters of the
contact as the engine combines them, and masses, inverse weights and options of the user's scene. A sphere has one
contact, where a box that lands on a face shares its load among four. The solver stops where it would stop for the two
bodies in the user's scene.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.engines.mujoco import mjcf
from impact_xval.compliant_baselines.inspect_mujoco.scene_contacts import Bodies, flag
from impact_xval.compliant_baselines.restitution import contact_time, damping_ratio

mujoco: Any = import_module("mujoco")  # the names of the compiled module are invisible to a type checker

#: Places within a step at which the touch is tried, from 0 to 1, the first two far apart.
PLACES = tuple((18 * i % 32 + 1) / 32 for i in range(16))

#: Steps in a contact from which the first two places are enough.
LONG = 250

#: Steps after which a drop is given up.
MOST_STEPS = 20_000

#: Largest relative change of a rate that counts as rounding.
ROUNDING = 1e-12

#: Steps without force after which a contact is over.
QUIET_STEPS = 3


class MeasuredContact(NamedTuple):
    """Contacts that are alike, measured, in SI units; numbers are None where `reason` says why."""

    #: Names of the contacts.
    names: list[str]
    #: Masses of the two bodies in kg, the lighter first; inf for a fixed body.
    masses: tuple[float, float]
    #: Mean over the places of the touch within a step.
    restitution: float | None = None
    #: Least and greatest restitution over these places.
    restitution_range: tuple[float, float] | None = None
    #: In s. Whole steps count, from the first to the last with force.
    duration: float | None = None
    steps: float | None = None
    #: Numbers of the spring and dashpot with this restitution and duration, in N/m and N s/m.
    stiffness: float | None = None
    damping: float | None = None
    #: Depth in m at which the contact carries the weight of the lighter body; None without gravity too.
    penetration: float | None = None
    #: What to write for another contact, and what drops of it gave; empty if there is nothing to change.
    change: str = ""
    #: Why the contact was not measured; empty if it was.
    reason: str = ""
    #: What the numbers contain of the joints; empty if there is nothing.
    note: str = ""


def measure_contact(
    bodies: Bodies, option: Any, step: float, speed: float, gravity: float = 0.0, exact: bool = False
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
        Whether the solver's tolerance is 0 in place of the scene's.

    Raises
    ------
    RuntimeError
        If a drop is not over, or meets no force.
    """
    model = _compile_alone(bodies, option, step, speed, exact)
    drops = [_drop(model, place, speed) for place in PLACES[:2]]
    if min(steps for _, steps in drops) < LONG:
        drops += [_drop(model, place, speed) for place in PLACES[2:]]
    e, steps = np.mean(drops, axis=0).tolist()
    k = c = None
    if e > 0:
        zeta = damping_ratio(min(e, 1.0))
        k = bodies.mass * (contact_time(zeta) / (steps * step)) ** 2
        c = 2 * zeta * math.sqrt(k * bodies.mass)
    return MeasuredContact(
        names=[],
        masses=bodies.masses,
        restitution=e,
        restitution_range=(min(drops)[0], max(drops)[0]),
        duration=steps * step,
        steps=steps,
        stiffness=k,
        damping=c,
        penetration=_equilibrium_depth(model, bodies.masses[0] * gravity),
    )


def _compile_alone(bodies: Bodies, option: Any, step: float, speed: float, exact: bool) -> Any:
    """Compile two bodies in a scene of their own, with the user's options; the lighter one is above.

    Heights count the gap between them. The radius is the depth that a drop at this speed could reach before it is given
    up.
    """
    fixed, radius = math.isinf(bodies.masses[1]), speed * step * MOST_STEPS
    model = mujoco.MjModel.from_xml_string(mjcf(1 if fixed else 2, table=fixed))
    for name, value in bodies.pair:
        getattr(model, f"pair_{name}")[:] = value
    model.geom_size[1:, 0] = model.geom_rbound[1:] = radius
    model.body_pos[1:, 2] = (radius, -radius)[: model.nv]
    model.body_mass[1:] = bodies.masses[: model.nv]
    mujoco.mj_setConst(model, mujoco.MjData(model))  # what follows from the masses, apart from the weights
    model.body_invweight0[1:] = bodies.weights[: model.nv]
    for dof, losses in enumerate(bodies.losses[: model.nv]):
        model.dof_damping[dof], model.dof_frictionloss[dof] = losses.damping, losses.friction
        model.dof_solref[dof], model.dof_solimp[dof] = losses.solref, losses.solimp
    _copy_options(option, model.opt)
    model.opt.timestep = step
    model.opt.gravity, model.opt.density, model.opt.viscosity = np.zeros(3), 0.0, 0.0
    # The solver divides what it compares with its tolerance by the inertia of all that is solved together.
    model.opt.tolerance = 0.0 if exact else option.tolerance * bodies.inertia / sum(bodies.masses[: model.nv])
    # A run that goes wrong does not start again, and a slow body does not sleep.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    model.opt.enableflags &= ~flag("mjtEnableBit", "mjENBL_SLEEP")
    return model


def _copy_options(source: Any, target: Any) -> None:
    """Copy the options of one model to another, one by one: older versions cannot assign all at once."""
    for name in dir(source):
        value = getattr(source, name)
        if isinstance(value, np.ndarray):
            getattr(target, name)[:] = value
        elif isinstance(value, int | float):
            setattr(target, name, value)


def _drop(model: Any, place: float, speed: float) -> tuple[float, int]:
    """Drop once, touching at a place from 0 to 1 within a step; return the restitution and the steps in contact.

    The speed of approach is that at the touch. Joints may brake a body so hard there that no force is needed at first:
    the speed at the first step with force may be any small part of it.
    """
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = model.pair_margin[0] + place * speed * model.opt.timestep, -speed
    rounding = ROUNDING * speed
    # Joints may slow the bodies too, without contact.
    slowed_by_joints = bool(model.dof_damping.any() or model.dof_frictionloss.any())
    approach, rebound, before = 0.0, 0.0, -speed
    first_step = last_step = 0  # with force; 0: none yet
    for n in range(1, MOST_STEPS + 1):
        mujoco.mj_step(model, data)
        rate = float(data.qvel[0] - data.qvel[1:].sum())
        if slowed_by_joints:
            forces = _contact_forces(data)
            touches, has_force = forces.size > 0, bool(forces.any())
        else:
            touches = has_force = abs(rate - before) > rounding
        if touches and not approach:
            approach = -before
        if has_force:
            first_step = first_step or n
            last_step, rebound = n, rate
        elif first_step and n - last_step >= QUIET_STEPS and rate >= -rounding:
            return max(rebound, 0.0) / approach, last_step - first_step + 1
        before = rate
    raise RuntimeError(f"{'not over' if first_step else 'no force'} within {MOST_STEPS} steps")


def _contact_forces(data: Any) -> NDArray[np.float64]:
    """Return the forces of contacts in the step taken, zeros among them; empty if no bodies touched."""
    is_contact = data.efc_type >= int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)
    return data.efc_force[is_contact]


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
