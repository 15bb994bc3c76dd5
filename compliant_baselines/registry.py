"""The solvers by name, with a description of each and the way to construct it.

The module of a solver is imported when the solver is constructed, so that an engine that is missing, or slow to import,
costs nothing to a caller who does not use it. `SOLVERS` states kind and law of this project's solvers without an
import. Solvers of other distributions (plug-ins, docs/adding-a-solver.md) are found by their entry points; the class of
a plug-in is loaded to learn its kind and law.

A plug-in that cannot be loaded becomes an `Unloadable`: a solver that is ``unavailable`` with the reason. A name that
no installed distribution provides becomes an `Unloadable` too; it may stand in a table that was written on another
machine. An `Unloadable` counts as a compliant engine asked for `KELVIN_VOIGT`. A plug-in cannot take the name of a
solver of this project.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from itertools import groupby
from types import MappingProxyType
from typing import NamedTuple

from impact_xval.compliant_baselines.answers import describe_exception
from impact_xval.compliant_baselines.solver import KELVIN_VOIGT, Kind, MappingName, Settings, Solver
from impact_xval.model.collision import Collision
from impact_xval.model.outcome import Outcome


class SolverSpec(NamedTuple):
    """The facts about a solver of this project that are known without importing it."""

    name: str
    #: Place of the solver's class: the module below `compliant_baselines`, a colon, the name of the class.
    factory: str
    #: The value of `Solver.law`: the exact solver of the law, by name.
    law: str | None
    #: Name of the solver on pages and in figures.
    title: str
    #: Description of the solver in one line.
    description: str
    #: The value of `Solver.kind`.
    kind: Kind = "compliant"
    #: The value of `Engine.fixed_settings`: settings that always hold for this solver.
    fixed_settings: Mapping[str, object] = MappingProxyType({})


#: Names of the solvers that run by default.
_DEFAULT_SOLVERS = ("state-transition", "bistiffness", KELVIN_VOIGT, "mujoco", "pybullet", "drake")

#: Time steps that users choose in practice, over the shorter contact period. MuJoCo and PyBullet at each of these steps
#: are separate solvers.
STEPS = (0.01, 0.03, 0.1)

_MUJOCO, _PYBULLET = "engines.mujoco:Mujoco", "engines.pybullet:Pybullet"
_PYBULLET_RESTITUTION = "rigid.bullet:PybulletRestitution"

#: Settings of an engine with its defaults, at one step.
_AS_IT_SHIPS: Mapping[str, object] = MappingProxyType({"mapping": "shipped", "convergence": None})


def _reference(name: str, title: str, description: str) -> SolverSpec:
    """Specify an exact solver of a law in time, named after its law."""
    return SolverSpec(name, "references:ReferenceSolver", name, title, description, "reference")


def _model(name: str, title: str, description: str) -> SolverSpec:
    """Specify an exact solver that has no positions, named after its law."""
    return SolverSpec(name, "references:StateTransitionSolver", name, title, description, "model")


def _rigid_law(name: str, description: str) -> SolverSpec:
    """Specify an exact rigid impact law as a solver named after the law."""
    return SolverSpec(name, "rigid.law_solver:RigidLaw", name, name, description, "reference")


def _rigid_as_it_ships(name: str, factory: str, title: str, description: str) -> SolverSpec:
    """Specify a rigid engine with its defaults; only coefficients of restitution are set."""
    return SolverSpec(
        f"{name}:default",
        factory,
        None,
        f"{title} (as it ships)",
        f"{title} as it ships, with coefficients of restitution, {description}",
        "rigid",
        fixed_settings=_AS_IT_SHIPS,
    )


def _at_step(name: str, factory: str, engine: str, step: float) -> SolverSpec:
    """Specify an engine at a step that users choose in practice, without its limit dt -> 0."""
    return SolverSpec(
        f"{name}:step-{step:g}",
        factory,
        KELVIN_VOIGT,
        f"{engine} (step {step:g})",
        f"{engine}, mapped, at a step of {step:g} of the shorter contact period",
        fixed_settings={"step_fraction": step, "convergence": None},
    )


#: All solvers of this project. Tables list the default solvers first, then the others in this order.
SOLVERS = (
    _reference(
        "bistiffness",
        "exact bistiffness",
        "the model's law in time, exact: springs of two stiffnesses, positions that move",
    ),
    _reference(
        KELVIN_VOIGT,
        "exact Kelvin-Voigt",
        "spring and dashpot that never pull, exact: what engines are mapped to",
    ),
    _reference(
        "kelvin-voigt-anchored",
        "kelvin-voigt-anchored",
        "spring and dashpot, exact, ball on ball damped for the mass of the upper ball",
    ),
    _reference(
        "kelvin-voigt-textbook",
        "kelvin-voigt-textbook",
        "spring and dashpot, exact, damped as a contact that may pull",
    ),
    _reference(
        "compression-dashpot",
        "exact dashpots of compression",
        "spring, and dashpot in compression only, exact",
    ),
    _reference(
        "linear-dashpot",
        "exact dashpots that may pull",
        "spring and dashpot while bodies overlap, exact: it may pull",
    ),
    _reference(
        "hunt-crossley",
        "exact Hunt-Crossley",
        "Hunt and Crossley's contacts on linear springs, damping in proportion to the depth",
    ),
    _model(
        "state-transition",
        "the model",
        "the state-transition model, exact: impulses alone, positions stand still",
    ),
    _model(
        "liu-zhao-brogliato",
        "Liu-Zhao-Brogliato",
        "the impact law of Liu, Zhao and Brogliato (2008) on the diagram of the model",
    ),
    _rigid_law("newton-restitution", "rigid, exact: Newton's restitution at all touching contacts at once"),
    _rigid_law(
        "poisson-restitution",
        "rigid, exact: compression at all contacts at once, then e times its impulses",
    ),
    _rigid_law("sequential-top", "rigid, exact: single impacts one after the other, the topmost first"),
    _rigid_law("sequential-bottom", "rigid, exact: single impacts one after the other, the lowest first"),
    _rigid_law(
        "generalised-reflection",
        "rigid, exact: the generalised reflections of Smith et al. (2012), one e for all",
    ),
    _rigid_law(
        "plastic-then-restitution",
        "rigid, exact: plastic at all contacts, then restitution of those that approached",
    ),
    SolverSpec(
        "mujoco", _MUJOCO, KELVIN_VOIGT, "MuJoCo", "MuJoCo, its contacts mapped to spring and dashpot"
    ),
    SolverSpec(
        "pybullet",
        _PYBULLET,
        KELVIN_VOIGT,
        "PyBullet",
        "PyBullet, its contacts mapped to spring and dashpot",
    ),
    SolverSpec(
        "drake",
        "engines.drake:Drake",
        KELVIN_VOIGT,
        "Drake",
        "Drake in discrete time, its contacts mapped to spring and dashpot",
    ),
    SolverSpec(
        "pymunk",
        "rigid.pymunk:Pymunk",
        None,
        "Pymunk",
        "Pymunk (2-D): rigid contacts, iterated impulses",
        "rigid",
    ),
    SolverSpec(
        "dart",
        "rigid.dart:Dart",
        None,
        "DART",
        "DART: rigid contacts, one complementarity problem a step",
        "rigid",
    ),
    SolverSpec(
        "rapier",
        "rigid.rapier:Rapier",
        None,
        "Rapier",
        "Rapier: rigid contacts, without restitution in sub-steps, then restitution once",
        "rigid",
    ),
    SolverSpec(
        "pybullet-restitution",
        _PYBULLET_RESTITUTION,
        None,
        "PyBullet (restitution)",
        "PyBullet with coefficients of restitution: sequential impulses",
        "rigid",
    ),
    SolverSpec(
        "sapien",
        "rigid.sapien:Sapien",
        None,
        "PhysX 5 (SAPIEN)",
        "SAPIEN (PhysX 5): rigid contacts, by its TGS solver",
        "rigid",
    ),
    SolverSpec(
        "mujoco-naive",
        _MUJOCO,
        KELVIN_VOIGT,
        "MuJoCo (naive mapping)",
        "MuJoCo with stiffness and damping written into its solref as they are",
        fixed_settings={"mapping": "naive"},
    ),
    SolverSpec(
        "pybullet-naive",
        _PYBULLET,
        KELVIN_VOIGT,
        "PyBullet (naive mapping)",
        "PyBullet as documented: one stiffness and damping on both balls",
        fixed_settings={"mapping": "naive"},
    ),
    SolverSpec(
        "mujoco:documented",
        _MUJOCO,
        KELVIN_VOIGT,
        "MuJoCo (as documented)",
        "MuJoCo with time constant and damping ratio of the contacts asked for, solimp as it ships",
        fixed_settings={"mapping": "documented"},
    ),
    SolverSpec(
        "mujoco:default",
        _MUJOCO,
        None,
        "MuJoCo (as it ships)",
        "MuJoCo as it ships: solref, solimp and a step of 2 ms, whatever contacts are asked for",
        fixed_settings=_AS_IT_SHIPS,
    ),
    _rigid_as_it_ships("pybullet", _PYBULLET_RESTITUTION, "PyBullet", "at a step of 1/240 s"),
    _rigid_as_it_ships("dart", "rigid.dart:Dart", "DART", "at a step of 1 ms"),
    _rigid_as_it_ships("rapier", "rigid.rapier:Rapier", "Rapier", "at a step of 1/60 s"),
    _rigid_as_it_ships(
        "sapien", "rigid.sapien:Sapien", "PhysX 5 (SAPIEN)", "at a step of 10 ms: none below 2 m/s"
    ),
    *(_at_step("mujoco", _MUJOCO, "MuJoCo", step) for step in STEPS),
    *(_at_step("pybullet", _PYBULLET, "PyBullet", step) for step in STEPS),
    SolverSpec(
        "drake-hunt-crossley",
        "engines.drake:DrakeHuntCrossley",
        "hunt-crossley",
        "Drake, Hunt-Crossley",
        "Drake in continuous time, with Hunt and Crossley's contacts",
    ),
    SolverSpec(
        "drake:lagged",
        "engines.drake:DrakeLagged",
        "hunt-crossley",
        "Drake (lagged)",
        "Drake in discrete time by the contacts that it ships, Hunt and Crossley's (kLagged)",
    ),
    SolverSpec(
        "drake:similar",
        "engines.drake:DrakeSimilar",
        "hunt-crossley",
        "Drake (similar)",
        "Drake in discrete time by contacts similar to Hunt and Crossley's (kSimilar)",
    ),
    SolverSpec(
        "newton",
        "engines.newton:Newton",
        "compression-dashpot",
        "Newton (SemiImplicit)",
        "Newton (Warp) by its SemiImplicit solver: springs, and dashpots in compression only",
    ),
    SolverSpec(
        "newton:featherstone",
        "engines.newton:NewtonFeatherstone",
        "compression-dashpot",
        "Newton (Featherstone)",
        "Newton (Warp) by its Featherstone solver: the contacts of `newton`, in joint coordinates",
    ),
    SolverSpec(
        "newton:xpbd",
        "rigid.newton:NewtonXpbd",
        None,
        "Newton (XPBD)",
        "Newton (Warp) by its XPBD solver: rigid contacts, moved apart and then given a rebound",
        "rigid",
    ),
    SolverSpec(
        "newton:default",
        "engines.newton:Newton",
        None,
        "Newton (as it ships)",
        "Newton's SemiImplicit solver with the stiffness and damping of its shapes, whatever contacts are asked for",
        fixed_settings=_AS_IT_SHIPS,
    ),
    SolverSpec(
        "lammps",
        "engines.lammps:Lammps",
        "linear-dashpot",
        "LAMMPS",
        "LAMMPS, granular with coeff_restitution: springs and dashpots that may pull",
    ),
    SolverSpec(
        "lammps:limit-damping",
        "engines.lammps:LammpsLimitDamping",
        "kelvin-voigt-textbook",
        "LAMMPS (limit_damping)",
        "LAMMPS, granular with coeff_restitution and limit_damping: the same dashpots, which only push",
    ),
    SolverSpec(
        "exudyn",
        "engines.exudyn:Exudyn",
        "linear-dashpot",
        "Exudyn",
        "Exudyn, spheres of impact model 0: springs and dashpots that may pull",
    ),
    SolverSpec(
        "exudyn:impact-model-1",
        "engines.exudyn:ExudynHuntCrossley",
        None,
        "Exudyn (impact model 1)",
        "Exudyn, spheres damped in proportion to the depth, after Hunt and Crossley",
    ),
    SolverSpec(
        "exudyn:impact-model-2",
        "engines.exudyn:ExudynCarvalhoMartins",
        None,
        "Exudyn (impact model 2)",
        "Exudyn, spheres damped in proportion to the depth, after Carvalho and Martins",
    ),
)

_SPECS = {spec.name: spec for spec in SOLVERS}


def solver_names(*, on_request: bool = False) -> tuple[str, ...]:
    """List the names of the solvers in the order of tables; `on_request` adds solvers that run only if named."""
    plug_ins = (name for name in _entry_points() if name not in _SPECS)
    by_name_only = (name for name in _SPECS if on_request and name not in _DEFAULT_SOLVERS)
    return (*_DEFAULT_SOLVERS, *plug_ins, *by_name_only)


def exact_law_names() -> tuple[str, ...]:
    """List the names of all models and references of this project, including those that run only if named."""
    return tuple(name for name in solver_names(on_request=True) if is_ours(name) and not is_engine(name))


def is_ours(name: str) -> bool:
    """Return True if a solver of this project has this name."""
    return name in _SPECS


def kind_of(name: str) -> Kind:
    """Return the kind of a solver."""
    return _spec_or_plug_in(name).kind


def is_engine(name: str) -> bool:
    """Return True if a solver is an engine, with compliant or rigid contacts."""
    return kind_of(name) in ("compliant", "rigid")


def law_name_of(name: str) -> str | None:
    """Return the name of the exact solver of a solver's law (`Solver.law`); None if the law has no exact solver."""
    return _spec_or_plug_in(name).law


def stated_law(name: str) -> str | None:
    """Return the law's name for lists that people read; None if there is no law, or a plug-in cannot be loaded."""
    return None if isinstance(_spec_or_plug_in(name), Unloadable) else law_name_of(name)


def has_fixed_mapping(name: str) -> bool:
    """Return True if a solver has a mapping of its own, so that it never has the contacts that are configured."""
    return name in _SPECS and "mapping" in _SPECS[name].fixed_settings


def title_of(name: str) -> str:
    """Return the name of a solver on pages and in figures; for a plug-in, its name."""
    return _SPECS[name].title if name in _SPECS else name


def description_of(name: str) -> str:
    """Return a description of a solver in one line; for a plug-in, the first line of its docstring."""
    if name in _SPECS:
        return _SPECS[name].description
    plug_in = _load_by_name(name)
    if isinstance(plug_in, Unloadable):
        return ""
    return (plug_in.__doc__ or "").strip().partition("\n")[0]


def group_by_law(names: Iterable[str]) -> dict[str, list[str]]:
    """Group solvers by the law they have or are asked for, the exact solver of the law first.

    A solver without a law is a group of its own. The solvers of one group solve the same law: their agreement is no
    independent confirmation.
    """
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(law_name_of(name) or name, []).append(name)
    return {law: sorted(group, key=lambda name: name != law) for law, group in groups.items()}


def sort_by_law(names: Iterable[str]) -> list[str]:
    """Sort solvers so that solvers of the same law stand together."""
    return [name for group in group_by_law(names).values() for name in group]


def one_solver_per_law(names: Iterable[str]) -> list[str]:
    """List one solver for each law: the exact solver, or else the first engine that was asked for the law."""
    return [group[0] for group in group_by_law(names).values()]


def exact_solver_for(name: str, mapping: MappingName) -> str:
    """Return the name of the exact solver of the contacts that a solver was asked for; ``""`` if there is none.

    A solver without a law has none. A solver whose mapping yields other contacts than those asked for has none either.
    """
    if mapping == "naive" or has_fixed_mapping(name):
        return ""
    return law_name_of(name) or ""


def get_solver(name: str) -> Solver:
    """Construct a solver by its name.

    Parameters
    ----------
    name
        One of `solver_names(on_request=True)`.

    Returns
    -------
    Solver
        The solver. For a plug-in that cannot be loaded, it is a solver with the status ``unavailable``.

    Raises
    ------
    ValueError
        If no solver has this name; the message lists the known names.

    Examples
    --------
    >>> get_solver("kelvin-voigt").kind
    'reference'
    """
    if name in _SPECS:
        return _class_of(_SPECS[name])()
    points = _entry_points().get(name)
    if points is None:
        raise ValueError(f"solver {name!r} is unknown; known: {', '.join(solver_names(on_request=True))}")
    return _load(name, points)


def _class_of(spec: SolverSpec) -> type[Solver]:
    """Import the class of a solver, and derive a class with the attributes that the spec states.

    The derived class is constructed without arguments, as rule 1 of `solver` demands of every solver.
    """
    module, _, name = spec.factory.partition(":")
    base: type[Solver] = getattr(import_module(f"impact_xval.compliant_baselines.{module}"), name)
    attributes = {
        "name": spec.name,
        "law": spec.law,
        "fixed_settings": spec.fixed_settings,
        "__doc__": base.__doc__,
        "__module__": base.__module__,
    }
    return type(name, (base,), attributes)


def origins() -> dict[str, str]:
    """Return the origin of every known solver: ``"impact-xval"``, or the distributions that provide it."""
    origin_of = dict.fromkeys(solver_names(on_request=True), "impact-xval")
    for name, points in _entry_points().items():
        distributions = " and ".join(map(_distribution_of, points))
        if is_ours(name):
            origin_of[name] = f"impact-xval ({distributions} ignored: the name is taken)"
        else:
            origin_of[name] = distributions
    return origin_of


class Unloadable(Solver):
    """Stand-in for a plug-in that cannot be loaded or is not installed."""

    def __init__(self, name: str, problem: str) -> None:
        self.name, self._problem = name, problem

    def version(self) -> str:
        """Return an empty text: the version is unknown."""
        return ""

    def unavailable(self) -> str:
        """Return the reason why the plug-in cannot be loaded."""
        return self._problem

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Return a failure with the same reason for every collision."""
        return [Outcome.failure(self.name, c, "unavailable", self._problem) for c in collisions]


def _spec_or_plug_in(name: str) -> SolverSpec | Solver:
    """Return the object that states kind and law of a solver: its spec, or the plug-in itself."""
    return _SPECS[name] if name in _SPECS else _load_by_name(name)


def _load_by_name(name: str) -> Solver:
    """Load a plug-in; `Unloadable` if no distribution provides the name."""
    points = _entry_points().get(name)
    return _load(name, points) if points else Unloadable(name, "")


def _entry_points() -> dict[str, list[EntryPoint]]:
    """Return the entry points of plug-ins by the name of their solver, sorted; two of one name are a mistake."""
    points = sorted(entry_points(group="impact_xval.solvers"), key=lambda point: (point.name, point.value))
    return {name: list(group) for name, group in groupby(points, key=lambda point: point.name)}


def _distribution_of(point: EntryPoint) -> str:
    """Return name and version of the distribution that an entry point belongs to."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else "an unknown distribution"


def _load(name: str, points: Sequence[EntryPoint]) -> Solver:
    """Load and construct a plug-in; `Unloadable` with the reason if that fails."""
    if len(points) > 1:
        distributions = " and ".join(map(_distribution_of, points))
        return Unloadable(name, f"{distributions} both provide {name!r}: uninstall one of them")
    (point,) = points
    try:
        solver = point.load()()
        if not isinstance(solver, Solver):
            raise TypeError(f"it is no {Solver.__module__}.Solver")
        if solver.name != name:
            raise TypeError(f"its name is {solver.name!r}")
    except Exception as error:  # an import can raise anything
        problem = (
            f"{_distribution_of(point)} provides {name!r} as {point.value}, but {describe_exception(error)}"
        )
        return Unloadable(name, problem)
    return solver
