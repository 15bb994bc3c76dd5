"""Newton (Warp) on a processor, in single precision: its SemiImplicit solver, springs with dashpots in compression.

**Law.** While bodies overlap F = ke delta + kd max(0, delta'), where ke and kd are the means of the two shapes' numbers
(the engine's kernels_contact.py). That is `compression-dashpot`.

**Bodies.** A ball has two spheres, as in `drake`: the lower side is above its origin, the upper side below. So all
contacts happen at height 0, and a penetration is no difference of large heights.

**As it ships.** Every contact has the stiffness and damping that a shape has unless others are set, at a step of its
examples, ten a frame of 1/60 s.

**Units** are the radius, the step and the mass of ball 1. A step is then 1 in every scene, and one recording of steps
serves all scenes of as many balls. Warp replays a recording in C++ at a hundredth of the cost of calls from Python.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from importlib import import_module
from threading import get_ident
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.engines.engine import Engine, standard_error_without
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, periods, radius_of
from impact_xval.compliant_baselines.mapping import KelvinVoigtContact

#: Steps of a recording; an even number, as states are written to two places in turn.
STEPS = 64

#: Stiffness in N/m and damping in N s/m of a shape, if none are set (`newton.ModelBuilder.ShapeConfig`).
SHIPPED_STIFFNESS, SHIPPED_DAMPING = 2500.0, 100.0

#: Smallest depth over the radius that has three digits: the surface of a sphere is known to 2^-24 of the radius.
RESOLVED = 2.0**-14


class WarpArray(Protocol):
    """An array of Warp, on the processor."""

    def numpy(self) -> NDArray[np.float32]:
        """Return the memory of the array."""
        ...


class NewtonModel(Protocol):
    """What the adapter reads and writes of `newton.Model`."""

    body_mass: WarpArray
    body_inv_mass: WarpArray
    gravity: WarpArray
    #: Stiffness and damping of each shape.
    shape_material_ke: WarpArray
    shape_material_kd: WarpArray


class NewtonState(Protocol):
    """What the adapter writes of `newton.State`."""

    #: Pose and velocity of every body.
    body_q: WarpArray
    body_qd: WarpArray


class Recording(NamedTuple):
    """Steps that Warp has recorded, with the arrays that they read and write; all objects are the engine's."""

    #: Masses, gravity and shapes.
    model: NewtonModel
    #: Poses and velocities of the bodies, before and after the steps.
    state: NewtonState
    #: Pose and velocity of every body after each step, shape (STEPS, balls).
    poses: WarpArray
    twists: WarpArray
    #: The recorded steps.
    graph: object
    #: The function that was recorded; it holds what the graph points to.
    step: Callable[[int], None]


@lru_cache(maxsize=16)
def _record(balls: int, table: bool, _thread: int) -> Recording:
    """Record steps of so many balls; one recording a thread."""
    newton, warp = import_module("newton"), import_module("warp")
    level = warp.ScopedLogLevel(warp.LOG_WARNING)
    with standard_error_without(b"Warp CUDA warning"), level, warp.ScopedDevice("cpu"):
        builder = newton.ModelBuilder()
        surface = builder.ShapeConfig(density=0.0, mu=0.0, gap=0.0)
        for _ in range(balls):
            body = builder.add_body(mass=1.0, inertia=np.eye(3))
            for side in (-1.0, 1.0):
                pose = warp.transform(0.0, 0.0, side, 0.0, 0.0, 0.0, 1.0)
                builder.add_shape_sphere(body, xform=pose, radius=1.0, cfg=surface)
        builder.add_ground_plane(cfg=surface)
        model = builder.finalize()
        # Shapes are numbered from the top down, two a ball; the upper side of ball 1 is shape 0 and meets nothing.
        pairs = warp.array(np.arange(1, 1 + 2 * (balls - 1 + table)).reshape(-1, 2), dtype=warp.vec2i)
        pipeline = newton.CollisionPipeline(model, broad_phase="explicit", shape_pairs_filtered=pairs)
        solver = newton.solvers.SolverSemiImplicit(model, angular_damping=0.0)
        contacts, control, states = pipeline.contacts(), model.control(), (model.state(), model.state())
        poses = warp.zeros((STEPS, balls), warp.transform)
        twists = warp.zeros((STEPS, balls), warp.spatial_vector)

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
    return Recording(model, states[0], poses, twists, capture.graph, step)


class NewtonWorld(World):
    """A scene, written into a recording."""

    #: Of single precision: an addition and an increment of three factors, half a unit each, and as much again.
    rounding = 2.0**-22

    def __init__(self, scene: Scene, radius: float) -> None:
        self._length, mass, time = radius, scene.masses[0], scene.step
        self._speed, masses = self._length / time, np.array(scene.masses) / mass
        self._recording = _record(masses.size, scene.table, get_ident())
        model = self._recording.model
        stiffnesses, dampings = np.transpose(stiffness_and_damping(scene))
        k, c = (
            np.repeat(np.asarray(values, np.float32), 2)
            for values in (stiffnesses * (time**2 / mass), dampings * (time / mass))
        )
        ke, kd = (
            values.numpy()[1 : 1 + k.size] for values in (model.shape_material_ke, model.shape_material_kd)
        )
        ke[:], kd[:] = k, c
        means = (ke[::2] + ke[1::2]) / (k[::2] + k[1::2])
        self.effective = {"stiffness": tuple((means * stiffnesses).tolist()), "step": (time,)}
        model.body_mass.numpy()[:], model.body_inv_mass.numpy()[:] = masses, 1 / masses
        self.rest = scene.masses[-1] * scene.gravity / float(stiffnesses[-1])
        unit = self._length * 2.0**-23  # such heights are exact one radius off
        self.heights = np.round((np.array(scene.heights) - self.rest) / unit) * unit
        self._gravity = model.gravity.numpy()
        self.weightless(np.array(scene.velocities), self.heights)
        self._gravity[:, 2] = -scene.gravity * time / self._speed

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take up to `STEPS` steps; the steps of the recording beyond n are not read."""
        recording = self._recording
        import_module("warp").capture_launch(recording.graph)
        velocities = recording.twists.numpy()[:n, :, 2].astype(float)
        heights = recording.poses.numpy()[:n, :, 2].astype(float)
        return velocities * self._speed, heights * self._length

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Go on from a state without gravity."""
        state = self._recording.state
        poses, twists = state.body_q.numpy(), state.body_qd.numpy()
        self._gravity[:] = 0
        poses[:] = (0, 0, 0, 0, 0, 0, 1)
        twists[:] = 0
        poses[:, 2], twists[:, 2] = heights / self._length, velocities / self._speed


def stiffness_and_damping(scene: Scene) -> list[tuple[float, float]]:
    """Return the stiffness in N/m and the damping in N s/m of each contact.

    The damping that gives e in compression alone gives e^2 in both directions (`restitution`).
    """
    if scene.mapping == "shipped":
        return [(SHIPPED_STIFFNESS, SHIPPED_DAMPING)] * len(scene.stiffnesses)
    pairs = [
        KelvinVoigtContact.from_restitution(contact.k, e * e, contact.mass)
        for contact, e in zip(scene.contacts, scene.restitutions, strict=True)
    ]
    return [(pair.k, pair.c) for pair in pairs]


class Newton(Engine):
    """Newton, SemiImplicit."""

    name, distribution, module, title, law = "newton", "newton", "newton", "Newton", "compression-dashpot"
    rounding, made = 1e-6, NewtonWorld
    shipped_step = 1 / 600

    def radius(self, scene: Scene) -> float:
        """Return the radius in m of the balls."""
        return radius_of(scene.depth([stiffness for stiffness, _ in stiffness_and_damping(scene)]))

    def refusal(self, scene: Scene) -> str | None:
        """Say why Newton cannot take a scene: another mapping, or depths too far apart for single precision."""
        if scene.mapping not in ("calibrated", "shipped"):
            return f"mapping = {scene.mapping!r}: Newton has one; legal: 'calibrated'"
        if scene.mapping == "shipped":
            return None
        depth = scene.speed * min(periods(scene)) / (2 * np.pi) / self.radius(scene)
        if depth < RESOLVED:
            return f"a contact {depth:.1e} radii deep beside others: single precision needs {RESOLVED:.1e}"
        return None
