"""Newton (Warp) on a processor, in single precision: its SemiImplicit solver, springs with dashpots in compression.

While bodies overlap F = ke delta + kd max(0, delta'), ke and kd the means of those of the two shapes (the engine's
kernels_contact.py): that is `compression-dashpot`. A ball has two spheres, as in `drake`, the lower side above its
origin and the upper side below: all contacts happen at height 0, and a penetration is no difference of large heights.
Units are the radius, the step and the mass of ball 1: a step is 1 in every scene, and one recording of steps, which
Warp replays in C++ at a hundredth of the cost of calls from Python, serves all scenes of as many balls.
"""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from threading import get_ident
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.engines.engine import Engine, standard_error_without
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, periods
from impact_xval.compliant_baselines.mapping import Contact

#: Steps of a recording, an even number, as states are written to two places in turn; and the smallest depth over the
#: radius that has three digits, the surface of a sphere being good to 2^-24 of it.
STEPS, RESOLVED = 64, 2.0**-14


@lru_cache(maxsize=16)
def _recorded(balls: int, table: bool, _thread: int) -> Any:
    """Record steps, for one thread: model, state, what comes after each step, and the graph and what it points to."""
    newton, warp = import_module("newton"), import_module("warp")
    level = warp.ScopedLogLevel(warp.LOG_WARNING)
    with standard_error_without(b"Warp CUDA warning"), level, warp.ScopedDevice("cpu"):
        builder = newton.ModelBuilder()
        surface = builder.ShapeConfig(density=0.0, mu=0.0, gap=0.0)
        for _ in range(balls):
            body = builder.add_body(mass=1.0, inertia=np.eye(3))
            for side in (-1.0, 1.0):
                where = warp.transform(0.0, 0.0, side, 0.0, 0.0, 0.0, 1.0)
                builder.add_shape_sphere(body, xform=where, radius=1.0, cfg=surface)
        builder.add_ground_plane(cfg=surface)
        model = builder.finalize()
        met = warp.array(np.arange(1, 1 + 2 * (balls - 1 + table)).reshape(-1, 2), dtype=warp.vec2i)
        pipeline = newton.CollisionPipeline(model, broad_phase="explicit", shape_pairs_filtered=met)
        solver = newton.solvers.SolverSemiImplicit(model, angular_damping=0.0)
        contacts, control, states = pipeline.contacts(), model.control(), (model.state(), model.state())
        poses, twists = (warp.zeros((STEPS, balls), of) for of in (warp.transform, warp.spatial_vector))

        def step(n: int) -> None:
            now, after = states[n % 2], states[1 - n % 2]
            now.clear_forces()
            pipeline.collide(now, contacts)
            solver.step(now, after, control, contacts, 1.0)
            warp.copy(poses[n], after.body_q)
            warp.copy(twists[n], after.body_qd)

        with warp.ScopedCapture() as capture:
            for n in range(STEPS):
                step(n)
    return model, states[0], poses, twists, capture.graph, step


class NewtonWorld(World):
    """A scene, written into a recording."""

    #: An addition, and an increment of three factors: half a unit each, and as much again.
    rounding = 2.0**-22

    def __init__(self, scene: Scene, radius: float) -> None:
        self._length, mass, time = radius, scene.masses[0], scene.step
        self._speed, masses = self._length / time, np.array(scene.masses) / mass
        model, self._state, *self._steps = _recorded(masses.size, scene.table, get_ident())
        # The damping that gives e in compression alone gives e^2 in both directions (`restitution`).
        wanted = zip(scene.contacts, scene.restitutions, strict=True)
        pairs = [Contact.from_restitution(c.k * time**2 / mass, e * e, c.mass / mass) for c, e in wanted]
        k, c = np.repeat(np.array([(pair.k, pair.c) for pair in pairs], np.float32).T, 2, axis=1)
        ke, kd = (each.numpy()[1 : 1 + k.size] for each in (model.shape_material_ke, model.shape_material_kd))
        ke[:], kd[:] = k, c
        means = (ke[::2] + ke[1::2]) / (k[::2] + k[1::2])
        self.effective = {"stiffness": tuple((means * scene.stiffnesses).tolist()), "step": (time,)}
        model.body_mass.numpy()[:], model.body_inv_mass.numpy()[:] = masses, 1 / masses
        self.rest = scene.masses[-1] * scene.gravity / scene.stiffnesses[-1]
        unit = self._length * 2.0**-23  # such heights are exact one radius off
        self.heights = np.round((np.array(scene.heights) - self.rest) / unit) * unit
        self._gravity = model.gravity.numpy()
        self.weightless(np.array(scene.velocities), self.heights)
        self._gravity[:, 2] = -scene.gravity * time / self._speed

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take up to `STEPS` steps; what a recording takes beyond n nobody reads."""
        poses, twists, graph, _ = self._steps
        import_module("warp").capture_launch(graph)
        velocities, heights = (each.numpy()[:n, :, 2].astype(float) for each in (twists, poses))
        return velocities * self._speed, heights * self._length

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Go on from a state without gravity."""
        poses, twists = self._state.body_q.numpy(), self._state.body_qd.numpy()
        self._gravity[:], poses[:], twists[:] = 0, (0, 0, 0, 0, 0, 0, 1), 0
        poses[:, 2], twists[:, 2] = heights / self._length, velocities / self._speed


class Newton(Engine):
    """Newton, SemiImplicit."""

    name, distribution, module, title, law = "newton", "newton", "newton", "Newton", "compression-dashpot"
    rounding, made = 1e-6, NewtonWorld

    def refusal(self, scene: Scene) -> str | None:
        """Why Newton cannot take a scene: another mapping, depths too far apart for single precision."""
        if scene.mapping != "calibrated":
            return f"mapping = {scene.mapping!r}: Newton has one; legal: 'calibrated'"
        depth = scene.speed * min(periods(scene)) / (2 * np.pi) / self.radius(scene)
        why = f"a contact {depth:.1e} radii deep beside others: single precision needs {RESOLVED:.1e}"
        return why if depth < RESOLVED else None
