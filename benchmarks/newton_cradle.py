"""The cradle example of the engine Newton by its five solvers, to find the solvers that behave like a cradle.

    python -m benchmarks.newton_cradle --solver xpbd vbd mujoco featherstone kamino

The scene is that of Newton's example ``newton_cradle`` (example_newton_cradle.py of 1.8.0): five balls of 1 kg and
radius 0.05 m on strings of 1 m. The first is let go at 45 degrees. Contacts, numbers of steps and settings of each
solver are those of the example. The pivots are a diameter apart, as there, or 1 mm more. The script prints the angle to
which each ball swings out after the first strike, on the side of the last ball. In a cradle the last ball swings out by
45 degrees, and the others by 0.
"""

from __future__ import annotations

import argparse
import math
import time
from importlib import import_module
from typing import Any

import numpy as np

BALLS, MASS, RADIUS, STRING = 5, 1.0, 0.05, 1.0
ANGLE, GRAVITY, FRAMES_PER_SECOND = math.radians(45.0), 9.81, 60
SUBSTEPS = {"xpbd": 10, "vbd": 10, "mujoco": 10, "featherstone": 20, "kamino": 5}
NATIVE = ("mujoco", "kamino")

#: Time in s that a run simulates. After half a period, 1.04 s, the last ball is farthest out; then it comes back.
END = 1.4

#: Angle in degrees from the lowest place below which the first ball counts as arrived.
ANGLE_OF_STRIKE = 2.0


def build(newton: Any, warp: Any, solver: str, gap: float) -> tuple[Any, Any, Any]:
    """Build the example; return model, pipeline of contacts (None for solvers that have their own) and solver."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY))
    builder.rigid_gap = 0.001
    shape = builder.default_shape_cfg
    shape.ke, shape.kd, shape.kf, shape.restitution = 1e5, 0.0, 0.0, 1.0
    shape.mu = 2e-5 if solver == "mujoco" else 0.0
    joints = []
    for i in range(BALLS):
        pivot = (i - 0.5 * (BALLS - 1)) * (2 * RADIUS + gap)
        angle = ANGLE if i == 0 else 0.0
        # The example writes +sin, and a positive joint angle, which swings to -x: body_q comes from the joint.
        place = warp.vec3(pivot + STRING * math.sin(angle), 0.0, -STRING * math.cos(angle))
        inertia = 0.4 * MASS * RADIUS**2
        body = builder.add_link(
            xform=warp.transform(p=place, q=warp.quat_identity()),
            mass=MASS,
            inertia=warp.mat33(inertia, 0.0, 0.0, 0.0, inertia, 0.0, 0.0, 0.0, inertia),
            com=warp.vec3(0.0, 0.0, 0.0),
            lock_inertia=True,
        )
        builder.add_shape_sphere(body, radius=RADIUS)
        joints.append(
            builder.add_joint_revolute(
                parent=-1,
                child=body,
                axis=warp.vec3(0.0, 1.0, 0.0),
                parent_xform=warp.transform(p=warp.vec3(pivot, 0.0, 0.0), q=warp.quat_identity()),
                child_xform=warp.transform(p=warp.vec3(0.0, 0.0, STRING), q=warp.quat_identity()),
                limit_lower=-math.pi,
                limit_upper=math.pi,
                limit_ke=0.0,
                limit_kd=0.0,
            )
        )
    builder.add_articulation(joints)
    builder.color()
    model = builder.finalize(device="cpu")
    angles = model.joint_q.numpy()
    angles[0] = ANGLE
    model.joint_q.assign(angles)
    newton.eval_fk(model, model.joint_q, model.joint_qd, model)
    pipeline = None if solver in NATIVE else newton.CollisionPipeline(model)
    solvers = newton.solvers
    if solver == "xpbd":
        return model, pipeline, solvers.SolverXPBD(model, iterations=10, enable_restitution=True)
    if solver == "vbd":
        return model, pipeline, solvers.SolverVBD(model, iterations=10)
    if solver == "mujoco":
        return model, pipeline, solvers.SolverMuJoCo(model, njmax=2048, nconmax=1024, cone="elliptic")
    if solver == "featherstone":
        return model, pipeline, solvers.SolverFeatherstone(model, angular_damping=0.0)
    config = solvers.SolverKamino.Config.from_model(model)
    config.use_collision_detector = True
    return model, pipeline, solvers.SolverKamino(model, config=config)


def swing(solver: str, gap: float) -> None:
    """Run the cradle, and print the result of the first strike."""
    newton, warp = import_module("newton"), import_module("warp")
    warp.config.quiet = True
    start = time.perf_counter()
    with warp.ScopedDevice("cpu"):
        model, pipeline, engine = build(newton, warp, solver, gap)
        contacts = pipeline.contacts() if pipeline else None
        states, control = [model.state(), model.state()], model.control()
        step = 1 / (FRAMES_PER_SECOND * SUBSTEPS[solver])
        places = []
        for _ in range(round(END / step)):
            states[0].clear_forces()
            if pipeline:
                pipeline.collide(states[0], contacts)
            engine.step(states[0], states[1], control, contacts, step)
            states.reverse()
            places.append(states[0].body_q.numpy()[:, [0, 2]])
    x = np.array(places, float)
    pivots = np.array([(i - 0.5 * (BALLS - 1)) * (2 * RADIUS + gap) for i in range(BALLS)])
    angles = np.degrees(np.arctan2(x[:, :, 0] - pivots, -x[:, :, 1]))
    # The first ball is let go on one side, whichever that is: count angles along its way, to the other side.
    angles *= -np.sign(angles[0, 0])
    struck = int(np.argmax(angles[:, 0] > -ANGLE_OF_STRIKE))
    print(
        f"{solver:14s} {gap * 1e3:g} mm, step {step * 1e3:.3g} ms: the first ball is there after {struck * step:.3f} s;"
        f" balls swing out by {' '.join(f'{angle:5.1f}' for angle in angles[struck:].max(axis=0))} degrees"
        f" ({time.perf_counter() - start:.0f} s)",
        flush=True,
    )


def main() -> None:
    """Print a line for every solver and gap."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--solver", nargs="+", choices=SUBSTEPS, default=list(SUBSTEPS))
    parser.add_argument(
        "--gap", nargs="+", type=float, default=[0.0, 1e-3], help="gaps between the balls in m"
    )
    options = parser.parse_args()
    for solver in options.solver:
        for gap in options.gap:
            swing(solver, gap)


if __name__ == "__main__":
    main()
