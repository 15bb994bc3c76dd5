"""Drake: spheres on joints along which they slide; docs/mapping.md, section 2, gives the reason for each setting.

**Bodies.** In Drake stiffness and dissipation belong to geometries, and a ball inside a line has two contacts. So each
ball has a sphere for each of its contacts, all with the same centre. The sphere of a contact's first body, which in a
line is the upper body, has the parameters of the contact. The sphere of the second body is rigid and undamped, and so
is a plane. Filters let only the two shapes of a contact meet. Steps are recorded in C++.

**Discrete time.** Drake has three approximations of a contact. ``kSap`` is a spring and a dashpot with a relaxation
time. ``kLagged``, which is Drake's default, and ``kSimilar`` are Hunt and Crossley's contacts.

**Hunt and Crossley's contacts** are F = max(0, k delta (1 + d delta')) with the depth delta. Here d = A/|v0|, with A
from equation (*) of `restitution`. For e < 1 this law differs from that of a spring and dashpot.

**Continuous time.** Contacts are Hunt and Crossley's. The integrator is the simulator's default, of third order. The
motion has kinks where contacts begin and end. Across a kink an error estimate of higher order has no meaning. The
"step" is the time between two samples.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from types import ModuleType
from typing import Protocol

import numpy as np

from impact_xval.compliant_baselines.engines.arrangement import SPACE_AXES, in_space
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, periods, radius_of
from impact_xval.compliant_baselines.mapping import (
    ContactSides,
    Side,
    combine_sides,
    drake_side,
    sides_of_contacts,
)
from impact_xval.compliant_baselines.restitution import hunt_crossley_coefficients

#: Relative tolerance of Drake's contact solver (SapSolverParameters). It cannot be set from Python.
SAP_TOLERANCE = 1e-6

#: Largest phase angle omega t, counted from the touch, until which the engine may neglect the impulses of a contact. It
#: neglects impulses per step below the tolerance. Half the square of the angle is the fraction of the velocity change
#: that is then missing.
LATEST_START = 0.02

#: Error over |v0| that the integrator may make in each step. The error of final velocities is 4 times as large.
ACCURACY = 1e-10


class DrakeJoint(Protocol):
    """The methods of a `PrismaticJoint` that the adapter calls."""

    def set_translation(self, context: object, translation: float) -> None:
        """Set the position along the joint in m."""
        ...

    def set_translation_rate(self, context: object, translation_dot: float) -> None:
        """Set the velocity along the joint in m/s."""
        ...


class DrakeBody(Protocol):
    """The methods of a `RigidBody` that the adapter calls."""

    def body_frame(self) -> object:
        """Return the frame of the body."""
        ...


class DrakeProperties(Protocol):
    """The methods of `ProximityProperties` that the adapter calls."""

    def AddProperty(self, group_name: str, name: str, value: float) -> None:
        """Set a property of a shape, such as a stiffness."""
        ...

    def GetPropertyOrDefault(self, group_name: str, name: str, default_value: float) -> float:
        """Return a property of a shape, or the default if the property is not set."""
        ...


class DrakePlant(Protocol):
    """The methods of a `MultibodyPlant` with which the adapter adds bodies."""

    def AddRigidBody(self, name: str, inertia: object, /) -> DrakeBody:
        """Add a body with a `SpatialInertia`."""
        ...

    def AddJoint(self, joint: object, /) -> DrakeJoint:
        """Add a `PrismaticJoint`, and return the plant's own object for it."""
        ...

    def RegisterCollisionGeometry(
        self, body: DrakeBody, pose: object, shape: object, name: str, properties: DrakeProperties, /
    ) -> object:
        """Add a shape that collides, and return its `GeometryId`."""
        ...

    def Finalize(self) -> None:
        """Finish the plant: nothing can be added afterwards."""
        ...

    def world_body(self) -> DrakeBody:
        """Return the body that does not move."""
        ...

    def world_frame(self) -> object:
        """Return the frame of the body that does not move."""
        ...


class DrakeFilterManager(Protocol):
    """The method of a `CollisionFilterManager` that the adapter calls."""

    def Apply(self, declaration: object, /) -> None:
        """Apply a `CollisionFilterDeclaration`, which says which shapes can meet."""
        ...


class DrakeInspector(Protocol):
    """The method of a `SceneGraphInspector` that the adapter calls."""

    def GetProximityProperties(self, geometry_id: object, /) -> DrakeProperties:
        """Return the contact properties of a shape."""
        ...


class DrakeSceneGraph(Protocol):
    """The methods of a `SceneGraph` that the adapter calls."""

    def collision_filter_manager(self) -> DrakeFilterManager:
        """Return the object that is told which shapes can meet."""
        ...

    def model_inspector(self) -> DrakeInspector:
        """Return the object that reads the scene."""
        ...


class Drake(Engine):
    """Drake in discrete time, with springs and dashpots (`kSap`)."""

    name = distribution = "drake"
    knows_planes = True
    title, module, way_out = "Drake", "pydrake", "run pip install 'impact-xval[drake]' (Linux and macOS only)"
    #: Name of the contact approximation in `DiscreteContactApproximation`; empty for continuous time.
    approximation = "kSap"

    def refusal(self, scene: Scene) -> str | None:
        """Return a sentence that says why Drake cannot take a scene, or None.

        Drake refuses the naive mapping for anything but two balls on a table, and a step that is too short.
        """
        pair = scene.table and len(scene.masses) == 2
        if scene.mapping == "naive" and not (self.approximation == "kSap" and pair):
            return (
                "mapping = 'naive': Drake has it only for two balls on a table, by kSap; legal: 'calibrated'"
            )
        return _too_short(scene) if self.approximation else None

    def world(self, scene: Scene) -> DrakeWorld:
        """Set up a scene in a new plant."""
        return DrakeWorld(scene, self.approximation)

    @contextmanager
    def running(self) -> Generator[None]:
        """Keep Drake's remarks about deformable bodies off the terminal; our scenes have no such bodies."""
        import_module("pydrake")  # this import sets up the logger
        logger = logging.getLogger("drake")
        before = logger.level
        logger.setLevel(logging.ERROR)
        try:
            yield
        finally:
            logger.setLevel(before)


class DrakeHuntCrossley(Drake):
    """Drake in continuous time, with Hunt and Crossley's contacts; for e = 1 these are linear springs."""

    name, law, approximation = "drake-hunt-crossley", "hunt-crossley", ""


class DrakeLagged(Drake):
    """Drake in discrete time, with Hunt and Crossley's contacts whose damping uses the depth before the step."""

    law, approximation = "hunt-crossley", "kLagged"


class DrakeSimilar(Drake):
    """Drake in discrete time, with contacts similar to Hunt and Crossley's; a step's force depends only on its end."""

    law, approximation = "hunt-crossley", "kSimilar"


class DrakeWorld(World):
    """A scene in Drake: a finished plant, its simulator, and the record of its states."""

    def __init__(self, scene: Scene, approximation: str) -> None:
        self._scene, self._approximation = scene, approximation
        self._dashpots = approximation == "kSap"
        if self._dashpots:
            contacts = [drake_side(contact) for contact in scene.contacts]
        else:
            dissipation = hunt_crossley_coefficients(np.array(scene.restitutions)) / scene.speed
            contacts = [*map(Side, scene.stiffnesses, dissipation.tolist())]
        self._sides = sides_of_contacts(contacts, scene.mapping)
        pairs = combine_sides(self._sides)
        radius = radius_of(scene.depth([pair.stiffness for pair in pairs]), scene.axes)
        super().__init__(scene, radius, scene.masses[-1] * scene.gravity / pairs[-1].stiffness)
        self._refused = _too_short(scene) if approximation else None
        self._build(scene.velocities, self.heights)
        pairs = combine_sides(self._sides_read)
        self.effective = {"stiffness": tuple(pair.stiffness for pair in pairs), "step": (scene.step,)}
        if self._dashpots:
            self.effective["damping"] = tuple(pair.stiffness * pair.dissipation for pair in pairs)

    def _build(self, velocities: Sequence[float], heights: Floats) -> None:
        """Make a plant and its simulator, with the balls at heights in m and with velocities in m/s."""
        scene, step = self._scene, self._scene.step
        plants, builder = _module("multibody.plant"), _module("systems.framework").DiagramBuilder()
        plant, graph = plants.AddMultibodyPlantSceneGraph(
            builder, time_step=step if self._approximation else 0.0
        )
        if self._approximation:
            approximation = getattr(plants.DiscreteContactApproximation, self._approximation)
            plant.set_discrete_contact_approximation(approximation)
            plant.set_sap_near_rigid_threshold(0.0)
            plant.SetUseSampledOutputPorts(False)  # the adapter reads no output ports
        plant.mutable_gravity_field().set_gravity_vector([0, 0, -scene.gravity])
        joints = self._add_bodies(plant, graph)
        period = {} if self._approximation else {"publish_period": step}
        log_state = _module("systems.primitives").LogVectorOutput
        output = log_state(plant.get_state_output_port(), builder, **period)
        self._simulator = _module("systems.analysis").Simulator(builder.Build())
        root = self._simulator.get_mutable_context()
        context = plant.GetMyMutableContextFromRoot(root)
        for joint, z, v in zip(joints, self.places + heights, velocities, strict=True):
            joint.set_translation(context, z)
            joint.set_translation_rate(context, v)
        if not self._approximation:
            # The integrator has one accuracy for heights in m and velocities in m/s. It limits the larger of the two
            # errors.
            integrator = self._simulator.get_mutable_integrator()
            height_over_speed = max(periods(scene)) / (2 * math.pi)
            integrator.set_target_accuracy(ACCURACY * scene.speed * max(1.0, height_over_speed))
            integrator.set_maximum_step_size(step)
            integrator.request_initial_step_size_target(step / 10)
            integrator.set_requested_minimum_step_size(1e-6 * step)
        self._log, self._taken = output.FindMutableLog(root), 0
        self._simulator.Initialize()

    def _add_bodies(self, plant: DrakePlant, graph: DrakeSceneGraph) -> list[DrakeJoint]:
        """Add planes and balls, finish the plant, and return the joints, ordered by ball and then by axis."""
        geometry, tree, transforms = _module("geometry"), _module("multibody.tree"), _module("math")
        identity, arrangement = transforms.RigidTransform(), self._scene.arrangement
        sphere, inertia = geometry.Sphere(self.radius), tree.UnitInertia.SolidSphere(self.radius)
        joints: list[DrakeJoint] = []
        balls: list[DrakeBody] = []
        for i, mass in enumerate(self._scene.masses):
            frame = plant.world_frame()
            *lighter, last_axis = SPACE_AXES[arrangement.axes]
            # In a plane a massless body slides along the first axis. The ball slides on this body along the last axis.
            for axis in lighter:
                carrier = plant.AddRigidBody(f"B{i + 1}-{axis}", tree.SpatialInertia.Zero())
                joints.append(plant.AddJoint(_slide(f"B{i + 1}-{axis}", frame, carrier, axis)))
                frame = carrier.body_frame()
            ball = plant.AddRigidBody(f"B{i + 1}", tree.SpatialInertia(mass, [0, 0, 0], inertia))
            joints.append(plant.AddJoint(_slide(f"B{i + 1}", frame, ball, last_axis)))
            balls.append(ball)
        shapes: list[tuple[object, object]] = []
        for contact, (touch, sides) in enumerate(zip(arrangement.touches, self._sides, strict=True)):
            second, pose, shape = plant.world_body(), identity, geometry.HalfSpace()
            if touch.second is None:
                (point,) = in_space(self.radius * arrangement.surface(contact), arrangement.axes)
                (normal,) = in_space(np.array(touch.normal), arrangement.axes)
                turn = transforms.RotationMatrix.MakeYRotation(math.atan2(normal[0], normal[2]))
                pose = transforms.RigidTransform(turn, point)
            else:
                second, shape = balls[touch.second], sphere
            materials = [self._material(side) for side in sides]
            add = plant.RegisterCollisionGeometry
            shapes.append(
                (
                    add(balls[touch.first], identity, sphere, f"{contact}-first", materials[0]),
                    add(second, pose, shape, f"{contact}-second", materials[1]),
                )
            )
        plant.Finalize()
        all_shapes = geometry.GeometrySet([shape for both in shapes for shape in both])
        filters = geometry.CollisionFilterDeclaration().ExcludeWithin(all_shapes)
        for first_side, second_side in shapes:
            filters.AllowBetween(geometry.GeometrySet(first_side), geometry.GeometrySet(second_side))
        graph.collision_filter_manager().Apply(filters)
        properties = graph.model_inspector().GetProximityProperties
        self._sides_read = [
            ContactSides(*(_read_side(properties(shape)) for shape in both)) for both in shapes
        ]
        return joints

    def _material(self, side: Side) -> DrakeProperties:
        """Make frictionless contact properties with the parameters of one of the two bodies of a contact."""
        geometry, frictionless = _module("geometry"), _module("multibody.plant").CoulombFriction(0.0, 0.0)
        properties = geometry.ProximityProperties()
        dissipation = {} if self._dashpots else {"dissipation": side.dissipation}
        geometry.AddContactMaterial(
            properties=properties, friction=frictionless, point_stiffness=side.stiffness, **dissipation
        )
        if self._dashpots:
            properties.AddProperty("material", "relaxation_time", side.dissipation)
        return properties

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps in C++, and return the recorded velocities in m/s and heights in m."""
        if self._refused:
            raise RuntimeError(self._refused)
        coordinates, step = len(self.places), self._scene.step
        self._log.Clear()
        self._simulator.AdvanceTo((self._taken + n) * step)
        # The first sample may be the last sample of the call before.
        data = self._log.data()[:, self._log.sample_times() > (self._taken + 0.5) * step]
        self._taken += n
        return data[coordinates:].T.copy(), data[:coordinates].T - self.places

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Continue without gravity, in a new plant, because the gravity of a finished plant cannot be changed."""
        self._scene = replace(self._scene, gravity=0.0)
        self._build(velocities.tolist(), heights)


def _slide(name: str, frame: object, body: DrakeBody, axis: int) -> object:
    """Make the joint along which a body slides on a frame; `axis` is its position in (x, y, z)."""
    direction = np.eye(3)[axis]
    return _module("multibody.tree").PrismaticJoint(name, frame, body.body_frame(), direction, damping=0)


def _module(name: str) -> ModuleType:
    """Import a module of `pydrake` by its name."""
    return import_module(f"pydrake.{name}")


def _read_side(properties: DrakeProperties) -> Side:
    """Read one body's parameters in a contact back from the engine. A relaxation time that is not set becomes 0."""
    names = "point_contact_stiffness", "relaxation_time"
    return Side(*(properties.GetPropertyOrDefault("material", name, 0.0) for name in names))


def _too_short(scene: Scene) -> str | None:
    """Return a sentence if the step is so short that the engine neglects a contact; else None.

    The engine compares residuals with the momentum of all bodies, both divided by sqrt(mass). For two bodies of reduced
    mass M that meet at the speed u it compares sqrt(M) u, the impulse M u over sqrt(M), with sqrt(sum m v^2). In a step
    of length h at the time t after touch the impulse is k v t h. It reaches the tolerance at a phase omega t. This
    phase must be at most `LATEST_START`.
    """
    momentum = math.sqrt(sum(m * v * v for m, v in zip(scene.inertia, scene.velocities, strict=True)))
    slowest = min(c.omega * math.sqrt(c.mass) for c in scene.contacts) * scene.speed / momentum
    if SAP_TOLERANCE / (slowest * scene.step) <= LATEST_START:
        return None
    return (
        f"step = {scene.step:.3g} s: Drake neglects impulses below {SAP_TOLERANCE:.0e} of the momentum, and with them "
        f"the slower contact; a step of {SAP_TOLERANCE / (slowest * LATEST_START):.2g} s or more is needed"
    )
