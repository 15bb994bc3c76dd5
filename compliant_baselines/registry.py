"""All solvers by their names, with a description of each solver and the way to construct it.

The module of a solver is imported only when the solver is constructed. So an engine that is missing or slow to import
does not disturb a caller who does not use it. `SOLVERS` states the kind and the law of this project's solvers without
an import. Solvers of other distributions (plug-ins, docs/adding-a-solver.md) are found by their entry points. The class
of a plug-in is loaded to find out its kind and law.

A plug-in that cannot be loaded is replaced by an `Unloadable`, a solver whose outcomes all have the status
``unavailable`` and the reason. A name that no installed distribution provides, for example in a table from another
machine, is also replaced by an `Unloadable`. The registry treats it as a compliant engine that is asked for
`KELVIN_VOIGT`. If a plug-in has the name of a solver of this project, the plug-in is ignored.
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
    """Facts about a solver of this project that are known without importing its module."""

    name: str
    #: Place of the solver's class: the module below `compliant_baselines`, a colon, and the name of the class.
    factory: str
    #: Name of the exact solver of the solver's law, or None (`Solver.law`).
    law: str | None
    #: Name of the solver on pages and in figures.
    title: str
    #: Description of the solver, one line for lists.
    description: str
    #: Kind of the solver (`Solver.kind`).
    kind: Kind = "compliant"
    #: Settings that this solver always has, whatever the user sets (`Engine.fixed_settings`).
    fixed_settings: Mapping[str, object] = MappingProxyType({})


#: Names of the solvers that run if a user names none.
_DEFAULT_SOLVERS = ("state-transition", "bistiffness", KELVIN_VOIGT, "mujoco", "pybullet", "drake")

#: Time steps that users choose in practice, as fractions of the shorter contact period. MuJoCo and PyBullet have a
#: solver of their own for each of these steps.
STEPS = (0.01, 0.03, 0.1)

_MUJOCO, _PYBULLET = "engines.mujoco:Mujoco", "engines.pybullet:Pybullet"
_PYBULLET_RESTITUTION = "rigid.bullet:PybulletRestitution"

#: Settings of an engine that keeps all its defaults. Its step is fixed, so no limit dt -> 0 is computed.
_AS_IT_SHIPS: Mapping[str, object] = MappingProxyType({"mapping": "shipped", "convergence": None})


def _reference(name: str, title: str, description: str) -> SolverSpec:
    """Return the spec of an exact solver of a contact law over time; the solver has the name of its law."""
    return SolverSpec(name, "references:ReferenceSolver", name, title, description, "reference")


def _model(name: str, title: str, description: str) -> SolverSpec:
    """Return the spec of an exact solver without positions; the solver has the name of its law."""
    return SolverSpec(name, "references:StateTransitionSolver", name, title, description, "model")


def _rigid_law(name: str, description: str) -> SolverSpec:
    """Return the spec of an exact solver of a rigid impact law; the solver has the name of its law."""
    return SolverSpec(name, "rigid.law_solver:RigidLaw", name, name, description, "reference")


def _rigid_as_it_ships(name: str, factory: str, title: str, description: str) -> SolverSpec:
    """Return the spec of a rigid engine with all its defaults; only coefficients of restitution are set."""
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
    """Return the spec of an engine with a step length that users choose in practice, without a limit dt -> 0."""
    return SolverSpec(
        f"{name}:step-{step:g}",
        factory,
        KELVIN_VOIGT,
        f"{engine} (step {step:g})",
        f"{engine}, mapped, at a step of {step:g} of the shorter contact period",
        fixed_settings={"step_fraction": step, "convergence": None},
    )


#: Specs of all solvers of this project. Tables list the default solvers first, then the other solvers in this order.
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
        "sapien", "rigid.sapien:Sapien", "PhysX 5 (SAPIEN)", "at a step of 10 ms: no rebound below 2 m/s"
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
    """Return the names of all solvers that run by default, in the order of tables.

    With `on_request` the solvers that run only if a user names them follow.
    """
    plug_ins = (name for name in _entry_points() if name not in _SPECS)
    by_name_only = (name for name in _SPECS if on_request and name not in _DEFAULT_SOLVERS)
    return (*_DEFAULT_SOLVERS, *plug_ins, *by_name_only)


def exact_law_names() -> tuple[str, ...]:
    """Return the names of all models and references of this project, including those that do not run by default."""
    return tuple(name for name in solver_names(on_request=True) if is_ours(name) and not is_engine(name))


def is_ours(name: str) -> bool:
    """Return True if a solver of this project has this name."""
    return name in _SPECS


def kind_of(name: str) -> Kind:
    """Return the kind of a solver, such as ``reference`` or ``rigid``."""
    return _spec_or_plug_in(name).kind


def is_engine(name: str) -> bool:
    """Return True if a solver is an engine, with compliant or with rigid contacts."""
    return kind_of(name) in ("compliant", "rigid")


def law_name_of(name: str) -> str | None:
    """Return the name of the exact solver of a solver's law (`Solver.law`); None if there is no such exact solver."""
    return _spec_or_plug_in(name).law


def stated_law(name: str) -> str | None:
    """Return the name of a solver's law for lists that people read.

    None if it has no law or is a plug-in that fails to load.
    """
    return None if isinstance(_spec_or_plug_in(name), Unloadable) else law_name_of(name)


def has_fixed_mapping(name: str) -> bool:
    """Return True if a solver always has the same mapping of contacts to parameters, whatever the user sets."""
    return name in _SPECS and "mapping" in _SPECS[name].fixed_settings


def title_of(name: str) -> str:
    """Return the title of a solver, for pages and figures. The title of a plug-in is its registered name."""
    return _SPECS[name].title if name in _SPECS else name


def description_of(name: str) -> str:
    """Return the description of a solver in one line; for a plug-in the first line of its docstring."""
    if name in _SPECS:
        return _SPECS[name].description
    plug_in = _load_by_name(name)
    if isinstance(plug_in, Unloadable):
        return ""
    return (plug_in.__doc__ or "").strip().partition("\n")[0]


def group_by_law(names: Iterable[str]) -> dict[str, list[str]]:
    """Group solvers by the law that they obey or are asked for; the exact solver of a law comes first in its group.

    A solver without a law is a group of its own. Solvers of one group solve the same equations. So their agreement does
    not confirm them independently.
    """
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(law_name_of(name) or name, []).append(name)
    return {law: sorted(group, key=lambda name: name != law) for law, group in groups.items()}


def sort_by_law(names: Iterable[str]) -> list[str]:
    """Return solvers in an order in which solvers of the same law stand together."""
    return [name for group in group_by_law(names).values() for name in group]


def one_solver_per_law(names: Iterable[str]) -> list[str]:
    """Return one solver for each law: the exact solver if it is among the names, else the first solver of the law."""
    return [group[0] for group in group_by_law(names).values()]


def exact_solver_for(name: str, mapping: MappingName) -> str:
    """Return the name of the exact solver for the contacts that an engine was asked for; ``""`` if there is none.

    There is none for a solver without a law. There is none either if the mapping gives the engine other contacts than
    those that were asked for.
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
    """Import the class of a solver, and derive a class from it with the attributes that the spec states.

    The derived class has a constructor without arguments, as rule 1 of `solver` demands.
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
    """Return where each solver comes from: ``"impact-xval"``, or the names of the distributions that provide it."""
    origin_of = dict.fromkeys(solver_names(on_request=True), "impact-xval")
    for name, points in _entry_points().items():
        distributions = " and ".join(map(_distribution_of, points))
        if is_ours(name):
            origin_of[name] = f"impact-xval ({distributions} ignored: the name is taken)"
        else:
            origin_of[name] = distributions
    return origin_of


class Unloadable(Solver):
    """Solver in place of a plug-in that cannot be loaded or is not installed; its outcomes are ``unavailable``."""

    def __init__(self, name: str, problem: str) -> None:
        self.name, self._problem = name, problem

    def version(self) -> str:
        """Return an empty text: the version is unknown."""
        return ""

    def unavailable(self) -> str:
        """Return the reason why the plug-in cannot be loaded."""
        return self._problem

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Return for every collision an outcome ``unavailable`` with the reason."""
        return [Outcome.failure(self.name, c, "unavailable", self._problem) for c in collisions]


def _spec_or_plug_in(name: str) -> SolverSpec | Solver:
    """Return the object that states the kind and the law of a solver: its spec, or the plug-in itself."""
    return _SPECS[name] if name in _SPECS else _load_by_name(name)


def _load_by_name(name: str) -> Solver:
    """Return the plug-in of a name, or an `Unloadable` if no distribution provides the name."""
    points = _entry_points().get(name)
    return _load(name, points) if points else Unloadable(name, "")


def _entry_points() -> dict[str, list[EntryPoint]]:
    """Return the entry points of plug-ins by the names of their solvers, sorted.

    A name with more than one entry point is a mistake, which `_load` reports.
    """
    points = sorted(entry_points(group="impact_xval.solvers"), key=lambda point: (point.name, point.value))
    return {name: list(group) for name, group in groupby(points, key=lambda point: point.name)}


def _distribution_of(point: EntryPoint) -> str:
    """Return the name and the version of the distribution to which an entry point belongs."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else "an unknown distribution"


def _load(name: str, points: Sequence[EntryPoint]) -> Solver:
    """Load a plug-in, construct its solver and return it. If this fails, return an `Unloadable` with the reason."""
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
    except Exception as error:  # importing a plug-in can raise any exception
        problem = (
            f"{_distribution_of(point)} provides {name!r} as {point.value}, but {describe_exception(error)}"
        )
        return Unloadable(name, problem)
    return solver
