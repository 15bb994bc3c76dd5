"""Scenes written by hand as a user writes them, one function for each engine. They use nothing of the adapters.

A scene has free bodies and a box as a floor. All settings are the engine's defaults, except those in the text that
`impact-xval contact` prints, which a user pastes into the scene. Each function takes the requested contact with its
two bodies, this text, a time step h and the initial gap between the bodies. It returns (restitution, duration). Both
follow from the velocities after every step. The duration is h times the number of steps from the first to the last one
with a contact force.
"""

import logging
import math

import numpy as np


def measure(relative, step):
    """Return restitution and duration from the relative velocities at the start and after every step."""
    relative = np.asarray(relative)
    loaded = np.flatnonzero(np.abs(np.diff(relative)) > 1e-12 * abs(relative[0]))
    assert loaded.size
    return -relative[-1] / relative[0], (loaded[-1] - loaded[0] + 1) * step


def _sizes(pair):
    """Return the masses (the lighter one first), the speed, the radius, and the time to run in s."""
    return sorted(pair.masses), pair.speed, max(0.05, 5 * pair.penetration), 2.5 * pair.contact.duration


def mujoco(pair, text, h, gap):
    import mujoco

    (m1, m2), v, r, time = _sizes(pair)
    option, contact = text.split("<contact>")
    option = option[option.index("<option") :]
    ball = '<body pos="0 0 {z!r}"><freejoint/><geom name="{name}" size="{r!r}" mass="{m!r}"/></body>'
    if math.isinf(m2):
        floor = f'<geom name="B" type="box" size="{9 * r!r} {9 * r!r} {2 * r!r}" pos="0 0 {-2 * r!r}"/>'
        bodies = floor + ball.format(z=r + gap, name="A", r=r, m=m1)
    else:
        bodies = ball.format(z=0.0, name="B", r=r, m=m2) + ball.format(z=2 * r + gap, name="A", r=r, m=m1)
    scene = f"<mujoco>{option}<worldbody>{bodies}</worldbody><contact>{contact}</mujoco>"
    model = mujoco.MjModel.from_xml_string(scene)
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    falls = data.body(model.geom("A").bodyid[0])
    upper = model.jnt_dofadr[model.body_jntadr[falls.id]] + 2
    data.qvel[upper] = -v
    relative = [-v]
    for _ in range(math.ceil(time / h)):
        mujoco.mj_step(model, data)
        relative.append(data.qvel[upper] - (0 if math.isinf(m2) else data.qvel[2]))
    return measure(relative, h)


def pybullet(pair, text, h, gap):
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

    p = BulletClient(pybullet.DIRECT)
    (m1, m2), v, r, time = _sizes(pair)
    sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=r)
    if math.isinf(m2):
        box = p.createCollisionShape(p.GEOM_BOX, halfExtents=[9 * r, 9 * r, 2 * r])
        b, z = p.createMultiBody(0, box, basePosition=[0, 0, -2 * r]), r + gap
    else:
        b, z = p.createMultiBody(m2, sphere, basePosition=[0, 0, 0]), 2 * r + gap
    a = p.createMultiBody(m1, sphere, basePosition=[0, 0, z])
    exec(text, {"p": p, "a": a, "b": b})
    p.resetBaseVelocity(a, [0, 0, -v])
    relative = [-v]
    for _ in range(math.ceil(time / h)):
        p.stepSimulation()
        relative.append(p.getBaseVelocity(a)[0][2] - p.getBaseVelocity(b)[0][2])
    p.disconnect()
    return measure(relative, h)


def drake(pair, text, h, gap):
    import pydrake.all as names

    (m1, m2), v, r, time = _sizes(pair)
    builder = names.DiagramBuilder()
    scope = dict(vars(names), builder=builder)
    logging.getLogger("drake").setLevel(logging.ERROR)
    exec(text, scope)
    plant, sphere, here = scope["plant"], names.Sphere(r), names.RigidTransform()
    plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])

    def ball(name, mass):
        body = plant.AddRigidBody(name, names.SpatialInertia.SolidSphereWithMass(mass, r))
        plant.RegisterCollisionGeometry(body, here, sphere, name, scope[f"properties_{name}"])
        return body

    a, z, b = ball("a", m1), r + gap, None
    if math.isinf(m2):
        box, below = names.Box(18 * r, 18 * r, 4 * r), names.RigidTransform([0, 0, -2 * r])
        plant.RegisterCollisionGeometry(plant.world_body(), below, box, "b", scope["properties_b"])
    else:
        b, z = ball("b", m2), 2 * r + gap
    plant.Finalize()
    log = names.LogVectorOutput(plant.get_state_output_port(), builder)
    simulator = names.Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFreeBodyPose(context, a, names.RigidTransform([0, 0, z]))
    velocities = plant.GetVelocities(context)
    velocities[a.floating_velocities_start_in_v() + 5] = -v
    plant.SetVelocities(context, velocities)
    simulator.AdvanceTo(math.ceil(time / h) * h)
    states = log.FindLog(simulator.get_context()).data()
    n = plant.num_positions()
    vz = {body: states[n + body.floating_velocities_start_in_v() + 5] for body in (a, b) if body}
    return measure(vz[a] - (vz[b] if b else 0), h)
