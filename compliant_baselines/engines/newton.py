"""Newton (Warp) on a processor, in single precision: SemiImplicit and Featherstone, by dashpots in compression.

**Law.** While bodies overlap F = ke delta + kd max(0, delta'), where ke and kd are the means of the two shapes' numbers
(the engine's kernels_contact.py). That is `compression-dashpot`. Both solvers call the same function for it.
SemiImplicit moves bodies by it, and Featherstone moves joints; here a joint is the free motion of a ball.
`rigid.newton` has XPBD.

**Bodies.** A ball has two spheres, as in `drake`: the lower side is above its origin, the upper side below. So all
contacts happen at height 0, and a penetration is no difference of large heights.

**As it ships.** Every contact has the stiffness and damping that a shape has unless others are set, at a step of its
examples, ten a frame of 1/60 s.

**Units** are the radius, the step and the mass of ball 1. A step is then 1 in every scene, and one recording of steps
serves all scenes of as many balls. Warp replays a recording in C++ at a hundredth of the cost of calls from Python.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from importlib import import_module
from threading import get_ident
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.engines.engine import Engine, standard_error_without
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, periods, radius_of
from impact_xval.compliant_baselines.mapping import KelvinVoigtContact

#: Stiffness in N/m and damping in N s/m of a shape, if none are set (`newton.ModelBuilder.ShapeConfig`).
SHIPPED_STIFFNESS, SHIPPED_DAMPING = 2500.0, 100.0

#: Smallest depth over the radius that has three digits: the surface of a sphere is known to 2^-24 of the radius.
RESOLVED = 2.0**-14


class NewtonSetting(NamedTuple):
    """A solver of Newton, and how it is made and recorded."""

    #: Name of its class in `newton.solvers`.
    solver: str
    #: Arguments of the class, beside the model.
    options: tuple[tuple[str, bool | int | float], ...]
    #: Steps of a recording; an even number, as states are written to two places in turn.
    steps: int
    #: Length of a step in the engine's units of time.
    time: float = 1.0


SEMI_IMPLICIT = NewtonSetting("SolverSemiImplicit", (("angular_damping", 0.0),), 64)

#: It takes five times as long to record a step.
FEATHERSTONE = NewtonSetting("SolverFeatherstone", (("angular_damping", 0.0),), 16)


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
    #: Coefficient of restitution of each shape.
    shape_material_restitution: WarpArray


class NewtonSolver(Protocol):
    """What the adapter calls of a solver of `newton.solvers`."""

    def notify_model_changed(self, flags: int) -> None:
        """Take over what has changed in the model."""
        ...


class NewtonState(Protocol):
    """What the adapter writes of `newton.State`."""

    #: Pose and velocity of every body.
    body_q: WarpArray
    body_qd: WarpArray
    #: The same as coordinates and speeds of the bodies' free joints, which Featherstone reads; flat.
    joint_q: WarpArray
    joint_qd: WarpArray


class Recording(NamedTuple):
    """Steps that Warp has recorded, with the arrays that they read and write; all objects are the engine's."""

    #: The solver, which may keep copies of masses.
    solver: NewtonSolver
    #: What says to `NewtonSolver.notify_model_changed` that masses have changed.
    masses_changed: int
    #: Masses, gravity and shapes.
    model: NewtonModel
    #: Poses and velocities of the bodies, before and after the steps.
    state: NewtonState
    #: Pose and velocity of every body after each step, shape (steps, balls).
    poses: WarpArray
    twists: WarpArray
    #: The recorded steps.
    graph: object
    #: The function that was recorded; it holds what the graph points to.
    step: Callable[[int], None]


@lru_cache(maxsize=16)
def _record(setting: NewtonSetting, balls: int, table: bool, _thread: int) -> Recording:
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
        pipeline = newton.CollisionPipeline(
            model, broad_phase="explicit", shape_pairs_filtered=pairs, rigid_contact_max=len(pairs)
        )
        solver = getattr(newton.solvers, setting.solver)(model, **dict(setting.options))
        contacts, control, states = pipeline.contacts(), model.control(), (model.state(), model.state())
        poses = warp.zeros((setting.steps, balls), warp.transform)
        twists = warp.zeros((setting.steps, balls), warp.spatial_vector)

        def step(n: int) -> None:
            now, after = states[n % 2], states[1 - n % 2]
            now.clear_forces()
            pipeline.collide(now, contacts)
            solver.step(now, after, control, contacts, setting.time)
            warp.copy(poses[n], after.body_q)
            warp.copy(twists[n], after.body_qd)

        with warp.ScopedCapture() as capture:
            for n in range(setting.steps):
                step(n)
    changed = int(newton.ModelFlags.BODY_INERTIAL_PROPERTIES)
    return Recording(solver, changed, model, states[0], poses, twists, capture.graph, step)


class RecordedScene:
    """A scene, written into a recording, in units of the radius, the mass of ball 1, and the setting's time.

    Parameters
    ----------
    scene
        The scene.
    radius
        Radius of the balls in m.
    setting
        The solver.
    contacts
        Numbers of each contact, shape (C,), by the attribute of the model that has them; in those units.
    """

    def __init__(
        self, scene: Scene, radius: float, setting: NewtonSetting, contacts: Mapping[str, Floats]
    ) -> None:
        self._length, self._speed = radius, setting.time * radius / scene.step
        self._recording = recording = _record(setting, len(scene.masses), scene.table, get_ident())
        self._steps = setting.steps
        for attribute, numbers in contacts.items():
            values: WarpArray = getattr(recording.model, attribute)
            values.numpy()[1 : 1 + 2 * len(numbers)] = np.repeat(np.asarray(numbers, np.float32), 2)
        masses = np.array(scene.masses) / scene.masses[0]
        model = recording.model
        model.body_mass.numpy()[:], model.body_inv_mass.numpy()[:] = masses, 1 / masses
        with standard_error_without(b"Warp CUDA warning"):
            recording.solver.notify_model_changed(recording.masses_changed)
        self._gravity = model.gravity.numpy()

    def numbers(self, attribute: str, contacts: int) -> Floats:
        """Read back the numbers of contacts, as the engine combines those of two shapes: their means."""
        values: WarpArray = getattr(self._recording.model, attribute)
        of_shapes = values.numpy()[1 : 1 + 2 * contacts].astype(float)
        return 0.5 * (of_shapes[::2] + of_shapes[1::2])

    def start(self, velocities: Floats, heights: Floats, gravity: float) -> None:
        """Write velocities in m/s, heights in m above the places where balls only just touch, and gravity in m/s^2."""
        self._gravity[:] = 0
        self._gravity[:, 2] = -gravity * self._length / self._speed**2
        state = self._recording.state
        for poses, twists in ((state.body_q, state.body_qd), (state.joint_q, state.joint_qd)):
            q, qd = poses.numpy().reshape(-1, 7), twists.numpy().reshape(-1, 6)
            q[:] = (0, 0, 0, 0, 0, 0, 1)
            qd[:] = 0
            q[:, 2], qd[:, 2] = heights / self._length, velocities / self._speed

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take the steps of the recording; return velocities in m/s and heights in m after the first n of them."""
        import_module("warp").capture_launch(self._recording.graph)
        velocities = self._recording.twists.numpy()[:n, :, 2].astype(float)
        heights = self._recording.poses.numpy()[:n, :, 2].astype(float)
        return velocities * self._speed, heights * self._length


class NewtonWorld(World):
    """A scene, written into a recording."""

    #: Of single precision: an addition and an increment of three factors, half a unit each, and as much again.
    rounding = 2.0**-22

    def __init__(self, scene: Scene, radius: float, setting: NewtonSetting) -> None:
        mass, time = scene.masses[0], scene.step
        stiffnesses, dampings = np.transpose(stiffness_and_damping(scene))
        k, c = stiffnesses * (time**2 / mass), dampings * (time / mass)
        self._recorded = RecordedScene(
            scene, radius, setting, {"shape_material_ke": k, "shape_material_kd": c}
        )
        given = self._recorded.numbers("shape_material_ke", k.size) / np.asarray(k, np.float32)
        self.effective = {"stiffness": tuple((given * stiffnesses).tolist()), "step": (time,)}
        self.rest = scene.masses[-1] * scene.gravity / float(stiffnesses[-1])
        unit = radius * 2.0**-23  # such heights are exact one radius off
        self.heights = np.round((np.array(scene.heights) - self.rest) / unit) * unit
        self._recorded.start(np.array(scene.velocities), self.heights, scene.gravity)

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take up to the steps of a recording; those beyond n are not read."""
        return self._recorded.advance(n)

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Go on from a state without gravity."""
        self._recorded.start(velocities, heights, 0.0)


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
    rounding = 1e-6
    shipped_step = 1 / 600

    #: The solver of the engine.
    setting = SEMI_IMPLICIT

    def radius(self, scene: Scene) -> float:
        """Return the radius in m of the balls."""
        return radius_of(scene.depth([stiffness for stiffness, _ in stiffness_and_damping(scene)]))

    def world(self, scene: Scene) -> NewtonWorld:
        """Set a scene up."""
        return NewtonWorld(scene, self.radius(scene), self.setting)

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


class NewtonFeatherstone(Newton):
    """Newton, Featherstone."""

    name, setting = "newton:featherstone", FEATHERSTONE
