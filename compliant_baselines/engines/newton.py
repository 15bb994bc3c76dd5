"""Newton (Warp) on a processor, in single precision: its solvers SemiImplicit and Featherstone.

**Law.** While bodies overlap by delta, F = ke delta + kd max(0, delta'). Here ke and kd are the means of the parameters
of the two shapes (the engine's kernels_contact.py). This is the law `compression-dashpot`, whose dashpot acts in
compression only. Both solvers compute the force by the same function. SemiImplicit then moves bodies, and Featherstone
moves joints; here the joint of a ball lets it move freely. The solver XPBD is in `rigid.newton`.

**Bodies.** A ball has two spheres, as in `drake`. The sphere for contacts below the ball has its centre above the
ball's origin, and the sphere for contacts above the ball has its centre below. So all contacts are at height 0, and a
penetration is no difference of large heights.

**Default settings.** In the solver `newton:default` every contact has the stiffness and damping that a shape gets if a
user sets none. Its step is the step of the engine's examples, a tenth of 1/60 s.

**Units** are the radius, the step and the mass of ball 1. A step is then 1 in every scene. So Warp records steps once
for a number of balls, and replays this recording for all scenes. Replaying takes a hundredth of the time of calls from
Python.
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

#: Default stiffness in N/m and damping in N s/m of a shape (`newton.ModelBuilder.ShapeConfig`).
SHIPPED_STIFFNESS, SHIPPED_DAMPING = 2500.0, 100.0

#: Smallest depth over the radius that is known to three digits. The surface of a sphere is known to 2^-24 of the
#: radius.
RESOLVED = 2.0**-14


class NewtonSetting(NamedTuple):
    """One of Newton's solvers, with the way to make it and to record its steps."""

    #: Name of the solver's class in `newton.solvers`.
    solver: str
    #: Arguments of the class, in addition to the model.
    options: tuple[tuple[str, bool | int | float], ...]
    #: Number of steps in a recording. It is even, because states are written to two places in turn.
    steps: int
    #: Length of a step in the engine's units of time.
    time: float = 1.0


SEMI_IMPLICIT = NewtonSetting("SolverSemiImplicit", (("angular_damping", 0.0),), 64)

#: The recording is shorter, because recording a step takes five times as long as with SemiImplicit.
FEATHERSTONE = NewtonSetting("SolverFeatherstone", (("angular_damping", 0.0),), 16)


class WarpArray(Protocol):
    """An array of Warp in the memory of the processor."""

    def numpy(self) -> NDArray[np.float32]:
        """Return the array as a NumPy array in the same memory."""
        ...


class NewtonModel(Protocol):
    """The members of `newton.Model` that the adapter reads and writes."""

    body_mass: WarpArray
    body_inv_mass: WarpArray
    gravity: WarpArray
    #: Stiffness (ke) and damping (kd) of each shape.
    shape_material_ke: WarpArray
    shape_material_kd: WarpArray
    #: Coefficient of restitution of each shape.
    shape_material_restitution: WarpArray


class NewtonSolver(Protocol):
    """The method of the solvers in `newton.solvers` that the adapter calls."""

    def notify_model_changed(self, flags: int) -> None:
        """Tell the solver that parameters of the model have changed."""
        ...


class NewtonState(Protocol):
    """The members of `newton.State` that the adapter writes."""

    #: Pose and velocity of every body.
    body_q: WarpArray
    body_qd: WarpArray
    #: Pose and velocity of every body again, as coordinates and speeds of its joint, which Featherstone reads; flat.
    joint_q: WarpArray
    joint_qd: WarpArray


class Recording(NamedTuple):
    """Steps that Warp has recorded, with the arrays that they read and write."""

    #: The solver. It may keep copies of masses.
    solver: NewtonSolver
    #: The argument of `NewtonSolver.notify_model_changed` for masses that have changed.
    masses_changed: int
    #: The model, with masses, gravity and shapes.
    model: NewtonModel
    #: Poses and velocities of the bodies, from which the recorded steps start and in which they end.
    state: NewtonState
    #: Pose and velocity of every body after each step, shape (steps, balls).
    poses: WarpArray
    twists: WarpArray
    #: The recorded steps, as an object that Warp can replay.
    graph: object
    #: The function that was recorded. It is kept because the recording refers to objects that it holds.
    step: Callable[[int], None]


@lru_cache(maxsize=16)
def _record(setting: NewtonSetting, balls: int, table: bool, _thread: int) -> Recording:
    """Record steps of a line of balls; each thread has its own recording, because replaying changes its arrays."""
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
        # Shapes are numbered from the top down, two for each ball. Shape 0 is the upper side of ball 1, which meets
        # nothing.
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
    """A scene whose parameters are written into a recording of steps.

    The units are the radius, the mass of ball 1, and the unit of time in which a step lasts `setting.time`.

    Parameters
    ----------
    scene
        The scene.
    radius
        Radius of the balls in m.
    setting
        The solver.
    contacts
        Parameters of the contacts in these units: for each attribute of the engine's model, by its name, an array of
        shape (C,).
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
        """Return a parameter of the contacts as the engine uses it: the mean of a contact's two shapes."""
        values: WarpArray = getattr(self._recording.model, attribute)
        of_shapes = values.numpy()[1 : 1 + 2 * contacts].astype(float)
        return 0.5 * (of_shapes[::2] + of_shapes[1::2])

    def start(self, velocities: Floats, heights: Floats, gravity: float) -> None:
        """Write the state from which steps start, and gravity in m/s^2.

        Velocities are in m/s. Heights are in m, counted from the places where balls just touch.
        """
        self._gravity[:] = 0
        self._gravity[:, 2] = -gravity * self._length / self._speed**2
        state = self._recording.state
        for poses, twists in ((state.body_q, state.body_qd), (state.joint_q, state.joint_qd)):
            q, qd = poses.numpy().reshape(-1, 7), twists.numpy().reshape(-1, 6)
            q[:] = (0, 0, 0, 0, 0, 0, 1)
            qd[:] = 0
            q[:, 2], qd[:, 2] = heights / self._length, velocities / self._speed

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Replay the recorded steps, and return velocities in m/s and heights in m after the first n of them."""
        import_module("warp").capture_launch(self._recording.graph)
        velocities = self._recording.twists.numpy()[:n, :, 2].astype(float)
        heights = self._recording.poses.numpy()[:n, :, 2].astype(float)
        return velocities * self._speed, heights * self._length


class NewtonWorld(World):
    """A scene in Newton, whose steps are replayed from a recording."""

    #: Rounding in single precision: half a unit for an addition and for each of three factors of an increment, and as
    #: much again.
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
        unit = (
            radius * 2.0**-23
        )  # at a distance of one radius, multiples of this unit are exact in single precision
        self.heights = np.round((np.array(scene.heights) - self.rest) / unit) * unit
        self._recorded.start(np.array(scene.velocities), self.heights, scene.gravity)

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Replay all steps of the recording, and return the velocities and heights after the first n of them."""
        return self._recorded.advance(n)

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Continue without gravity from the given velocities in m/s and heights in m."""
        self._recorded.start(velocities, heights, 0.0)


def stiffness_and_damping(scene: Scene) -> list[tuple[float, float]]:
    """Return the stiffness in N/m and the damping in N s/m of each contact.

    Newton's dashpots act only in compression. For the restitution e they need the damping with which a dashpot that
    acts in both directions gives e^2 (`restitution`).
    """
    if scene.mapping == "shipped":
        return [(SHIPPED_STIFFNESS, SHIPPED_DAMPING)] * len(scene.stiffnesses)
    pairs = [
        KelvinVoigtContact.from_restitution(contact.k, e * e, contact.mass)
        for contact, e in zip(scene.contacts, scene.restitutions, strict=True)
    ]
    return [(pair.k, pair.c) for pair in pairs]


class Newton(Engine):
    """Newton with its SemiImplicit solver."""

    name, distribution, module, title, law = "newton", "newton", "newton", "Newton", "compression-dashpot"
    rounding = 1e-6
    shipped_step = 1 / 600

    #: The engine's solver.
    setting = SEMI_IMPLICIT

    def radius(self, scene: Scene) -> float:
        """Return the radius in m of the balls."""
        return radius_of(scene.depth([stiffness for stiffness, _ in stiffness_and_damping(scene)]))

    def world(self, scene: Scene) -> NewtonWorld:
        """Set up a scene in a recording for as many balls."""
        return NewtonWorld(scene, self.radius(scene), self.setting)

    def refusal(self, scene: Scene) -> str | None:
        """Return a sentence that says why Newton cannot take a scene, or None.

        Newton has no other mapping than the calibrated one. It refuses depths that differ too much for single
        precision.
        """
        if scene.mapping not in ("calibrated", "shipped"):
            return f"mapping = {scene.mapping!r}: Newton has only one mapping; legal: 'calibrated'"
        if scene.mapping == "shipped":
            return None
        depth = scene.speed * min(periods(scene)) / (2 * np.pi) / self.radius(scene)
        if depth < RESOLVED:
            return f"a contact is only {depth:.1e} radii deep: single precision needs {RESOLVED:.1e} radii"
        return None


class NewtonFeatherstone(Newton):
    """Newton with its Featherstone solver."""

    name, setting = "newton:featherstone", FEATHERSTONE
