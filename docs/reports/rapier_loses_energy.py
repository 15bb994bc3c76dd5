"""Balls strike others that touch, in Rapier, with restitution 1: up to two fifths of the energy go. Needs rapier3d."""

import rapier3d as rapier

RADIUS = 0.1


def add_ball(world, place, velocity, mass):
    """Add a frictionless, elastic ball at a place along x in m; a ball without a mass is fixed."""
    kind = rapier.RigidBodyType.DYNAMIC if mass else rapier.RigidBodyType.FIXED
    body = rapier.RigidBodyBuilder(kind).additional_mass(mass).can_sleep(False)
    body = body.translation((place, 0, 0)).linvel((velocity, 0, 0))
    handle = world.add_body(body.enabled_rotations((False, False, False)))
    world.add_collider(rapier.Collider.ball(RADIUS).density(0).friction(0).restitution(1.0), handle)
    return handle


CASES = {
    "1 kg strikes 1 kg": (1.0, 1.0),
    "1 kg strikes 2 kg at a wall": (1.0, 2.0, 0.0),
    "1 kg strikes two of 1 kg": (1.0, 1.0, 1.0),
    "1 kg strikes four of 1 kg": (1.0, 1.0, 1.0, 1.0, 1.0),
}
for name, masses in CASES.items():
    for step in (1 / 60, 1e-3, 1e-4):
        for gap in (0.0, 1e-3):
            world = rapier.PhysicsWorld(gravity=(0, 0, 0))
            world.integration_parameters.dt = step
            balls = [
                add_ball(world, i * (2 * RADIUS + gap), float(i == 0), mass) for i, mass in enumerate(masses)
            ]
            for _ in range(round(0.5 / step)):
                world.step()
            v = [world.rigid_bodies[ball].linvel.x for ball in balls]
            energy = sum(mass * x * x for mass, x in zip(masses, v, strict=True)) - 1
            shown = ", ".join(f"{x:6.3f}" for x in v)
            print(f"{name}, gaps {gap:.0e} m, step {step:.1e} s: {shown} m/s, energy {energy:+.1%}")
