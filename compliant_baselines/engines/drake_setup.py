"""What every scene of Drake shares, of two balls and of N; why, is in `engines.drake_engine`.

The package has no part in the types of this project, for it may not be there, and is imported where it is used.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.mapping import Contact, DrakeGeometry
from impact_xval.compliant_baselines.restitution import hunt_crossley_coefficients

#: Steps between two looks at whether the collision is over.
WINDOW = 512

#: Relative tolerance of the engine's solver (SapSolverParameters; Python cannot set it).
SAP_TOLERANCE = 1e-6

#: Phase angle of a contact that may pass before its impulse per step reaches that; its square over 2 is the share
#: of the velocity that is lost.
LATEST_START = 0.02

#: Integration error aimed at in each step, per |v0|. Velocities at the end come out 4 times as far off.
ACCURACY = 1e-10


@contextmanager
def silent() -> Iterator[None]:
    """Keep remarks about deformable bodies, of which there are none, from the terminal."""
    import_module("pydrake")  # it sets up the logger

    logger = logging.getLogger("drake")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def contact_material(**values: float) -> Any:
    """Make frictionless proximity properties of the values `AddContactMaterial` takes by name."""
    geometry, plant = import_module("pydrake.geometry"), import_module("pydrake.multibody.plant")
    properties = geometry.ProximityProperties()
    geometry.AddContactMaterial(properties=properties, friction=plant.CoulombFriction(0.0, 0.0), **values)
    return properties


def discrete_properties(geometry: DrakeGeometry) -> Any:
    """Proximity properties of a geometry under `kSap`."""
    properties = contact_material(point_stiffness=geometry.stiffness)
    properties.AddProperty("material", "relaxation_time", geometry.relaxation_time)
    return properties


def dissipation(contact: Contact, speed: float) -> float:
    """Hunt-Crossley dissipation d in s/m for the restitution of a calibrated contact, at an approach speed in m/s."""
    return float(hunt_crossley_coefficients(np.array([contact.restitution]))[0]) / speed


def too_short(step: float, slow: float) -> str | None:
    """Why a step, in s, is so short that the engine neglects a contact of this frequency, in 1/s; None if it is not."""
    # k delta h = k v t h reaches SAP_TOLERANCE m v at the phase omega t = SAP_TOLERANCE/(omega h).
    if SAP_TOLERANCE / (slow * step) <= LATEST_START:
        return None
    return (
        f"step = {step:.3g} s: Drake neglects impulses below {SAP_TOLERANCE:.0e} of the momentum, and with them the "
        f"slower contact; a step of {SAP_TOLERANCE / (slow * LATEST_START):.2g} s or more is needed"
    )


def plant_at(step: float, gravity: float = 0.0) -> tuple[Any, Any, Any]:
    """Make a diagram builder, an empty plant and its scene graph; a step of 0, in s, is continuous time."""
    plants = import_module("pydrake.multibody.plant")
    builder = import_module("pydrake.systems.framework").DiagramBuilder()
    plant, graph = plants.AddMultibodyPlantSceneGraph(builder, time_step=step)
    if step:
        plant.set_discrete_contact_approximation(plants.DiscreteContactApproximation.kSap)
        plant.set_sap_near_rigid_threshold(0.0)
        plant.SetUseSampledOutputPorts(False)  # nobody reads them
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -gravity])
    return builder, plant, graph


def add_table(plant: Any, properties: Any) -> Any:
    """Add the half space below height 0, with these proximity properties; its geometry."""
    place = import_module("pydrake.math").RigidTransform()
    half_space = import_module("pydrake.geometry").HalfSpace()
    return plant.RegisterCollisionGeometry(plant.world_body(), place, half_space, "table", properties)


def add_ball(
    plant: Any, name: str, mass: float, radius: float, properties: Sequence[Any]
) -> tuple[Any, list[Any]]:
    """Add a ball on a vertical slide, in kg and m: its joint, and a geometry for each of the proximity properties."""
    tree, place = import_module("pydrake.multibody.tree"), import_module("pydrake.math").RigidTransform()
    sphere = import_module("pydrake.geometry").Sphere(radius)
    inertia = tree.SpatialInertia(mass, [0, 0, 0], tree.UnitInertia.SolidSphere(radius))
    body = plant.AddRigidBody(name, inertia)
    geometries = [
        plant.RegisterCollisionGeometry(body, place, sphere, f"{name}-{i}", own)
        for i, own in enumerate(properties)
    ]
    joint = tree.PrismaticJoint(name, plant.world_frame(), body.body_frame(), [0, 0, 1], damping=0)
    return plant.AddJoint(joint), geometries


def simulator_of(builder: Any, plant: Any, step: float) -> tuple[Any, Any, Any]:
    """Make the simulator of a finished plant, the log of its state at every step, in s, and the plant's context."""
    period = {} if plant.time_step() else {"publish_period": step}
    log_vector_output = import_module("pydrake.systems.primitives").LogVectorOutput
    log = log_vector_output(plant.get_state_output_port(), builder, **period)
    simulator = import_module("pydrake.systems.analysis").Simulator(builder.Build())
    return simulator, log, plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())


def set_accuracy(simulator: Any, speed: float, slow: float, step: float) -> None:
    """Set the integrator up for contacts met at a speed in m/s, the slowest of a frequency in 1/s; samples in s."""
    integrator = simulator.get_mutable_integrator()
    integrator.set_target_accuracy(ACCURACY * speed * max(1.0, 1 / slow))
    integrator.set_maximum_step_size(step)
    integrator.request_initial_step_size_target(step / 10)
    integrator.set_requested_minimum_step_size(1e-6 * step)
