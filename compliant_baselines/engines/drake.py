"""Drake: spheres on prismatic joints above a half space, in discrete and in continuous time.

Stiffness and dissipation are properties of geometries, and a ball inside a line has two contacts. So each ball has two
spheres at one place: the lower side carries the contact with the body below, the upper side is rigid and undamped, as
the table is; filters let only these pairs meet. Geometries have no mass: nothing is added to the motion.

Set-up, and why:

* `kSap` is the contact model whose law is a spring and a linear dashpot, F = max(0, k (delta + tau delta')),
  both taken at the end of the step: backward Euler, as PyBullet. The two solve the same equations and are not
  independent votes. `kTamsi`, `kSimilar` and `kLagged` are Hunt-Crossley.
* `relaxation_time` is a property of its own: `kSap` ignores the Hunt-Crossley dissipation that
  `AddContactMaterial` writes, and takes 0.1 s for a geometry that has none.
* `sap_near_rigid_threshold` is 0. Above 0 (the default is 1) a contact whose period comes near to the step is
  softened until it can be resolved: another stiffness than asked for, without a status.
* The solver stops where its residual is below 1e-6 of the momentum: a contact whose impulse in a step is less
  exerts no force at all, and starts late by that much. So there is a *shortest* step (`_too_short`).
* Steps are logged in C++ (`LogVectorOutput`, once a step).

**In continuous time** (`DrakeHuntCrossley`) contacts are Hunt and Crossley's under an integrator with error control:
F = max(0, k delta (1 + d delta')), d = A/|v0| with A from equation (*) of `restitution`. For e = 1 that is springs, on
which every reference agrees; for e < 1 it is another law than the dashpot's, to be compared with `hunt-crossley`. The
integrator is the simulator's default, of third order: contact onset and end are kinks, across which the error
estimate of a higher order means nothing. Its accuracy bounds absolute changes of heights in m and velocities in m/s:
it is scaled with the larger of the two. The "step" is the time between two samples.

Importing the package takes half a second: nothing here does before it is asked to run.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.packages import why_not
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, radius_of
from impact_xval.compliant_baselines.engines.world import World
from impact_xval.compliant_baselines.mapping import PYBULLET_RIGID, DrakeGeometry, drake_geometries
from impact_xval.compliant_baselines.restitution import hunt_crossley_coefficients

#: Relative tolerance of the engine's solver (SapSolverParameters; Python cannot set it).
SAP_TOLERANCE = 1e-6

#: Phase angle of a contact that may pass before its impulse per step reaches that; its square over 2 is the share
#: of the velocity that is lost.
LATEST_START = 0.02

#: Integration error aimed at in each step, per |v0|. Velocities at the end come out 4 times as far off.
ACCURACY = 1e-10

RIGID = DrakeGeometry(PYBULLET_RIGID, 0.0)


class Drake(Engine):
    """Drake, discrete time."""

    name = "drake"
    distribution = "drake"
    discrete = True

    def unavailable(self) -> str | None:
        """Why Drake cannot run here and the way out; None if it can."""
        way_out = "run pip install 'impact-xval[drake]' (Linux and macOS only)"
        return why_not("Drake", self.distribution, lambda: import_module("pydrake"), way_out)

    def refusal(self, scene: Scene) -> str | None:
        """Why Drake cannot take a scene: a naive mapping of more than two balls, a step that is too short."""
        if scene.mapping == "naive" and not (self.discrete and scene.table and len(scene.masses) == 2):
            return "mapping = 'naive': Drake's is that of two balls on a table in discrete time; legal: 'calibrated'"
        return _too_short(scene) if self.discrete else None

    def world(self, scene: Scene) -> DrakeWorld:
        """Set a scene up."""
        return DrakeWorld(scene, self.discrete)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Keep remarks about deformable bodies, of which there are none, from the terminal."""
        import_module("pydrake")  # it sets up the logger
        logger = logging.getLogger("drake")
        before = logger.level
        logger.setLevel(logging.ERROR)
        try:
            yield
        finally:
            logger.setLevel(before)


class DrakeHuntCrossley(Drake):
    """Drake, continuous time, Hunt-Crossley contacts; elastic ones are linear springs."""

    name, law = "drake-hunt-crossley", "hunt-crossley"
    discrete = False


class DrakeWorld(World):
    """A finished plant and the log of its states."""

    def __init__(self, scene: Scene, discrete: bool) -> None:
        self._scene, self._discrete = scene, discrete
        sides = _sides(scene)
        pairs = [below.against(above) for (_, below), (above, _) in pairwise(sides)]
        self._radius = radius_of(scene.depth([pair.stiffness for pair in pairs]))
        self._refused = _too_short(scene) if discrete else None
        if scene.settled:
            self.rest = scene.masses[-1] * scene.gravity / pairs[-1].stiffness
        self.heights = scene.start(self._radius, self.rest)
        self.effective = {"stiffness": tuple(p.stiffness for p in pairs), "step": (scene.step,)}
        if discrete:
            self.effective["damping"] = tuple(p.stiffness * p.relaxation_time for p in pairs)
        self._build(sides, scene.velocities, self.heights)

    def _build(
        self, sides: list[tuple[DrakeGeometry, DrakeGeometry]], velocities: Any, heights: Floats
    ) -> None:
        scene, step = self._scene, self._scene.step
        plants, analysis = (
            import_module(f"pydrake.{name}") for name in ("multibody.plant", "systems.analysis")
        )
        builder = import_module("pydrake.systems.framework").DiagramBuilder()
        plant, graph = plants.AddMultibodyPlantSceneGraph(builder, time_step=step if self._discrete else 0.0)
        if self._discrete:
            plant.set_discrete_contact_approximation(plants.DiscreteContactApproximation.kSap)
            plant.set_sap_near_rigid_threshold(0.0)
            plant.SetUseSampledOutputPorts(False)  # nobody reads them
        plant.mutable_gravity_field().set_gravity_vector([0, 0, -scene.gravity])
        joints = self._add_bodies(plant, graph, sides)
        log_vector_output = import_module("pydrake.systems.primitives").LogVectorOutput
        period = {} if self._discrete else {"publish_period": step}
        output = log_vector_output(plant.get_state_output_port(), builder, **period)
        self._simulator = analysis.Simulator(builder.Build())
        root = self._simulator.get_mutable_context()
        context = plant.GetMyMutableContextFromRoot(root)
        self._places = scene.places(self._radius)
        for joint, z, v in zip(joints, self._places + heights, velocities, strict=True):
            joint.set_translation(context, z)
            joint.set_translation_rate(context, v)
        if not self._discrete:
            integrator = self._simulator.get_mutable_integrator()
            integrator.set_target_accuracy(
                ACCURACY * scene.speed * max(1.0, max(scene.periods) / (2 * math.pi))
            )
            integrator.set_maximum_step_size(step)
            integrator.request_initial_step_size_target(step / 10)
            integrator.set_requested_minimum_step_size(1e-6 * step)
        self._log, self._taken = output.FindMutableLog(root), 0
        self._simulator.Initialize()

    def _add_bodies(
        self, plant: Any, graph: Any, sides: list[tuple[DrakeGeometry, DrakeGeometry]]
    ) -> list[Any]:
        """Add table and balls and finish the plant; the joints of the balls, the upper one's first."""
        geometry, tree = import_module("pydrake.geometry"), import_module("pydrake.multibody.tree")
        place, sphere = import_module("pydrake.math").RigidTransform(), geometry.Sphere(self._radius)
        joints, shapes = [], []
        for i, mass in enumerate(self._scene.masses):
            inertia = tree.SpatialInertia(mass, [0, 0, 0], tree.UnitInertia.SolidSphere(self._radius))
            body = plant.AddRigidBody(f"B{i + 1}", inertia)
            shapes.append(
                [
                    plant.RegisterCollisionGeometry(
                        body, place, sphere, f"B{i + 1}-{n}", self._properties(i - 1 + n, side)
                    )
                    for n, side in enumerate(sides[i])
                ]
            )
            joint = tree.PrismaticJoint(
                f"B{i + 1}", plant.world_frame(), body.body_frame(), [0, 0, 1], damping=0
            )
            joints.append(plant.AddJoint(joint))
        if self._scene.table:
            own = self._properties(len(joints) - 1, sides[-1][0])
            half_space = plant.RegisterCollisionGeometry(
                plant.world_body(), place, geometry.HalfSpace(), "table", own
            )
            shapes.append([half_space])
        plant.Finalize()
        met = geometry.CollisionFilterDeclaration().ExcludeWithin(
            geometry.GeometrySet([s for both in shapes for s in both])
        )
        for upper, lower in pairwise(shapes):
            met.AllowBetween(geometry.GeometrySet(upper[1]), geometry.GeometrySet(lower[0]))
        graph.collision_filter_manager().Apply(met)
        return joints

    def _properties(self, contact: int, side: DrakeGeometry) -> Any:
        """Frictionless proximity properties of a side, which takes part in a contact."""
        geometry, plant = import_module("pydrake.geometry"), import_module("pydrake.multibody.plant")
        properties, how = geometry.ProximityProperties(), {"friction": plant.CoulombFriction(0.0, 0.0)}
        if not self._discrete:
            rigid = side is RIGID
            e = np.array(self._scene.restitutions[contact : contact + 1])
            how["dissipation"] = 0.0 if rigid else float(hunt_crossley_coefficients(e)[0]) / self._scene.speed
        geometry.AddContactMaterial(properties=properties, point_stiffness=side.stiffness, **how)
        if self._discrete:
            properties.AddProperty("material", "relaxation_time", side.relaxation_time)
        return properties

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps, logged in C++."""
        if self._refused:
            raise RuntimeError(self._refused)
        balls, step = len(self._places), self._scene.step
        self._log.Clear()
        self._simulator.AdvanceTo((self._taken + n) * step)
        # The first sample may repeat the last of the call before.
        data = self._log.data()[:, self._log.sample_times() > (self._taken + 0.5) * step]
        self._taken += n
        return data[balls:].T.copy(), data[:balls].T - self._places

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Gravity is part of a finished plant: another one goes on from here."""
        self._scene = replace(self._scene, gravity=0.0, settled=False)
        self._build(_sides(self._scene), velocities, heights)


def _sides(scene: Scene) -> list[tuple[DrakeGeometry, DrakeGeometry]]:
    """Upper and lower side of every ball, and of the table."""
    if scene.mapping == "naive":
        return [
            (body, body) for body in drake_geometries(scene.contacts[0], scene.contacts[1], scene.mapping)
        ]
    below = [(RIGID, DrakeGeometry(contact.k, contact.c / contact.k)) for contact in scene.contacts]
    return [*below, (RIGID, RIGID)]


def _too_short(scene: Scene) -> str | None:
    """Why a step is so short that the engine neglects a contact; None if it is not.

    The engine compares residuals with the momentum of all bodies, both per sqrt(mass): an impulse M u of a pair that
    meets at u counts sqrt(M) u beside sqrt(sum m v^2). k v t h reaches its tolerance of that at the phase omega t.
    """
    total = math.sqrt(sum(m * v * v for m, v in zip(scene.masses, scene.velocities, strict=True)))
    slow = min(c.omega * math.sqrt(c.mass) for c in scene.contacts) * scene.speed / total
    if SAP_TOLERANCE / (slow * scene.step) <= LATEST_START:
        return None
    return (
        f"step = {scene.step:.3g} s: Drake neglects impulses below {SAP_TOLERANCE:.0e} of the momentum, and with them "
        f"the slower contact; a step of {SAP_TOLERANCE / (slow * LATEST_START):.2g} s or more is needed"
    )
