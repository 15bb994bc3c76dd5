"""Text to paste for a contact, and files with which an engine runs a whole scene without this package.

The text contains the parameters of a contact, and the settings without which the engine would change these parameters;
the modules of the adapters give the reasons. For MuJoCo a scene is written as the adapter's MJCF file with the
parameters of the compiled model. For PyBullet the calls of the adapter are recorded. The script that runs a scene takes
as many steps as the adapter did, and compares its outcome with the adapter's.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike

from impact_xval.compliant_baselines.engines import mujoco, pybullet
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.engines.stepping import Run
from impact_xval.compliant_baselines.mapping import (
    RIGID,
    KelvinVoigtContact,
    MujocoContact,
    drake_side,
    mujoco_contact,
    pybullet_side,
)
from impact_xval.compliant_baselines.registry import get_solver
from impact_xval.compliant_baselines.solver import Settings, SolverError
from impact_xval.model.collision import Collision
from impact_xval.model.outcome import Outcome

#: The text to paste, by engine. Some engines attach parameters to bodies, not to pairs of bodies. There the first body
#: has the parameters of the contact, and the second body is rigid and undamped.
TEXTS = {
    "mujoco": """\
<!-- A and B: names of the two geoms. The numbers hold for free bodies and bodies on slides whose inverse weights
     (body_invweight0[b, 0]) have the sum {inverse} 1/kg. With the default tolerance the solver would drop
     forces of light bodies beside heavy ones. -->
<option timestep="{step}" integrator="Euler" solver="Newton" tolerance="0"/>
<contact>
  <pair geom1="A" geom2="B" condim="1" margin="0" gap="0"
        solref="{solref}" solimp="{solimp}"/>
</contact>
""",
    "pybullet": """\
# p: the module pybullet; a and b: ids of the two bodies, base links. Stiffness combines in series, damping adds.
p.setPhysicsEngineParameter(
    fixedTimeStep={step}, numSubSteps=0, contactSlop=0, useSplitImpulse=0,
    restitutionVelocityThreshold=0, solverResidualThreshold=0, contactBreakingThreshold=0.02,
)
for body, stiffness, damping in (
    (a, {a}),
    (b, {b}),
):
    p.changeDynamics(body, -1, contactStiffness=stiffness, contactDamping=damping,
                     restitution=0, linearDamping=0, angularDamping=0, maxJointVelocity=1e30)
""",
    "drake": """\
# Proximity properties of the geometries of the two bodies, for RegisterCollisionGeometry. Stiffness
# combines in series, relaxation times add; kSap ignores a Hunt-Crossley dissipation.
properties_a, properties_b = ProximityProperties(), ProximityProperties()
for properties, stiffness, relaxation_time in (
    (properties_a, {a}),
    (properties_b, {b}),
):
    AddContactMaterial(properties=properties, point_stiffness=stiffness, friction=CoulombFriction(0.0, 0.0))
    properties.AddProperty("material", "relaxation_time", relaxation_time)
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step={step})
plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
plant.set_sap_near_rigid_threshold(0.0)
""",
}

ENGINES = tuple(TEXTS)

#: The lines with which a script sets up and runs a scene in MuJoCo.
MUJOCO = {
    "setup": """\
model = mujoco.MjModel.from_xml_path(__file__.replace("run.py", "scene.xml"))
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, 0)""",
    "weightless": "model.opt.gravity[:] = 0",
    "advance": "mujoco.mj_step(model, data)",
    "read": "data.qvel.tolist()",
}

#: A script that runs a scene, as a format string; doubled braces become single braces.
SCRIPT = '''"""Runs the collision in {engine} alone and compares with the table: python run.py"""

import sys

import {engine}

# {balls} balls in a line, ball 1 on top; SI units, up is positive; gravity {gravity}, a step of {step}. Contacts:
{contacts}
STEPS, FLIGHT = {steps}, {flight}  # until the collision is over; until no contact is closed: no gravity from then on
TABLE = {velocities}  # what {engine} {version} gave in the table, in m/s

{setup}
for i in range(STEPS):
    if i == FLIGHT:
        {weightless}
    {advance}
for i, (v, there) in enumerate(zip({read}, TABLE), 1):
    print(f"v{{i}} = {{v!r}} m/s, in the table {{there!r}}, difference {{v - there:.1e}}")
    if abs(v - there) > 1e-12 * {speed}:
        sys.exit("not the same: another version of the engine?")
'''


def paste(engine: str, contact: KelvinVoigtContact, step: float, written: MujocoContact | None = None) -> str:
    """Return the text to paste for a contact: MJCF or Python in SI units, with the time step in s.

    `written` are a solref and a solimp that a user has written for MuJoCo. They replace the parameters that would be
    computed from the contact.

    Raises
    ------
    SolverError
        If the engine cannot take the parameters.
    ValueError
        If the engine is not one of `ENGINES`.
    """
    if engine not in ENGINES:
        raise ValueError(f"engine = {engine!r}; legal: {', '.join(ENGINES)}")
    pair, side = (
        written or mujoco_contact(contact),
        (drake_side if engine == "drake" else pybullet_side)(contact),
    )
    numbers = {"solref": pair.solref, "solimp": pair.solimp, "a": side, "b": RIGID}
    numbers |= {"step": (step,), "inverse": (1 / contact.mass,)}
    between = " " if engine == "mujoco" else ", "
    # All numbers are written as floats, because Drake treats the integer 0 and the float 0.0 differently.
    texts = {
        key: between.join(repr(float(f"{value:.12g}")) for value in values) for key, values in numbers.items()
    }
    text = TEXTS[engine].format(**texts)
    if "inf" in text or "nan" in text:
        raise SolverError(engine, "unrepresentable", f"a parameter of {contact} leaves double precision")
    return text


def export_scene(name: str, collision: Collision, settings: Settings) -> tuple[Outcome, Run, dict[str, str]]:
    """Run a collision in MuJoCo or PyBullet. Return its outcome, its run, and the files of its scene by their names.

    A SolverError says why the engine does not take the collision.
    """
    engine = get_solver(name)
    assert isinstance(engine, Engine)
    (outcome,) = engine.solve_many([collision], replace(settings, convergence=None, mark=False))
    scene = engine.scene_or_refusal(collision, settings)
    if math.isnan(outcome.v1) or not isinstance(scene, Scene):
        raise SolverError(name, outcome.status, outcome.reason)
    (run,) = engine.run([scene], settings.max_steps)
    files = {"scene.xml": mjcf_of_scenes([scene])[0]} if name == "mujoco" else {}
    script = SCRIPT.format(
        engine=name,
        version=engine.version(),
        balls=len(scene.masses),
        gravity=f"{scene.gravity!r} m/s^2",
        step=f"{scene.step!r} s",
        contacts="\n".join(
            f"# {i}: F = max(0, k d + c d'), k = {c.k!r} N/m, c = {c.c!r} N s/m"
            for i, c in enumerate(scene.contacts, 1)
        ),
        steps=run.n_steps,
        flight=run.first_flight and run.first_flight.n_steps,
        velocities=run.velocities.tolist(),
        speed=repr(scene.fastest),
        **(MUJOCO if files else _pybullet(scene)),
    )
    return outcome, run, files | {"run.py": script}


def mjcf_of_scenes(scenes: Iterable[Scene]) -> list[str]:
    """Return the MJCF of each scene, as the adapter for MuJoCo runs it; the keyframe ``start`` is the initial state."""
    engine = mujoco.Mujoco()
    with engine.running():
        return [_mjcf(scene, engine.world(scene)) for scene in scenes]


def _mjcf(scene: Scene, world: mujoco.MujocoWorld) -> str:
    """Return the MJCF of a scene, with the parameters of the model that the adapter has compiled."""
    model = world.model
    root = ElementTree.fromstring(mujoco.mjcf(scene.arrangement))

    def text_of(values: ArrayLike) -> str:
        return " ".join(repr(float(value)) for value in np.ravel(values))

    for option in root.iter("option"):
        for name in ("timestep", "tolerance", "gravity"):
            option.set(name, text_of(getattr(model.opt, name)))
    for body in root.iter("body"):
        i, geom = model.body(body.get("name")).id, body.find("geom")
        assert geom is not None
        body.set("pos", text_of(model.body_pos[i]))
        # The adapter sets masses and sizes only after the model is compiled, and leaves the inertias of the template.
        # The bodies slide and do not turn, so their inertia has no effect. This element keeps the compiler from
        # computing the inertia of a small ball, which it would refuse.
        inertial = {"pos": "0 0 0", "mass": text_of(model.body_mass[i]), "diaginertia": "1 1 1"}
        body.insert(0, ElementTree.Element("inertial", inertial))
        geom.set("size", text_of(model.geom_size[model.geom(geom.get("name")).id, 0]))
        del geom.attrib["mass"]
    for pair in root.iter("pair"):
        for field in ("solref", "solimp"):
            pair.set(field, text_of(getattr(model, f"pair_{field}")[model.pair(pair.get("name")).id]))
    texts = {"qpos": text_of(world.heights), "qvel": text_of(scene.velocities)}
    ElementTree.SubElement(ElementTree.SubElement(root, "keyframe"), "key", {"name": "start"} | texts)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _pybullet(scene: Scene) -> dict[str, str]:
    """Record the calls with which the adapter sets up a scene in PyBullet, and return them as parts of the script."""
    with pybullet.connected() as client:
        recorder = _Recorder(client.number)
        world = pybullet.PybulletWorld(recorder, scene, {})
    return {
        "setup": "\n".join(["pybullet.connect(pybullet.DIRECT)", *recorder.calls]),
        "weightless": "pybullet.setGravity(0, 0, 0)",
        "advance": "pybullet.stepSimulation()",
        "read": f"[pybullet.getBaseVelocity(ball)[0][2] for ball in {world.balls}]",
    }


class _Recorder(pybullet.Client):
    """A connection to PyBullet that records as text the calls that set up a world."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.calls: list[str] = []

    def __getattr__(self, name: str) -> Any:
        value = super().__getattr__(name)
        if type(value) is int:
            return _name_number(value, f"pybullet.{name}")
        if not name.startswith(("create", "set", "reset", "change", "step")):
            return value

        def call(*args: Any, **kwargs: Any) -> Any:
            result = value(*args, **kwargs)
            words = [*map(_literal, args), *(f"{key}={_literal(each)}" for key, each in kwargs.items())]
            inside = ", ".join(words)
            if len(inside) > 80:
                inside = "\n    " + ",\n    ".join(words) + ",\n"
            text = f"pybullet.{name}({inside})"
            if name.startswith("create"):
                kind = "body" if name == "createMultiBody" else "shape"
                number = 1 + sum(call.startswith(kind) for call in self.calls)
                result = _name_number(result, f"{kind}{number}")
                text = f"{result!r} = {text}"
            self.calls.append(text)
            return result

        return call


def _name_number(value: int, name: str) -> int:
    """Return an integer that is written into the script as a name."""

    class Named(int):
        def __repr__(self) -> str:
            return name

    return Named(value)


def _literal(value: Any) -> str:
    """Return an argument of a call as Python source. All numbers that are not integers become floats."""
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_literal, value))}]"
    return repr(value if isinstance(value, bool | int | str) else float(value))
