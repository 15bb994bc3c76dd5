"""Three bodies in a line whose two contacts are struck at once: the text to paste, and its runs in an engine.

Body A strikes body B at the speed of approach. B touches body C, which is at rest or fixed. There is no gravity. The
printed text runs unchanged, in a scene that contains only the three bodies; they meet along x.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.engines import pybullet
from impact_xval.compliant_baselines.engines.mujoco import Mujoco, take_steps
from impact_xval.compliant_baselines.engines.scene import Floats, radius_of
from impact_xval.compliant_baselines.mapping import RIGID, drake_side, mujoco_contact, pybullet_side
from impact_xval.compliant_baselines.pasted_drops import BLOCK, QUIET_STEPS, ROUNDING
from impact_xval.compliant_baselines.registry import get_solver, law_name_of
from impact_xval.compliant_baselines.single_contact import PLACES, SingleImpact, extremes_over_places
from impact_xval.compliant_baselines.solver import Settings, SolverError
from impact_xval.model.collision import Collision

#: Name of the solver that is the state-transition model.
MODEL = "state-transition"

#: The text to paste for both contacts, by engine. Some engines attach parameters to bodies, not to pairs of bodies.
#: There A and C have the parameters of their contacts with B, and B is rigid and undamped.
TEXTS = {
    "mujoco": """\
<!-- A, B and C: names of the three geoms. The numbers hold for free bodies and bodies on slides whose inverse
     weights (body_invweight0[b, 0]) have the sums {inverse1} (A and B) and {inverse2} (B and C) 1/kg.
     With the default tolerance the solver would drop forces of light bodies beside heavy ones. -->
<option timestep="{step}" integrator="Euler" solver="Newton" tolerance="0"/>
<contact>
  <pair geom1="A" geom2="B" condim="1" margin="0" gap="0"
        solref="{solref1}" solimp="{solimp}"/>
  <pair geom1="B" geom2="C" condim="1" margin="0" gap="0"
        solref="{solref2}" solimp="{solimp}"/>
</contact>
""",
    "pybullet": """\
# p: the module pybullet; a, b and c: ids of the three bodies, base links. Stiffness combines in series, damping adds.
p.setPhysicsEngineParameter(
    fixedTimeStep={step}, numSubSteps=0, contactSlop=0, useSplitImpulse=0,
    restitutionVelocityThreshold=0, solverResidualThreshold=0, contactBreakingThreshold=0.02,
)
for body, stiffness, damping in (
    (a, {side1}),
    (b, {rigid}),
    (c, {side2}),
):
    p.changeDynamics(body, -1, contactStiffness=stiffness, contactDamping=damping,
                     restitution=0, linearDamping=0, angularDamping=0, maxJointVelocity=1e30)
""",
    "drake": """\
# Proximity properties of the geometries of the three bodies, for RegisterCollisionGeometry. Stiffness
# combines in series, relaxation times add; kSap ignores a Hunt-Crossley dissipation.
properties_a, properties_b, properties_c = ProximityProperties(), ProximityProperties(), ProximityProperties()
for properties, stiffness, relaxation_time in (
    (properties_a, {side1}),
    (properties_b, {rigid}),
    (properties_c, {side2}),
):
    AddContactMaterial(properties=properties, point_stiffness=stiffness, friction=CoulombFriction(0.0, 0.0))
    properties.AddProperty("material", "relaxation_time", relaxation_time)
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step={step})
plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
plant.set_sap_near_rigid_threshold(0.0)
""",
}

#: A MuJoCo file around the pasted text. The bodies lie along x in the order C, B, A.
SCENE = """\
<mujoco>
{text}
  <worldbody>
{bodies}
  </worldbody>
</mujoco>
"""
BODY = """\
    <body pos="{x!r} 0 0"><joint type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/><geom name="{name}" size="{radius!r}"/></body>"""
FIXED_BODY = '    <geom name="{name}" size="{radius!r}" pos="{x!r} 0 0"/>'

#: Longest run, in durations of the longer contact. A run that is not over then is given up.
LONGEST_RUN = 100

#: Function that takes n more steps. It returns the velocities in m/s along x after each step, shape (n, bodies that
#: move), A first.
Advance = Callable[[int], Floats]


class Strike(NamedTuple):
    """Final velocities of runs of the printed text, over the instants of touch within a step."""

    #: Time step in s.
    step: float
    #: Least and greatest velocity in m/s of each body that moves, A first; positive is away from C.
    velocities: list[tuple[float, float]]
    #: Number of runs.
    n: int


def paste_both(engine: str, pairs: Sequence[SingleImpact], step: float) -> str:
    """Return the text to paste for both contacts of three bodies, with the time step in s.

    A SolverError says that the engine cannot take the parameters. A ValueError says that there is no text for this
    engine.
    """
    if engine not in TEXTS:
        raise ValueError(f"engine = {engine!r}; legal: {', '.join(TEXTS)}")
    contacts = [pair.contact for pair in pairs]
    numbers: dict[str, Sequence[float]] = {"step": (step,), "rigid": RIGID}
    for i, contact in enumerate(contacts, 1):
        mapped = mujoco_contact(contact)
        numbers |= {f"solref{i}": mapped.solref, "solimp": mapped.solimp, f"inverse{i}": (1 / contact.mass,)}
        numbers[f"side{i}"] = (drake_side if engine == "drake" else pybullet_side)(contact)
    between = " " if engine == "mujoco" else ", "
    texts = {
        key: between.join(repr(float(f"{value:.12g}")) for value in values) for key, values in numbers.items()
    }
    text = TEXTS[engine].format(**texts)
    if "inf" in text or "nan" in text:
        raise SolverError(engine, "unrepresentable", f"a parameter of {contacts} leaves double precision")
    return text


def collision_of_pairs(masses: Sequence[float], pairs: Sequence[SingleImpact]) -> Collision:
    """Return the collision of A with B and C as an input for solvers, in which up is the direction away from C."""
    balls = [mass for mass in masses if not math.isinf(mass)]
    return Collision(
        masses=tuple(balls),
        stiffnesses=tuple(pair.contact.k for pair in pairs),
        restitutions=tuple(pair.motion.restitution for pair in pairs),
        velocities=(-pairs[0].speed, *[0.0] * (len(balls) - 1)),
        table=len(balls) < len(masses),
    )


def solve_exactly(
    engine: str, masses: Sequence[float], pairs: Sequence[SingleImpact]
) -> dict[str, list[float] | str]:
    """Return final velocities in m/s by the model and by the exact solver of the engine's law, by the solver's name.

    If a solver has no result, the reason stands in place of the velocities.
    """
    collision = collision_of_pairs(masses, pairs)
    answers: dict[str, list[float] | str] = {}
    for name in (MODEL, law_name_of(engine)):
        if name is None:
            continue
        try:
            answers[name] = list(get_solver(name).solve(collision, Settings()).velocities)
        except SolverError as error:
            answers[name] = f"{error.status}: {error.reason}"
    return answers


def strike(
    engine: str, masses: Sequence[float], pairs: Sequence[SingleImpact], step: float, *, thorough: bool
) -> Strike:
    """Run the printed text for three bodies, and return the least and greatest final velocities.

    With `thorough`, A touches B at all `PLACES` within a step, else only just after the start of a step. A SolverError
    says how a run failed.
    """
    if engine not in STRIKES:
        raise SolverError(engine, "unavailable", "no run of three bodies by its printed text")
    text = paste_both(engine, pairs, step)
    speed, duration = pairs[0].speed, max(pair.motion.duration for pair in pairs)
    # When all three bodies collide, a contact goes deeper than it would alone. The impulse of two masses together
    # bounds the depth.
    radius = radius_of(3 * speed * max(1 / pair.contact.omega for pair in pairs))
    most = LONGEST_RUN * math.ceil(duration / step)

    def run(places: Sequence[float]) -> list[tuple[float, ...]]:
        gaps = [place * speed * step for place in places]
        return STRIKES[engine](text, masses, radius, speed, gaps, most)

    moving = range(sum(map(math.isfinite, masses)))
    results = extremes_over_places(run, moving) if thorough else run(PLACES[:1])
    velocities = [(min(values), max(values)) for values in zip(*results, strict=True)]
    return Strike(step, velocities, len(results))


def strike_in_mujoco(
    text: str, masses: Sequence[float], radius: float, speed: float, gaps: Sequence[float], most_steps: int
) -> list[tuple[float, ...]]:
    """Let A strike B and C in MuJoCo once for each gap in m, and return the final velocities in m/s of each run."""
    mujoco: Any = import_module("mujoco")
    bodies = [
        (FIXED_BODY if math.isinf(mass) else BODY).format(
            x=2 * radius * i, mass=mass, name=name, radius=radius
        )
        for i, (name, mass) in enumerate(zip("CBA", reversed(masses), strict=True))
    ]
    with TemporaryDirectory() as folder, Mujoco().running():
        path = Path(folder, "scene.xml")
        path.write_text(SCENE.format(text=text.rstrip(), bodies="\n".join(bodies)), encoding="utf-8")
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            raise SolverError("mujoco", "unrepresentable", " ".join(str(error).split())) from None
        return [_strike_once_in_mujoco(model, gap, speed, most_steps) for gap in gaps]


def _strike_once_in_mujoco(model: Any, gap: float, speed: float, most_steps: int) -> tuple[float, ...]:
    """Run a compiled scene once, with the given gap in m between A and B, and return the final velocities in m/s."""
    mujoco: Any = import_module("mujoco")
    data = mujoco.MjData(model)
    data.qpos[-1], data.qvel[-1] = gap, -speed

    def advance(n: int) -> Floats:
        try:
            velocities = take_steps(model, data, n)[1]
        except RuntimeError as error:
            raise SolverError("mujoco", "crashed", str(error)) from None
        return velocities[:, ::-1]  # the engine lists the bodies from C or B to A

    return _follow("mujoco", advance, [-speed] + [0.0] * (model.nv - 1), model.nv == 2, most_steps)


def strike_in_pybullet(
    text: str, masses: Sequence[float], radius: float, speed: float, gaps: Sequence[float], most_steps: int
) -> list[tuple[float, ...]]:
    """Let A strike B and C in PyBullet once for each gap in m, and return the final velocities in m/s of each run.

    C is a plane if it is fixed.
    """
    code = compile(text, "pasted", "exec")
    with pybullet.connected() as p:
        return [_strike_once_in_pybullet(p, code, masses, radius, speed, gap, most_steps) for gap in gaps]


def _strike_once_in_pybullet(
    p: pybullet.Client,
    code: CodeType,
    masses: Sequence[float],
    radius: float,
    speed: float,
    gap: float,
    most_steps: int,
) -> tuple[float, ...]:
    """Empty the engine's world, run the text once in it, and return the final velocities in m/s."""
    mass_a, mass_b, mass_c = masses
    fixed = math.isinf(mass_c)
    p.resetSimulation()
    sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=radius)
    if fixed:
        plane = p.createCollisionShape(p.GEOM_PLANE, planeNormal=[1, 0, 0])
        c = p.createMultiBody(0, plane, basePosition=[-radius, 0, 0])
    else:
        c = p.createMultiBody(mass_c, sphere, basePosition=[-2 * radius, 0, 0])
    b = p.createMultiBody(mass_b, sphere, basePosition=[0, 0, 0])
    a = p.createMultiBody(mass_a, sphere, basePosition=[2 * radius + gap, 0, 0])
    exec(code, {"p": p, "a": a, "b": b, "c": c})
    p.resetBaseVelocity(a, [-speed, 0, 0])
    step, read, client = p.module.stepSimulation, p.module.getBaseVelocity, p.number
    moving = (a, b) if fixed else (a, b, c)

    def advance(n: int) -> Floats:
        velocities = np.empty((n, len(moving)))
        for i in range(n):
            step(client)
            velocities[i] = [read(body, client)[0][0] for body in moving]
        return velocities

    return _follow("pybullet", advance, [-speed] + [0.0] * (len(moving) - 1), fixed, most_steps)


#: Functions that run the text to paste for three bodies, by engine.
STRIKES = {"mujoco": strike_in_mujoco, "pybullet": strike_in_pybullet}


def _follow(
    name: str, advance: Advance, start: Sequence[float], fixed: bool, most_steps: int
) -> tuple[float, ...]:
    """Take steps until the collision is over, and return the final velocities in m/s.

    The collision is over when no force has acted for `QUIET_STEPS` steps and no bodies approach.
    """
    before, last = np.array([start]), -1
    for first in range(0, most_steps, BLOCK):
        n = min(BLOCK, most_steps - first)
        velocities = advance(n)
        if not np.isfinite(velocities).all():
            raise SolverError(name, "crashed", "velocities are no longer finite")
        changes = np.abs(np.diff(velocities, axis=0, prepend=before)).max(axis=1)
        loaded = np.flatnonzero(changes > ROUNDING * -start[0])
        last = first + int(loaded[-1]) if loaded.size else last
        before = velocities[-1:]
        rates = -np.diff([*before[0], *([0.0] if fixed else [])])
        if last >= 0 and first + n - 1 - last >= QUIET_STEPS and (rates >= ROUNDING * start[0]).all():
            return tuple(before[0].tolist())
    if last < 0:
        raise SolverError(name, "unconverged", "no step with force: the bodies passed through each other")
    raise SolverError(name, "timeout", f"not over after {most_steps} steps")
