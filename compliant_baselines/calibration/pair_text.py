"""What to paste into a scene so that an engine has the contact asked for.

The numbers come from `contact.mapping`, as those of the adapters do; the settings beside them are what an
engine must not do to the contact on its own account (the adapters' modules say why). The first body carries the
contact, the second is rigid and undamped, wherever an engine's parameters belong to bodies and not to pairs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from impact_xval.compliant_baselines.contact.mapping import (
    Contact,
    drake_geometries,
    mujoco_contact,
    pybullet_bodies,
)
from impact_xval.compliant_baselines.contract.registry import engine_names
from impact_xval.compliant_baselines.contract.solver import SolverError

Parameters = Mapping[str, Any]


def _digits(value: float) -> str:
    """Write a number with 12 digits, as a float: Drake tells 0 from 0.0."""
    return repr(float(f"{value:.12g}"))


def _words(values: tuple[float, ...]) -> str:
    return " ".join(map(_digits, values))


def _mujoco(contact: Contact, step: float) -> tuple[Parameters, str]:
    pair = mujoco_contact(contact)
    parameters = {
        "solref": list(pair.solref),
        "solimp": list(pair.solimp),
        "condim": 1,
        "integrator": "Euler",
    }
    return (
        parameters,
        f"""\
<!-- A and B: names of the two geoms. Free bodies and slides: the numbers hold for a sum of the bodies' inverse
     weights (body_invweight0[b, 0]) of {_digits(1 / contact.mass)} 1/kg. -->
<option timestep="{_digits(step)}" integrator="Euler" solver="Newton"/>
<contact>
  <pair geom1="A" geom2="B" condim="1" margin="0" gap="0"
        solref="{_words(pair.solref)}" solimp="{_words(pair.solimp)}"/>
</contact>
""",
    )


def _pybullet(contact: Contact, step: float) -> tuple[Parameters, str]:
    a, b, _ = pybullet_bodies(contact, contact)
    parameters = {
        "a": {"contactStiffness": a.stiffness, "contactDamping": a.damping},
        "b": {"contactStiffness": b.stiffness, "contactDamping": b.damping},
    }
    rest = "restitution=0, linearDamping=0, angularDamping=0"
    return (
        parameters,
        f"""\
# p: the module pybullet; a and b: ids of the two bodies, base links. Stiffness combines in series, damping adds.
p.setPhysicsEngineParameter(
    fixedTimeStep={_digits(step)}, numSubSteps=0, contactSlop=0, useSplitImpulse=0,
    restitutionVelocityThreshold=0, solverResidualThreshold=0,
)
p.changeDynamics(a, -1, contactStiffness={_digits(a.stiffness)}, contactDamping={_digits(a.damping)}, {rest})
p.changeDynamics(b, -1, contactStiffness={_digits(b.stiffness)}, contactDamping={_digits(b.damping)}, {rest})
""",
    )


def _drake(contact: Contact, step: float) -> tuple[Parameters, str]:
    a, b, _ = drake_geometries(contact, contact)
    parameters = {
        name: {"point_contact_stiffness": body.stiffness, "relaxation_time": body.relaxation_time}
        for name, body in (("a", a), ("b", b))
    }
    lines = [
        "# Proximity properties of the geometries of the two bodies, for RegisterCollisionGeometry. Stiffness",
        "# combines in series, relaxation times add; kSap ignores a Hunt-Crossley dissipation.",
    ]
    for name, body in (("a", a), ("b", b)):
        lines += [
            f"properties_{name} = ProximityProperties()",
            f"AddContactMaterial(properties=properties_{name}, point_stiffness={_digits(body.stiffness)},",
            "                   friction=CoulombFriction(0.0, 0.0))",
            f'properties_{name}.AddProperty("material", "relaxation_time", {_digits(body.relaxation_time)})',
        ]
    lines += [
        f"plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step={_digits(step)})",
        "plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)",
        "plant.set_sap_near_rigid_threshold(0.0)",
    ]
    return parameters, "\n".join(lines) + "\n"


_TEXTS: dict[str, Callable[[Contact, float], tuple[Parameters, str]]] = {
    "mujoco": _mujoco,
    "pybullet": _pybullet,
    "drake": _drake,
}

#: Engines whose parameters are known here.
ENGINES = engine_names()


def paste(engine: str, contact: Contact, step: float) -> tuple[Parameters, str]:
    """Give an engine's parameters of a contact and the text to paste.

    Parameters
    ----------
    engine : str
        One of `ENGINES`.
    contact : Contact
        What is asked.
    step : float
        Time step in s to write into the text.

    Returns
    -------
    parameters : mapping
        Under the engine's own names, SI units.
    text : str
        Lines of MJCF or of Python.

    Raises
    ------
    SolverError
        If the engine cannot take the numbers.
    ValueError
        If no such engine is known here.
    """
    if engine not in ENGINES:
        raise ValueError(f"engine = {engine!r}; legal: {', '.join(ENGINES)}")
    parameters, text = _TEXTS[engine](contact, step)
    if "inf" in text or "nan" in text:
        raise SolverError(engine, "unrepresentable", f"a parameter of {contact} leaves double precision")
    return parameters, text
