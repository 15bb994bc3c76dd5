"""A stack of three balls falls on a table, in DART: it leaves with nearly twice its energy. Needs dartpy alone."""

import dartpy as dart

RADIUS, STEP, SPEED, E = 0.1, 1e-3, 1.0, 0.9


def add_body(world, shape, height, joint_properties=None):
    """Add a frictionless body at a height in m; return its joint, which is None for the table."""
    skeleton = dart.dynamics.Skeleton()
    if joint_properties is None:
        joint, body = None, skeleton.createWeldJointAndBodyNodePair()[1]
    else:
        joint, body = skeleton.createPrismaticJointAndBodyNodePair(None, joint_properties)
        body.setMass(1.0)
        joint.setVelocity(0, -SPEED)
    node = body.createShapeNode(shape)
    node.setRelativeTranslation([0, 0, height])
    node.createCollisionAspect()
    material = node.createDynamicsAspect()
    material.setFrictionCoeff(0)
    material.setRestitutionCoeff(E**0.5)  # DART multiplies the coefficients of two shapes
    world.addSkeleton(skeleton)
    return joint


for gap in (-1e-6 * RADIUS, 0.0, 1e-6 * RADIUS, 1e-4 * RADIUS):
    for split_impulse in (True, False):
        world = dart.simulation.World()
        world.setGravity([0, 0, 0])
        world.setTimeStep(STEP)
        world.getConstraintSolver().setSplitImpulseEnabled(split_impulse)
        vertical = dart.dynamics.PrismaticJointProperties()
        vertical.mAxis = [0, 0, 1]
        add_body(world, dart.dynamics.BoxShape([2, 2, 2]), -1.0)
        heights = [(2 * i + 1) * RADIUS + (i + 1) * gap for i in range(3)]
        balls = [add_body(world, dart.dynamics.SphereShape(RADIUS), z, vertical) for z in heights]
        for _ in range(200):
            world.step()
        v = [ball.getVelocity(0) for ball in balls]
        energy = sum(x * x for x in v) / (len(v) * SPEED**2) - 1
        shown = ", ".join(f"{x:7.4f}" for x in v)
        print(f"gaps {gap:8.1e} m, split impulse {split_impulse!s:5}: {shown} m/s, energy {energy:+.1%}")
