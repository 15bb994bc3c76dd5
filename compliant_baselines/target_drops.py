"""Drops of two bodies in engines that are set up by the printed text of a target alone (`targets`).

Each function in `RUNS` makes two bodies that meet along z, runs the text unchanged, and takes steps. Body A comes down
on body B. A fixed B is a plane, a thick plate or a large sphere. Gravity and the engine's damping of free flight are
switched off; all other settings are the engine's defaults. Engines are imported only when a drop is made. So this
module can be imported on a machine without them.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.engines import pybullet
from impact_xval.compliant_baselines.engines.engine import standard_error_without, version_of
from impact_xval.compliant_baselines.engines.lammps import open_lammps
from impact_xval.compliant_baselines.engines.scene import Floats, radius_of
from impact_xval.compliant_baselines.pasted_drops import drop_in_mujoco, drop_in_pybullet
from impact_xval.compliant_baselines.solver import SolverError
from impact_xval.compliant_baselines.targets import (
    AFTER_FINALIZE,
    BEFORE_FINALIZE,
    ContactRequest,
    Target,
)

#: Instants within a step at which the bodies touch, as fractions of the step.
PLACES = (0.01, 0.25, 0.5, 0.75, 0.99)

#: Largest change of the relative velocity in a step, over the speed of approach, that is taken for rounding in single
#: precision. A larger change is taken for a force.
ROUNDING = 1e-5

#: Length of a drop: for compliant contacts in durations of the contact, for rigid contacts in steps.
DURATIONS, RIGID_STEPS = 2.5, 60

#: Radius of the sphere that stands for a plane, in radii of the ball.
PLANE_OVER_BALL = 1e3


class DropResult(NamedTuple):
    """Results of drops of one contact, over all instants of touch within a step."""

    #: Least and greatest restitution of the drops.
    restitution: tuple[float, float]
    #: Least and greatest duration in s of the drops: the whole steps from the first step with force to the last.
    duration: tuple[float, float]


class TargetDrop(NamedTuple):
    """Numbers and text that set up a drop."""

    text: str
    request: ContactRequest
    #: Gap in m between the bodies at the start.
    gap: float
    #: Radius of the balls in m.
    radius: float
    n_steps: int

    @property
    def start(self) -> float:
        """Height of A's centre at the start, in m above B's surface."""
        return self.radius + self.gap


def missing_distribution(target: Target) -> str | None:
    """Return a sentence that names the package which a target needs and which is missing.

    None if its text can run here.
    """
    if not target.distributions:
        return f"{target.title} has no package for Python that runs this text"
    for distribution in target.distributions:
        if not version_of(distribution):
            return f"{distribution} is not installed"
    return None


def drop_target(target: Target, request: ContactRequest, places: Sequence[float] = PLACES) -> DropResult:
    """Drop two bodies set up by the text of a target, once for each of `places`. Return the least and greatest results.

    A place is the instant of touch within a step, as a fraction of the step.

    Raises
    ------
    SolverError
        If the engine is not installed, refuses the text, or the bodies do not part.
    """
    missing = missing_distribution(target)
    if missing is not None:
        raise SolverError(target.name, "unavailable", missing)
    contact, text = request.contact, target.text(request)
    way = request.speed * request.step
    if target.kind == "compliant":
        n_steps = math.ceil(DURATIONS * contact.duration / request.step) + 10
        radius = radius_of(request.speed / contact.omega)
    else:
        n_steps, radius = RIGID_STEPS, 2.0 ** math.ceil(math.log2(max(0.5, 100 * way)))
    run = RUNS[target.name]
    results: list[tuple[float, float]] = []
    for place in places:
        try:
            rates = run(TargetDrop(text, request, place * way, radius, n_steps))
        except SolverError:
            raise
        except (
            Exception
        ) as error:  # an engine that is broken or only partly installed can raise any exception
            raise SolverError(target.name, "crashed", f"{type(error).__name__}: {error}") from None
        results.append(_measure(target, request, rates))
    restitution, duration = ((min(values), max(values)) for values in zip(*results, strict=True))
    return DropResult(restitution, duration)


def _measure(target: Target, request: ContactRequest, rates: Floats) -> tuple[float, float]:
    """Return the restitution and the duration in s of a drop, from the speed of separation in m/s after every step."""
    if not np.isfinite(rates).all():
        raise SolverError(target.name, "crashed", "velocities are no longer finite")
    changes = np.abs(np.diff(rates, prepend=-request.speed))
    loaded = np.flatnonzero(changes > ROUNDING * request.speed)
    if not loaded.size:
        raise SolverError(
            target.name, "unconverged", "no step with force: the bodies passed through each other"
        )
    if loaded[-1] == rates.size - 1:
        raise SolverError(target.name, "timeout", f"not over after {rates.size} steps")
    return float(rates[-1]) / request.speed, float(loaded[-1] - loaded[0] + 1) * request.step


def _take_steps(step: Callable[[], object], rate: Callable[[], float], n: int) -> Floats:
    """Take n steps, and return the value of `rate` after each step."""
    rates = np.empty(n)
    for i in range(n):
        step()
        rates[i] = rate()
    return rates


def _in_pasted_drops(drop_once: Callable[..., list[tuple[float, int]]]) -> Callable[[TargetDrop], Floats]:
    """Return a function for `RUNS` that drops two bodies by a function of `pasted_drops`.

    Functions of `pasted_drops` return only restitution and number of steps. So the speeds of separation during the
    contact are made up; only those before and after it are measured.
    """

    def run(drop: TargetDrop) -> Floats:
        request = drop.request
        ((e, steps),) = drop_once(
            drop.text, request.masses, drop.radius, request.speed, [drop.gap], 10 * drop.n_steps
        )
        ramp = np.linspace(-request.speed, e * request.speed, steps + 1)[1:]
        return np.append(ramp, ramp[-1])

    return run


def _run_bullet(drop: TargetDrop) -> Floats:
    request = drop.request
    with pybullet.connected() as p:
        sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=drop.radius)
        if request.is_fixed:
            b = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE))
        else:
            b = p.createMultiBody(request.masses[1], sphere, basePosition=[0, 0, -drop.radius])
        a = p.createMultiBody(request.masses[0], sphere, basePosition=[0, 0, drop.start])
        exec(drop.text, {"p": p, "a": a, "b": b})
        p.resetBaseVelocity(a, [0, 0, -request.speed])

        def rate() -> float:
            return p.getBaseVelocity(a)[0][2] - p.getBaseVelocity(b)[0][2]

        return _take_steps(p.stepSimulation, rate, drop.n_steps)


def _run_drake(drop: TargetDrop) -> Floats:
    names: Any = import_module("pydrake.all")
    logging.getLogger("drake").setLevel(logging.ERROR)
    request, builder = drop.request, names.DiagramBuilder()
    scope: dict[str, Any] = {**vars(names), "builder": builder}
    exec(drop.text, scope)
    plant, sphere = scope["plant"], names.Sphere(drop.radius)
    plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])

    def add_ball(name: str, mass: float) -> Any:
        body = plant.AddRigidBody(name, names.SpatialInertia.SolidSphereWithMass(mass, drop.radius))
        place = names.RigidTransform()
        plant.RegisterCollisionGeometry(body, place, sphere, name, scope[f"properties_{name}"])
        return body

    balls = [add_ball("a", request.masses[0])]
    if request.is_fixed:
        place = names.RigidTransform()
        world, plane = plant.world_body(), names.HalfSpace()
        plant.RegisterCollisionGeometry(world, place, plane, "b", scope["properties_b"])
    else:
        balls.append(add_ball("b", request.masses[1]))
    plant.Finalize()
    log = names.LogVectorOutput(plant.get_state_output_port(), builder)
    simulator = names.Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    rows = [ball.floating_velocities_start_in_v() + 5 for ball in balls]
    for ball, height in zip(balls, (drop.start, -drop.radius), strict=False):
        plant.SetFreeBodyPose(context, ball, names.RigidTransform([0, 0, height]))
    velocities = plant.GetVelocities(context)
    velocities[rows[0]] = -request.speed
    plant.SetVelocities(context, velocities)
    simulator.AdvanceTo(drop.n_steps * request.step)
    states = log.FindLog(simulator.get_context()).data()[plant.num_positions() :]
    rates = states[rows[0]] - (states[rows[1]] if len(rows) > 1 else 0.0)
    return np.asarray(rates[1:])


def _run_newton(drop: TargetDrop) -> Floats:
    newton, warp = import_module("newton"), import_module("warp")
    request = drop.request
    first, _, after = drop.text.partition(AFTER_FINALIZE)
    before, _, between = first.partition(BEFORE_FINALIZE)
    with standard_error_without(b"Warp CUDA warning"), warp.ScopedLogLevel(warp.LOG_WARNING):
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        scope = {"newton": newton, "builder": builder}
        exec(before, scope)
        contact: Any = scope["contact"]
        contact.density = 0.0
        more = {"custom_attributes": scope["attributes"]} if "attributes" in scope else {}

        def add_ball(mass: float, height: float) -> None:
            inertia = 0.4 * mass * drop.radius**2 * np.eye(3)
            pose = warp.transform(0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0)
            body = builder.add_body(mass=mass, inertia=inertia, xform=pose)
            builder.add_shape_sphere(body, radius=drop.radius, cfg=contact, **more)

        add_ball(request.masses[0], drop.start)
        if request.is_fixed:
            builder.add_shape_plane(body=-1, width=0.0, length=0.0, cfg=contact, **more)
        else:
            add_ball(request.masses[1], -drop.radius)
        exec(between, scope)
        model = builder.finalize(device="cpu")
        scope["model"] = model
        exec(after, scope)
        solver: Any = scope["solver"]
        states = [model.state(), model.state()]
        # Newton's solvers with maximal coordinates read velocities from body_qd, those with reduced coordinates from
        # joint_qd.
        for speeds in (states[0].body_qd, states[0].joint_qd):
            values = speeds.numpy()
            values.flat[2] = -request.speed
            speeds.assign(values)
        pipeline, control = newton.CollisionPipeline(model), model.control()
        contacts = pipeline.contacts()

        def step() -> None:
            states[0].clear_forces()
            pipeline.collide(states[0], contacts)
            solver.step(states[0], states[1], control, contacts, request.step)
            states.reverse()

        def rate() -> float:
            heights = states[0].body_qd.numpy()[:, 2].astype(float)
            return heights[0] - (0.0 if request.is_fixed else heights[1])

        return _take_steps(step, rate, drop.n_steps)


def _run_lammps(drop: TargetDrop) -> Floats:
    request, radius = drop.request, drop.radius
    lammps: Any = open_lammps()
    masses = request.masses[:1] if request.is_fixed else request.masses
    far = 4 * radius + 10 * request.speed * request.step * drop.n_steps
    try:
        lammps.commands_string(
            "units si\natom_style sphere\nboundary f f f\nnewton off\n"
            f"region box block {-far!r} {far!r} {-far!r} {far!r} {-far!r} {far!r}\ncreate_box 1 box\n"
        )
        for i, (mass, height) in enumerate(zip(masses, (drop.start, -radius), strict=False), 1):
            density = mass / (4 / 3 * math.pi * radius**3)
            lammps.commands_string(
                f"create_atoms 1 single 0 0 {height!r}\nset atom {i} diameter {2 * radius!r}\n"
                f"set atom {i} density {density!r}\n"
            )
        lammps.commands_string(
            f"set atom 1 vz {-request.speed!r}\n{drop.text}\nfix motion all nve/sphere\nrun 0\n"
        )

        def rate() -> float:
            order = np.argsort(lammps.numpy.extract_atom("id")[: len(masses)])
            heights = lammps.numpy.extract_atom("v")[: len(masses), 2][order]
            return float(heights[0] - (heights[1] if len(masses) > 1 else 0.0))

        return _take_steps(lambda: lammps.command("run 1 pre no post no"), rate, drop.n_steps)
    except Exception as error:  # the package raises an exception class of its own
        raise SolverError("lammps", "crashed", " ".join(str(error).split())) from None
    finally:
        lammps.close()


def _run_exudyn(drop: TargetDrop) -> Floats:
    exudyn, utilities = import_module("exudyn"), import_module("exudyn.utilities")
    items, request = import_module("exudyn.itemInterface"), drop.request
    system = exudyn.SystemContainer().AddSystem()
    radius_b = PLANE_OVER_BALL * drop.radius if request.is_fixed else drop.radius

    def add_ball(mass: float, height: float, speed: float) -> Any:
        inertia = utilities.InertiaSphere(mass, drop.radius)
        place, velocity = [0, 0, height], [0, 0, -speed]
        return system.CreateRigidBody(inertia=inertia, referencePosition=place, initialVelocity=velocity)

    balls = [add_ball(request.masses[0], drop.start, request.speed)]
    if request.is_fixed:
        b = system.AddObject(items.ObjectGround(referencePosition=[0, 0, -radius_b]))
    else:
        b = add_ball(request.masses[1], -drop.radius, 0.0)
        balls.append(b)
    marker_a, marker_b = (system.AddMarker(items.MarkerBodyRigid(bodyNumber=body)) for body in (balls[0], b))
    scope = {"mbs": system, "marker_a": marker_a, "marker_b": marker_b}
    exec(drop.text, scope | {"radius_a": drop.radius, "radius_b": radius_b})
    velocity = exudyn.OutputVariableType.Velocity
    sensors = [
        system.AddSensor(items.SensorBody(bodyNumber=ball, storeInternal=True, outputVariableType=velocity))
        for ball in balls
    ]
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps = drop.n_steps
    settings.timeIntegration.endTime = drop.n_steps * request.step
    settings.timeIntegration.verboseMode = 0
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = request.step
    system.SolveDynamic(settings)
    heights = [system.GetSensorStoredData(sensor)[1:, 3] for sensor in sensors]
    return np.asarray(heights[0] - (heights[1] if len(heights) > 1 else 0.0))


def _run_pymunk(drop: TargetDrop) -> Floats:
    pymunk: Any = import_module("pymunk")
    request, radius, space = drop.request, drop.radius, import_module("pymunk").Space()
    ball = pymunk.Body(request.masses[0], math.inf)
    ball.position, ball.velocity = (0, drop.start), (0, -request.speed)
    below = space.static_body if request.is_fixed else pymunk.Body(request.masses[1], math.inf)
    a = pymunk.Circle(ball, radius)
    if request.is_fixed:
        b = pymunk.Segment(below, (-9 * radius, -radius), (9 * radius, -radius), radius)
    else:
        b = pymunk.Circle(below, radius)
        below.position = (0, -radius)
        space.add(below)
    exec(drop.text, {"a": a, "b": b})
    space.add(ball, a, b)
    return _take_steps(
        lambda: space.step(request.step), lambda: ball.velocity.y - below.velocity.y, drop.n_steps
    )


def _run_dart(drop: TargetDrop) -> Floats:
    dart: Any = import_module("dartpy")
    request, radius, world = drop.request, drop.radius, import_module("dartpy").simulation.World()
    world.setGravity([0, 0, 0])
    world.setTimeStep(request.step)
    world.getConstraintSolver().setCollisionDetector(dart.collision.DARTCollisionDetector())
    slide = dart.dynamics.PrismaticJointProperties()
    slide.mAxis = [0, 0, 1]

    def add(mass: float, height: float, speed: float) -> tuple[Any, Any]:
        skeleton = dart.dynamics.Skeleton()
        if math.isinf(mass):
            joint, body = skeleton.createWeldJointAndBodyNodePair()
            node = body.createShapeNode(dart.dynamics.BoxShape([18 * radius, 18 * radius, 2 * radius]))
            node.setRelativeTranslation([0, 0, height])
        else:
            joint, body = skeleton.createPrismaticJointAndBodyNodePair(None, slide)
            body.setMass(mass)
            node = body.createShapeNode(dart.dynamics.SphereShape(radius))
            joint.setPosition(0, height)
            joint.setVelocity(0, -speed)
        node.createCollisionAspect()
        world.addSkeleton(skeleton)
        return joint, node

    joint_a, a = add(request.masses[0], drop.start, request.speed)
    joint_b, b = add(request.masses[1], -radius, 0.0)
    exec(drop.text, {"a": a, "b": b})

    def rate() -> float:
        return joint_a.getVelocity(0) - (0.0 if request.is_fixed else joint_b.getVelocity(0))

    return _take_steps(world.step, rate, drop.n_steps)


def _run_rapier(drop: TargetDrop) -> Floats:
    rapier: Any = import_module("rapier3d")
    request, radius, world = drop.request, drop.radius, import_module("rapier3d").PhysicsWorld()
    world.gravity = (0, 0, 0)
    world.integration_parameters.dt = request.step

    def add_body(mass: float, height: float, speed: float) -> Any:
        body = rapier.RigidBodyBuilder(rapier.RigidBodyType.DYNAMIC).additional_mass(mass).can_sleep(False)
        return world.add_body(body.translation((0, 0, height)).linvel((0, 0, -speed)))

    a = rapier.Collider.ball(radius).density(0)
    if request.is_fixed:
        b = rapier.Collider.cuboid(9 * radius, 9 * radius, radius).translation((0, 0, -radius))
    else:
        b = rapier.Collider.ball(radius).density(0)
    scope = {"rapier3d": rapier, "a": a, "b": b}
    exec(drop.text, scope)
    balls = [add_body(request.masses[0], drop.start, request.speed)]
    world.add_collider(scope["a"], balls[0])
    if request.is_fixed:
        world.add_collider(scope["b"], None)
    else:
        balls.append(add_body(request.masses[1], -radius, 0.0))
        world.add_collider(scope["b"], balls[1])

    def rate() -> float:
        heights = [world.rigid_bodies[ball].linvel.z for ball in balls]
        return heights[0] - (heights[1] if len(heights) > 1 else 0.0)

    return _take_steps(world.step, rate, drop.n_steps)


def _run_sapien(drop: TargetDrop) -> Floats:
    sapien: Any = import_module("sapien")
    physx, request, radius = sapien.physx, drop.request, drop.radius
    config = physx.get_scene_config()
    threshold = config.bounce_threshold
    scope: dict[str, Any] = {"sapien": sapien}
    try:
        exec(drop.text, scope)
        system = physx.PhysxCpuSystem()
        scene = sapien.Scene([system])
        system.timestep = request.step

        def add(shape: Any, height: float, mass: float, speed: float) -> Any:
            is_fixed = math.isinf(mass)
            body = physx.PhysxRigidStaticComponent() if is_fixed else physx.PhysxRigidDynamicComponent()
            body.attach(shape)
            if not is_fixed:
                body.mass, body.disable_gravity = mass, True
                body.linear_damping = 0
            entity = sapien.Entity()
            entity.add_component(body)
            entity.pose = sapien.Pose([0, 0, height])
            scene.add_entity(entity)
            if not is_fixed:
                body.linear_velocity = [0, 0, -speed]
            return body

        def sphere() -> Any:
            return physx.PhysxCollisionShapeSphere(radius, scope["material"])

        a = add(sphere(), drop.start, request.masses[0], request.speed)
        if request.is_fixed:
            plate = physx.PhysxCollisionShapeBox([9 * radius, 9 * radius, radius], scope["material"])
            b = add(plate, -radius, math.inf, 0.0)
        else:
            b = add(sphere(), -radius, request.masses[1], 0.0)

        def rate() -> float:
            below = 0.0 if request.is_fixed else float(b.linear_velocity[2])
            return float(a.linear_velocity[2]) - below

        return _take_steps(system.step, rate, drop.n_steps)
    finally:
        config.bounce_threshold = threshold
        physx.set_scene_config(config)


#: Functions that run a text, by the name of the target. Each returns the speed of separation in m/s after every step.
RUNS: dict[str, Callable[[TargetDrop], Floats]] = {
    "mujoco": _in_pasted_drops(drop_in_mujoco),
    "pybullet": _in_pasted_drops(drop_in_pybullet),
    "drake": _run_drake,
    **dict.fromkeys(
        (
            "newton-semi-implicit",
            "newton-featherstone",
            "newton-vbd",
            "newton-mujoco",
            "newton-xpbd",
            "newton-kamino",
        ),
        _run_newton,
    ),
    **dict.fromkeys(("lammps-granular", "lammps-pull", "lammps-gran-hooke"), _run_lammps),
    **dict.fromkeys(("exudyn-linear", "exudyn-restitution"), _run_exudyn),
    "bullet": _run_bullet,
    "pymunk": _run_pymunk,
    "dart": _run_dart,
    "rapier": _run_rapier,
    "sapien": _run_sapien,
}
