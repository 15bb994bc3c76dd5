"""Texts that set a contact in each engine that `contact --engine` knows (docs/contacts-in-engines.md).

A target is one way to write a contact into one engine. An engine with several solvers or contact laws has several
targets, and `targets_for` returns all of them for the engine's name. Every text runs unchanged: where the engine is
installed, `target_drops` executes or loads the text in a scene that contains only two bodies.

Engines use the words stiffness k and damping c for different laws of the force F at the depth d. So the same
restitution e needs different dampings:

* **pushes**: F = max(0, k d + c d'). The contact may push but not pull; `restitution.damping_ratio` gives its damping.
* **may pull**: F = k d + c d' while the bodies overlap. Its damping ratio is zeta = -ln e/sqrt(pi^2 + ln^2 e).
* **compression**: F = k d + c max(0, d'). The dashpot acts in compression only. It needs the damping ratio that the law
  **pushes** needs for e^2.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from impact_xval.compliant_baselines.mapping import (
    MUJOCO_IMPEDANCE,
    KelvinVoigtContact,
)
from impact_xval.compliant_baselines.paste import paste
from impact_xval.compliant_baselines.restitution import (
    contact_time,
    damping_ratio,
    textbook_damping_ratio,
)
from impact_xval.compliant_baselines.solver import SolverError

#: Kind of parameters that a target takes: a stiffness and a damping ("compliant"), or a coefficient of restitution
#: ("restitution"). In an engine with a coefficient of restitution a contact is over in one step.
Kind = Literal["compliant", "restitution"]

#: The law of a contact; the module's docstring has formulas of the first three. "depth": the damping is in proportion
#: to the depth. "rigid": the engine computes no force law, and takes a coefficient of restitution.
Law = Literal["pushes", "pulls", "compression", "depth", "rigid"]

#: Comment lines that divide a text for Newton into parts. The second part runs after bodies and shapes are added, the
#: third part after the model is built.
BEFORE_FINALIZE = "# Before builder.finalize(), once bodies and shapes are added:\n"
AFTER_FINALIZE = "# After model = builder.finalize():\n"

#: Pattern of an infinity or a NaN in a text; in C++ the number may end with an f.
_NO_NUMBER = re.compile(r"(?<![a-z_])(inf|nan)f?\b")

#: PyBullet's `contactBreakingThreshold` in the text, over the distance by which the bodies approach in a step.
BREAKING_OVER_STEP = 1e-3


class ContactRequest(NamedTuple):
    """A contact between two bodies, as the input of the functions that write texts."""

    #: Spring and dashpot that have the restitution asked for if the contact may push but not pull.
    contact: KelvinVoigtContact
    #: Masses in kg. The second one is infinite if a body is fixed.
    masses: tuple[float, float]
    restitution: float
    #: Time step in s.
    step: float
    #: Speed of approach in m/s.
    speed: float = 1.0

    @classmethod
    def between(
        cls, masses: Sequence[float], e: float, k: float, step: float, speed: float = 1.0
    ) -> ContactRequest:
        """Make the request for a contact of stiffness k in N/m and restitution e; masses are in kg.

        One of the two masses may be infinite, for a fixed body.
        """
        light, heavy = sorted(masses)
        mass = light / (1 + light / heavy)
        return cls(KelvinVoigtContact.from_restitution(k, e, mass), (light, heavy), e, step, speed)

    @property
    def is_fixed(self) -> bool:
        """True if one of the bodies is fixed."""
        return math.isinf(self.masses[1])

    @property
    def pushing_damping(self) -> float:
        """Damping in N s/m that gives the restitution to a contact that may push but not pull."""
        return self.contact.c

    @property
    def pulling_damping(self) -> float:
        """Damping in N s/m that gives the restitution to a contact that may pull until its bodies part."""
        return self._damping(textbook_damping_ratio(self.restitution))

    @property
    def compression_damping(self) -> float:
        """Damping in N s/m that gives the restitution to a contact whose dashpot acts in compression only."""
        return self._damping(damping_ratio(self.restitution**2))

    def _damping(self, zeta: float) -> float:
        return 2 * zeta * math.sqrt(self.contact.k) * math.sqrt(self.contact.mass)


@dataclass(frozen=True)
class Target:
    """One way to write a contact into one engine."""

    #: The name that users type after ``--engine``.
    name: str
    #: Name of the target on pages.
    title: str
    law: Law
    #: Function that writes the text to paste for a contact.
    write: Callable[[ContactRequest], str]
    #: Phrase for pages: which parameters the engine reads.
    reads: str
    #: Phrase for pages: how the engine combines the parameters of two bodies.
    combines: str
    #: Phrase for pages: the speed below which bodies do not rebound.
    threshold: str
    #: For each parameter in the text, one line that names its documentation, or the source file in which the engine
    #: reads it.
    sources: tuple[str, ...]
    #: Sentences for pages, on other settings that change the rebound, and on parameters that the engine changes.
    notes: tuple[str, ...] = ()
    #: Largest speed of rebound in m/s at which the engine suppresses a rebound, whatever the text says.
    dropped_rebound: float = 0.0
    #: Name of the solver whose adapter runs this contact; None if there is none.
    adapter: str | None = None
    #: Python packages that must be installed to run the text; empty if the text cannot run from Python.
    distributions: tuple[str, ...] = ()

    @property
    def kind(self) -> Kind:
        """Kind of parameters that the target takes: "compliant" or "restitution"."""
        return "restitution" if self.law == "rigid" else "compliant"

    def duration(self, request: ContactRequest) -> float | None:
        """Return the exact duration in s of the contact by the target's law.

        None if the law is "depth" or "rigid".
        """
        omega, e = request.contact.omega, request.restitution
        if self.law == "pushes":
            return request.contact.duration
        if self.law == "pulls":
            zeta = textbook_damping_ratio(e)
            return math.pi / (omega * math.sqrt(1 - zeta * zeta))
        if self.law == "compression":
            # Compression lasts half as long as a contact whose dashpot acts in both directions. Expansion without a
            # dashpot lasts a quarter of a period.
            return 0.5 * (contact_time(damping_ratio(e * e)) + math.pi) / omega
        return None

    @property
    def engine(self) -> str:
        """The name of the engine, which may have several targets."""
        return self.name.partition("-")[0]

    def text(self, request: ContactRequest) -> str:
        """Return the text to paste for a contact.

        Raises
        ------
        SolverError
            If the engine cannot take the parameters.
        """
        text = self.write(request)
        if _NO_NUMBER.search(text):
            reason = f"a parameter of {request.contact} leaves double precision"
            raise SolverError(self.name, "unrepresentable", reason)
        return text


def _number(value: float) -> str:
    """Return a number as Python source of a float with 12 digits."""
    return repr(float(f"{value:.12g}"))


def _pasted(engine: str) -> Callable[[ContactRequest], str]:
    """Return the function that writes the text for an engine that `paste` knows."""
    return lambda request: paste(engine, request.contact, request.step)


def _newton(
    config: Callable[[ContactRequest], dict[str, float]], solver: str, before_finalize: str = ""
) -> Callable[[ContactRequest], str]:
    """Return the function that writes a text for one of Newton's solvers.

    `config` returns the parameters of the shapes' configuration for a contact. `solver` is Python source that makes the
    solver. `before_finalize` is Python source that runs once bodies and shapes are added.
    """

    def write(request: ContactRequest) -> str:
        numbers = config(request) | {"mu": 0.0}
        arguments = ", ".join(f"{name}={_number(value)}" for name, value in numbers.items())
        return (
            "# builder: a newton.ModelBuilder. Give this configuration to the shapes of both bodies.\n"
            f"contact = newton.ModelBuilder.ShapeConfig({arguments})\n"
            + (f"{BEFORE_FINALIZE}{before_finalize}\n" if before_finalize else "")
            + f"{AFTER_FINALIZE}solver = {solver}\n"
            f"step = {_number(request.step)}  # for solver.step\n"
        )

    return write


def _newton_compression(request: ContactRequest) -> dict[str, float]:
    return {"ke": request.contact.k, "kd": request.compression_damping, "kf": 0.0, "ka": 0.0}


def _newton_restitution(request: ContactRequest) -> dict[str, float]:
    return {"restitution": request.restitution}


def _newton_mujoco(request: ContactRequest) -> str:
    d = MUJOCO_IMPEDANCE
    return (
        "# builder: a newton.ModelBuilder, before shapes are added. Give configuration and attributes to the shapes\n"
        "# of both bodies: builder.add_shape_sphere(body, cfg=contact, custom_attributes=attributes).\n"
        "newton.solvers.SolverMuJoCo.register_custom_attributes(builder)\n"
        f"contact = newton.ModelBuilder.ShapeConfig(ke={_number(request.contact.k)}, "
        f"kd={_number(request.pushing_damping)}, kf=0.0, mu=0.0)\n"
        'attributes = {"mujoco:solref_mode": 0, "mujoco:condim": 1, '  # the mode SOLREF_MODE_FORCE_SPACE
        f'"mujoco:geom_solimp": ({d!r}, {d!r}, 0.001, 0.5, 1.0)}}\n'
        f"{AFTER_FINALIZE}"
        "solver = newton.solvers.SolverMuJoCo(model, use_mujoco_contacts=False, tolerance=0.0)\n"
        f"step = {_number(request.step)}  # for solver.step\n"
    )


def _lammps_pair(model: str, request: ContactRequest, law: str) -> str:
    """Return LAMMPS's commands for a contact model; a fixed body becomes a wall."""
    wall = f"fix contact_wall all wall/gran granular {model} zplane 0.0 NULL\n" if request.is_fixed else ""
    return (
        f"# units si, atom_style sphere, newton off. {law}\n"
        f"comm_modify vel yes\npair_style granular\npair_coeff * * {model}\n{wall}"
        f"timestep {_number(request.step)}\n"
    )


def _lammps(request: ContactRequest) -> str:
    model = (
        f"hooke {_number(request.contact.k)} {_number(request.pushing_damping)} "
        "damping velocity limit_damping tangential linear_nohistory 0.0 0.0"
    )
    return _lammps_pair(model, request, "k_n in N/m, then the damping in N s/m. The contact pushes only.")


def _lammps_pull(request: ContactRequest) -> str:
    model = (
        f"hooke {_number(request.contact.k)} {_number(request.restitution)} "
        "damping coeff_restitution tangential linear_nohistory 0.0 0.0"
    )
    law = f"k_n in N/m, then e: a damping of {_number(request.pulling_damping)} N s/m. The contact may pull."
    return _lammps_pair(model, request, law)


def _lammps_gran_hooke(request: ContactRequest) -> str:
    gamma = request.pushing_damping / request.contact.mass
    numbers = f"{_number(request.contact.k)} 0.0 {_number(gamma)} 0.0 0.0 0 limit_damping"
    pulling = _number(request.pulling_damping / request.contact.mass)
    wall = f"fix contact_wall all wall/gran hooke {numbers} zplane 0.0 NULL\n" if request.is_fixed else ""
    return (
        "# units si, atom_style sphere, newton off. K_n in N/m, K_t, gamma_n in 1/s: a damping per effective mass.\n"
        f"# Without limit_damping the contact may pull, and gamma_n is {pulling}.\n"
        f"comm_modify vel yes\npair_style gran/hooke {numbers}\npair_coeff * *\n{wall}"
        f"timestep {_number(request.step)}\n"
    )


def _liggghts_stiffness(request: ContactRequest) -> str:
    return (
        "# units si, atom_style granular, one type of atoms; kn in N/m, gamman_abs in N s/m. A wall takes the\n"
        "# same model after fix wall/gran.\n"
        "# limitForce on: the contact pushes only. With limitForce off it may pull, and gamman_abs is "
        f"{_number(request.pulling_damping)}.\n"
        "pair_style gran model hooke/stiffness tangential no_history absolute_damping on limitForce on "
        "tangential_damping off\n"
        "pair_coeff * *\n"
        f"fix c1 all property/global kn peratomtypepair 1 {_number(request.contact.k)}\n"
        "fix c2 all property/global kt peratomtypepair 1 0.0\n"
        f"fix c3 all property/global gamman_abs peratomtypepair 1 {_number(request.pushing_damping)}\n"
        "fix c4 all property/global gammat_abs peratomtypepair 1 0.0\n"
        "fix c5 all property/global coefficientFriction peratomtypepair 1 0.0\n"
        f"timestep {_number(request.step)}\n"
    )


def _liggghts_hooke(request: ContactRequest) -> str:
    # The engine's formula kn = 16/15 sqrt(R) Y* (15 M v^2/(16 sqrt(R) Y*))^(1/5), solved for Y* sqrt(R).
    k, mass, speed = request.contact.k, request.contact.mass, request.speed
    modulus = 15 / 16 * k**1.25 / (mass * speed * speed) ** 0.25
    return (
        "# units si, atom_style granular, one type of atoms. The stiffness comes out of youngsModulus: write the\n"
        "# effective radius in m, R1 R2/(R1 + R2), against a wall the ball's own.\n"
        "variable reff equal 0.01\n"
        f"variable modulus equal 2.0*{_number(modulus)}/sqrt(${{reff}})\n"
        "pair_style gran model hooke tangential no_history tangential_damping off\n"
        "pair_coeff * *\n"
        "fix c1 all property/global youngsModulus peratomtype ${modulus}\n"
        "fix c2 all property/global poissonsRatio peratomtype 0.0\n"
        f"fix c3 all property/global coefficientRestitution peratomtypepair 1 {_number(request.restitution)}\n"
        "fix c4 all property/global coefficientFriction peratomtypepair 1 0.0\n"
        f"fix c5 all property/global characteristicVelocity scalar {_number(speed)}\n"
        f"timestep {_number(request.step)}\n"
    )


def _exudyn(numbers: Callable[[ContactRequest], str]) -> Callable[[ContactRequest], str]:
    """Return the function that writes a text for Exudyn.

    `numbers` is a function that returns the arguments of the contact object as a text.
    """

    def write(request: ContactRequest) -> str:
        return (
            "# mbs: the system. marker_a, marker_b: MarkerBodyRigid at the centres of the spheres, of radius_a and\n"
            "# radius_b. A plane is a sphere with a large radius.\n"
            "from exudyn.itemInterface import NodeGenericData, ObjectContactSphereSphere\n"
            "node = mbs.AddNode(NodeGenericData(initialCoordinates=[0.1, 0, 0, 0], numberOfDataCoordinates=4))\n"
            "mbs.AddObject(ObjectContactSphereSphere(\n"
            "    markerNumbers=[marker_a, marker_b], nodeNumber=node, spheresRadii=[radius_a, radius_b],\n"
            f"    contactStiffness={_number(request.contact.k)}, {numbers(request)}))\n"
            f"step = {_number(request.step)}  # endTime/numberOfSteps of timeIntegration\n"
        )

    return write


def _exudyn_linear(request: ContactRequest) -> str:
    return f"contactDamping={_number(request.pulling_damping)}, impactModel=0"


def _exudyn_restitution(request: ContactRequest) -> str:
    return f"restitutionCoefficient={_number(request.restitution)}, contactDamping=0.0, impactModel=2"


def _physx_compliant(request: ContactRequest) -> str:
    k, c, mass = request.contact.k, request.pushing_damping, request.contact.mass
    return (
        "// The same material for the shapes of both bodies: the mean of the two stiffnesses and dampings counts.\n"
        "// A negative restitution is a stiffness in N/m; the damping is in N s/m.\n"
        f"PxMaterial* material = physics->createMaterial(0.0f, 0.0f, {_number(-k)}f);\n"
        f"material->setDamping({_number(c)}f);\n"
        "// The same contact as an acceleration per length and per speed, whatever the masses:\n"
        f"//   createMaterial(0.0f, 0.0f, {_number(-k / mass)}f), setDamping({_number(c / mass)}f),\n"
        "//   setFlag(PxMaterialFlag::eCOMPLIANT_ACCELERATION_SPRING, true).\n"
        f"// simulate({_number(request.step)}f)\n"
    )


def _physx_restitution(request: ContactRequest) -> str:
    return (
        "// The same material for the shapes of both bodies: the mean of the two restitutions counts.\n"
        f"PxMaterial* material = physics->createMaterial(0.0f, 0.0f, {_number(request.restitution)}f);\n"
        "sceneDesc.bounceThresholdVelocity = 1e-6f;  // the default is 0.2 * tolerancesScale.speed, 2 m/s\n"
        "sceneDesc.solverType = PxSolverType::eTGS;\n"
    )


def _sapien(request: ContactRequest) -> str:
    return (
        "# Before the scene is made: the default threshold is 2 m/s, for all scenes of the process.\n"
        "config = sapien.physx.get_scene_config()\n"
        "config.bounce_threshold = 0.0\n"
        "sapien.physx.set_scene_config(config)\n"
        "# For the collision shapes of both bodies: the mean of the two restitutions counts.\n"
        f"material = sapien.physx.PhysxMaterial(0.0, 0.0, {_number(request.restitution)})\n"
    )


def _bullet(request: ContactRequest) -> str:
    breaking = BREAKING_OVER_STEP * request.speed * request.step
    return (
        "# p: the module pybullet; a and b: ids of the two bodies, base links. The restitutions are multiplied.\n"
        "p.setPhysicsEngineParameter(\n"
        f"    fixedTimeStep={_number(request.step)}, numSubSteps=0, restitutionVelocityThreshold=0, contactSlop=0,\n"
        f"    erp=0, contactERP=0, useSplitImpulse=0, contactBreakingThreshold={_number(breaking)},\n"
        ")\n"
        f"for body, restitution in ((a, {_number(request.restitution)}), (b, 1.0)):\n"
        "    p.changeDynamics(body, -1, restitution=restitution, linearDamping=0, angularDamping=0,\n"
        "                     maxJointVelocity=1e30)\n"
    )


def _pymunk(request: ContactRequest) -> str:
    return (
        "# a, b: the shapes of the two bodies. The elasticities are multiplied.\n"
        f"a.elasticity, b.elasticity = {_number(request.restitution)}, 1.0\n"
    )


def _dart(request: ContactRequest) -> str:
    return (
        "# a, b: the ShapeNodes of the two bodies. The restitutions are multiplied.\n"
        f"for shape, restitution in ((a, {_number(request.restitution)}), (b, 1.0)):\n"
        "    shape.createDynamicsAspect().setRestitutionCoeff(restitution)\n"
    )


def _rapier(request: ContactRequest) -> str:
    return (
        "# a, b: the collider builders of the two bodies. The mean of the two restitutions counts. This is the\n"
        "# default rule; it is written here because a collider with another rule would win.\n"
        "a, b = (\n"
        f"    collider.restitution({_number(request.restitution)})\n"
        "    .restitution_combine_rule(rapier3d.CoefficientCombineRule.AVERAGE)\n"
        "    for collider in (a, b)\n"
        ")\n"
    )


_NO_THRESHOLD = "none"
_NEWTON = ("newton",)
_LAMMPS = ("lammps", "mpich")

_ALL = (
    Target(
        "mujoco",
        "MuJoCo",
        "pushes",
        _pasted("mujoco"),
        "`solref` = (-k/M, -c/M) of a `<pair>`, at a constant impedance",
        "one set for the pair",
        _NO_THRESHOLD,
        (
            "solref, solimp: XML reference, contact/pair; Computation, Constraint model",
            "tolerance, timestep, integrator, solver: XML reference, option",
        ),
        adapter="mujoco",
        distributions=("mujoco",),
    ),
    Target(
        "pybullet",
        "PyBullet",
        "pushes",
        _pasted("pybullet"),
        "`contactStiffness` and `contactDamping` of a body",
        "stiffness in series, damping added",
        _NO_THRESHOLD,
        (
            "contactStiffness, contactDamping: changeDynamics; btManifoldResult.cpp",
            "fixedTimeStep and thresholds: setPhysicsEngineParameter",
        ),
        adapter="pybullet",
        distributions=("pybullet",),
    ),
    Target(
        "drake",
        "Drake, kSap",
        "pushes",
        _pasted("drake"),
        "point stiffness and `relaxation_time` c/k of a geometry",
        "stiffness in series, times added",
        _NO_THRESHOLD,
        (
            "point_stiffness, relaxation_time: proximity_properties.h, AddContactMaterial",
            "time_step, sap_near_rigid_threshold: multibody_plant.h",
        ),
        adapter="drake",
        distributions=("drake",),
    ),
    Target(
        "newton-semi-implicit",
        "Newton, SemiImplicit",
        "compression",
        _newton(_newton_compression, "newton.solvers.SolverSemiImplicit(model, angular_damping=0.0)"),
        "`ke` and `kd` of a shape; kd acts in compression only; `restitution` is not read",
        "means",
        _NO_THRESHOLD,
        (
            "ke, kd: shape_material_ke, shape_material_kd in solvers/semi_implicit/kernels_contact.py",
            "the step: solver.step(..., dt)",
        ),
        (
            "Take a step of at most a hundredth of the contact's duration: the force in a step is that at its start.",
        ),
        adapter="newton",
        distributions=_NEWTON,
    ),
    Target(
        "newton-featherstone",
        "Newton, Featherstone",
        "compression",
        _newton(_newton_compression, "newton.solvers.SolverFeatherstone(model, angular_damping=0.0)"),
        "`ke` and `kd` of a shape, by the same function as SemiImplicit",
        "means",
        _NO_THRESHOLD,
        (
            "ke, kd: eval_body_contact, called in solvers/featherstone/solver_featherstone.py",
            "the step: solver.step(..., dt)",
        ),
        distributions=_NEWTON,
    ),
    Target(
        "newton-vbd",
        "Newton, VBD",
        "compression",
        _newton(_newton_compression, "newton.solvers.SolverVBD(model)", "builder.color()"),
        "`ke` and `kd` of a shape; kd acts in compression only; `restitution` is not read",
        "means",
        _NO_THRESHOLD,
        (
            "ke, kd: _average_contact_material in solvers/vbd/rigid_vbd_kernels.py; kd acts where v_dot_n < 0",
            "the step: solver.step(..., dt)",
        ),
        notes=(
            "The steps are backward Euler steps, which damp: at 200 steps in a contact e = 0.5 becomes 0.49.",
            "Without builder.color() the solver refuses a model with bodies.",
        ),
        distributions=_NEWTON,
    ),
    Target(
        "newton-mujoco",
        "Newton, MuJoCo",
        "pushes",
        _newton_mujoco,
        "`ke` and `kd` of a shape, rewritten as a positive `solref`",
        "means, weighted by `solmix`",
        _NO_THRESHOLD,
        (
            "ke, kd, solref_mode: the FORCE_SPACE branch in solvers/mujoco/kernels.py",
            "geom_solimp: register_custom_attributes in solvers/mujoco/solver_mujoco.py",
        ),
        (
            "The default is solref_mode = 2: ke and kd are read in 1/s^2 and 1/s, as k/M and c/M of one mass.",
            "With solref_mode = 2 a kd of 0 becomes solref (0.02, 1), a damped contact.",
            "With solref_mode = 0 and the default solimp, k and c hold for a body at rest. In motion a body feels only "
            "0.05 of k and c (1 - dmax). So the text writes solimp too.",
            "Newton ignores a <pair> of the scene when it makes the contacts itself (use_mujoco_contacts=False). It "
            "never reads a restitution.",
            "With solref_mode = 0 and pyramidal friction k and c are also scaled by mu^2 (1 + mu^2)/(condim - 1). So "
            "the text writes condim 1, a contact without friction.",
            "The solref is positive, so refsafe applies: a time constant below two steps becomes two steps.",
        ),
        distributions=("newton", "mujoco-warp"),
    ),
    Target(
        "newton-xpbd",
        "Newton, XPBD",
        "rigid",
        _newton(_newton_restitution, "newton.solvers.SolverXPBD(model, enable_restitution=True)"),
        "`restitution` of a shape, if `enable_restitution=True`; ke and kd are not read",
        "mean",
        "2 g dt (g: gravity, dt: step)",
        (
            "restitution, its mean and the threshold: build_restitution_manifolds in "
            "solvers/xpbd/restitution_kernels.py",
            "enable_restitution (default False): solvers/xpbd/solver_xpbd.py",
        ),
        distributions=_NEWTON,
    ),
    Target(
        "newton-kamino",
        "Newton, Kamino",
        "rigid",
        _newton(_newton_restitution, "newton.solvers.SolverKamino(model)"),
        "`restitution` of a shape; ke and kd are not read",
        "the smaller (`restitution_mix_mode`)",
        _NO_THRESHOLD,
        (
            "restitution: shape_material_restitution in solvers/kamino/_src/core/conversions.py",
            "restitution_mix_mode, default 'min': solvers/kamino/config.py",
            "constraints.gamma, default 0.01: solvers/kamino/config.py",
        ),
        ("Each step pushes an overlap apart at 0.01 of its depth. So e is up to 0.01 larger than written.",),
        distributions=_NEWTON,
    ),
    Target(
        "lammps-granular",
        "LAMMPS, pair_style granular",
        "pushes",
        _lammps,
        "k_n in N/m and a damping in N s/m (`damping velocity`); pushes only with `limit_damping`",
        "one set for a pair of types",
        _NO_THRESHOLD,
        (
            "k_n, damping: pair_granular.rst; gran_sub_mod_damping.cpp, GranSubModDampingVelocity",
            "limit_damping: pair_granular.rst",
            "the wall: fix_wall_gran.rst",
            "timestep: timestep.rst",
        ),
        (
            "`damping mass_velocity` reads a damping per effective mass, c/M. The default damping is viscoelastic, "
            "another law.",
            "The effective mass is that of the pair; against a wall it is the particle's mass.",
            "With `damping coeff_restitution` and `limit_damping` together a body rebounds faster than asked: 0.550 "
            "for e = 0.5, 0.808 for e = 0.8.",
        ),
        distributions=_LAMMPS,
    ),
    Target(
        "lammps-pull",
        "LAMMPS, coeff_restitution",
        "pulls",
        _lammps_pull,
        "k_n in N/m and e; the contact may pull",
        "one set for a pair of types",
        _NO_THRESHOLD,
        (
            "k_n: pair_granular.rst",
            "e: gran_sub_mod_damping.cpp, GranSubModDampingCoeffRestitution: c = -2 ln e sqrt(k M)/sqrt(pi^2 + ln^2 e)",
            "the wall: fix_wall_gran.rst",
            "timestep: timestep.rst",
        ),
        ("Where three bodies touch at once, a contact that may pull gives them other velocities.",),
        distributions=_LAMMPS,
    ),
    Target(
        "lammps-gran-hooke",
        "LAMMPS, pair_style gran/hooke",
        "pushes",
        _lammps_gran_hooke,
        "K_n in N/m and gamma_n = c/M in 1/s; pushes only with `limit_damping`",
        "one set for all types",
        _NO_THRESHOLD,
        (
            "K_n, gamma_n, limit_damping: pair_gran.rst",
            "the wall: fix_wall_gran.rst",
            "timestep: timestep.rst",
        ),
        (
            "K_n and gamma_n give another restitution to another effective mass M: zeta = gamma_n sqrt(M/K_n)/2.",
        ),
        distributions=_LAMMPS,
    ),
    Target(
        "liggghts-stiffness",
        "LIGGGHTS, hooke/stiffness",
        "pushes",
        _liggghts_stiffness,
        "kn in N/m and gamman_abs in N s/m; pushes only with `limitForce on`",
        "one set for a pair of types",
        _NO_THRESHOLD,
        (
            "kn, gamman_abs, absolute_damping, limitForce: gran_model_hooke_stiffness.html; "
            "normal_model_hooke_stiffness.h",
            "timestep: as in LAMMPS",
        ),
        ("With `absolute_damping off`, the default, gamman is per effective mass, c/M in 1/s.",),
    ),
    Target(
        "liggghts-hooke",
        "LIGGGHTS, hooke",
        "pulls",
        _liggghts_hooke,
        "`coefficientRestitution`, and a stiffness made of `youngsModulus` and `characteristicVelocity`; may pull",
        "one e for a pair of types, moduli in series",
        _NO_THRESHOLD,
        (
            "kn and gamman: normal_model_hooke.h, kn = 16/15 sqrt(R) Y* (15 M v^2/(16 sqrt(R) Y*))^(1/5)",
            "legal ranges: global_properties.cpp",
        ),
        (
            "With `limitForce on` the contact pushes only, and a body rebounds faster than asked: by the exact law "
            "0.550 for e = 0.5, 0.808 for e = 0.8.",
            "The legal ranges are 0.05 < e <= 1, youngsModulus >= 5e6 Pa and characteristicVelocity >= 0.01 m/s, in SI "
            "units.",
        ),
    ),
    Target(
        "exudyn-linear",
        "Exudyn, impactModel 0",
        "pulls",
        _exudyn(_exudyn_linear),
        "`contactStiffness` and `contactDamping` of a contact object; may pull",
        "one set for the object",
        _NO_THRESHOLD,
        (
            "contactStiffness, contactDamping, impactModel: ObjectContactSphereSphere.rst",
            "step: SimulationSettings, timeIntegration",
        ),
        ("`restitutionCoefficient` is not read by impactModel 0.",),
        distributions=("exudyn",),
    ),
    Target(
        "exudyn-restitution",
        "Exudyn, impactModel 2",
        "depth",
        _exudyn(_exudyn_restitution),
        "`contactStiffness` and `restitutionCoefficient` of a contact object; damping in proportion to the depth",
        "one set for the object",
        "below `minimumImpactVelocity` (default 0) e is smaller",
        (
            "contactStiffness, restitutionCoefficient, impactModel: ObjectContactSphereSphere.rst",
            "step: SimulationSettings, timeIntegration",
        ),
        (
            "impactModel 1 is Hunt and Crossley's first term: it gives 0.663 for 0.5 and 0.833 for 0.8.",
            "A contactDamping is added to it and lowers the rebound.",
        ),
        distributions=("exudyn",),
    ),
    Target(
        "physx-compliant",
        "PhysX, compliant contact",
        "pushes",
        _physx_compliant,
        "a stiffness as a negative restitution, and `setDamping`",
        "mean; beside a rigid material by the version",
        _NO_THRESHOLD,
        (
            "restitution < 0, damping, eCOMPLIANT_ACCELERATION_SPRING: physx/include/PxMaterial.h",
            "combination: PxCombineMode in the same file",
        ),
        (
            "The damping is that of a contact that pushes only; the sources do not say whether this one may pull.",
            "In USD (Isaac Sim): physxMaterial:compliantContactStiffness, compliantContactDamping, "
            "compliantContactAccelerationSpring of PhysxMaterialAPI.",
            "If one body has a force spring and the other one an acceleration spring, the acceleration spring decides "
            "alone.",
            "Write the material on both bodies: beside a rigid material (restitution 0) half of the stiffness acted in "
            "SAPIEN 3.0.3, and newer headers say that all of it acts.",
            "SAPIEN has no setter for the damping, so its compliant contacts are elastic: e = 0.998 at 300 steps in a "
            "contact. The duration is that of k in N/m.",
        ),
    ),
    Target(
        "physx-restitution",
        "PhysX, restitution",
        "rigid",
        _physx_restitution,
        "restitution of a material",
        "mean (`setRestitutionCombineMode`)",
        "2 m/s as shipped (`bounceThresholdVelocity`)",
        (
            "restitution, combination: physx/include/PxMaterial.h",
            "bounceThresholdVelocity: physx/include/PxSceneDesc.h",
        ),
        ("SAPIEN runs this engine; see sapien.",),
    ),
    Target(
        "sapien",
        "SAPIEN (PhysX 5)",
        "rigid",
        _sapien,
        "restitution of a material",
        "mean",
        "2 m/s as shipped (`bounce_threshold`)",
        (
            "restitution: PhysxMaterial; physx/include/PxMaterial.h",
            "bounce_threshold: sapien.physx.set_scene_config",
        ),
        adapter="sapien",
        distributions=("sapien",),
    ),
    Target(
        "bullet",
        "PyBullet, restitution",
        "rigid",
        _bullet,
        "`restitution` of a body (`m_restitution` in C++)",
        "product",
        "0.2 m/s as shipped (`restitutionVelocityThreshold`)",
        (
            "restitution: changeDynamics; the product: btManifoldResult.cpp, calculateCombinedRestitution",
            "the other settings: setPhysicsEngineParameter; btContactSolverInfo.h",
        ),
        (
            "A ball has a contact with a plane or a box already at a gap of contactBreakingThreshold (0.02 m).",
            "As shipped this slows the rebound by the gap over the step: e = 0.8 gives 0 to 0.78, by where in a step "
            "the ball touches. So the text makes the gap a thousandth of the way in a step.",
            "As shipped the overlap of two balls is pushed out: e = 0.8 gives 0.80 to 0.88. erp=0 and contactERP=0 "
            "switch this off. Bodies at rest then stay as deep as they are.",
        ),
        adapter="pybullet-restitution",
        distributions=("pybullet",),
    ),
    Target(
        "pymunk",
        "Pymunk (2-D)",
        "rigid",
        _pymunk,
        "`elasticity` of a shape",
        "product",
        _NO_THRESHOLD,
        ("elasticity: pymunk.Shape; cpArbiter.c, arb->e = a->e * b->e",),
        adapter="pymunk",
        distributions=("pymunk",),
    ),
    Target(
        "dart",
        "DART",
        "rigid",
        _dart,
        "`RestitutionCoeff` of a shape's dynamics aspect",
        "product",
        "rebounds of 0.1 m/s or less (fixed)",
        (
            "RestitutionCoeff, the product, DART_BOUNCING_VELOCITY_THRESHOLD 0.1, DART_MAX_BOUNCING_VELOCITY 100: "
            "dart/constraint/ContactConstraint.cpp",
        ),
        (
            "The threshold holds for the speed of rebound: with e = 0.8 an approach of up to 0.125 m/s gives none.",
            "No rebound is faster than 100 m/s.",
        ),
        dropped_rebound=0.1,
        adapter="dart",
        distributions=("dartpy",),
    ),
    Target(
        "rapier",
        "Rapier",
        "rigid",
        _rapier,
        "`restitution` of a collider",
        "mean, unless a body has another `CoefficientCombineRule`: the later of average, min, multiply, max decides",
        _NO_THRESHOLD,
        (
            "restitution, restitution_combine_rule: ColliderBuilder",
            "the rules: src/dynamics/coefficient_combine_rule.rs",
        ),
        (
            "An e below 1 acts in the first step of a contact only (is_bouncy in contact_pair.rs).",
            "Bodies are capped at 400 length_unit a second.",
        ),
        adapter="rapier",
        distributions=("rapier3d",),
    ),
)

#: All targets by their names.
TARGETS: dict[str, Target] = {target.name: target for target in _ALL}


def target_names() -> tuple[str, ...]:
    """Return the names that are legal after ``--engine``: all engines, then targets that share an engine."""
    engines = dict.fromkeys(target.engine for target in _ALL)
    return (*engines, *(name for name in TARGETS if name not in engines))


def targets_for(name: str) -> tuple[Target, ...]:
    """Return the target of this name, or all targets of the engine of this name.

    Raises
    ------
    ValueError
        If no target or engine has this name; the message lists the names.
    """
    if name in TARGETS:
        return (TARGETS[name],)
    targets = tuple(target for target in _ALL if target.engine == name)
    if not targets:
        raise ValueError(f"engine = {name!r}; legal: {', '.join(target_names())}")
    return targets
