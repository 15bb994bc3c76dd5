"""Where solvers are found by name, and what each of them is.

A solver's module is imported when it is first asked for, so that an engine that is missing, or slow to import, costs
nothing to a caller who does not use it. Kind and law of a solver of this project are known without importing it, those
of another distribution (docs/adding-a-solver.md) once its class is loaded. One that cannot be loaded is
``unavailable``, with the reason; a name that is taken here stays what it is. What cannot be loaded, such as a solver in
a table that is read where it is not installed, counts as an engine asked for `KELVIN_VOIGT`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from itertools import groupby
from types import MappingProxyType
from typing import Any, NamedTuple

from impact_xval.compliant_baselines.answers import said
from impact_xval.compliant_baselines.solver import KELVIN_VOIGT, Kind, Settings, Solver
from impact_xval.model.collision import Collision
from impact_xval.model.outcome import Outcome


class Entry(NamedTuple):
    """A solver, as far as it can be told without importing it."""

    #: Module below `compliant_baselines` and class.
    where: str
    #: As of `Solver`.
    kind: Kind = "compliant"
    law: str | None = KELVIN_VOIGT
    #: Settings that are its own, whatever is configured: of an engine as people use it.
    as_set: Mapping[str, Any] = MappingProxyType({})


#: Solvers that run unless others are asked for by name.
_USUAL = ("state-transition", "bistiffness", KELVIN_VOIGT, "mujoco", "pybullet", "drake")

#: Steps of practice, over the shorter contact period, at which MuJoCo and PyBullet are solvers of their own.
STEPS = (0.01, 0.03, 0.1)

_MUJOCO, _PYBULLET = "engines.mujoco:Mujoco", "engines.pybullet:Pybullet"
_RIGID_BULLET = "rigid.bullet:PybulletRestitution"
_NAIVE, _SHIPPED = {"mapping": "naive"}, {"mapping": "shipped", "convergence": None}

#: Exact solvers, by class and kind: the name of each is that of its law.
_EXACT: dict[tuple[str, Kind], dict[str, str]] = {
    ("references:ReferenceSolver", "reference"): {
        "bistiffness": "the model's law in time, exact: springs of two stiffnesses, positions that move",
        KELVIN_VOIGT: "spring and dashpot that never pull, exact: what engines are mapped to",
        "kelvin-voigt-anchored": "spring and dashpot, exact, ball on ball damped for the mass of the upper ball",
        "kelvin-voigt-textbook": "spring and dashpot, exact, damped as a contact that may pull",
        "compression-dashpot": "spring, and dashpot in compression only, exact",
        "hunt-crossley": "Hunt and Crossley's contacts on linear springs, damping in proportion to the depth",
    },
    ("references:StateTransitionSolver", "model"): {
        "state-transition": "the state-transition model, exact: impulses alone, positions stand still",
        "liu-zhao-brogliato": "the impact law of Liu, Zhao and Brogliato (2008) on the diagram of the model",
    },
    ("rigid.laws:RigidLaw", "reference"): {
        "newton-restitution": "rigid, exact: Newton's restitution at all touching contacts at once",
        "poisson-restitution": "rigid, exact: compression at all contacts at once, then e times its impulses",
        "sequential-top": "rigid, exact: single impacts one after the other, the topmost first",
        "sequential-bottom": "rigid, exact: single impacts one after the other, the lowest first",
        "generalised-reflection": "rigid, exact: the generalised reflections of Smith et al. (2012), one e for all",
        "plastic-then-restitution": "rigid, exact: plastic at all contacts, then restitution of those that approached",
    },
}


#: In the order in which tables list the solvers, after the usual ones.
_ENTRIES: dict[str, Entry] = {
    **{name: Entry(where, kind, name) for (where, kind), names in _EXACT.items() for name in names},
    "mujoco": Entry(_MUJOCO),
    "pybullet": Entry(_PYBULLET),
    "drake": Entry("engines.drake:Drake"),
    "pymunk": Entry("rigid.pymunk:Pymunk", "rigid", None),
    "dart": Entry("rigid.dart:Dart", "rigid", None),
    "rapier": Entry("rigid.rapier:Rapier", "rigid", None),
    "pybullet-restitution": Entry(_RIGID_BULLET, "rigid", None),
    "sapien": Entry("rigid.sapien:Sapien", "rigid", None),
    "mujoco-naive": Entry(_MUJOCO, as_set=_NAIVE),
    "pybullet-naive": Entry(_PYBULLET, as_set=_NAIVE),
    "mujoco:documented": Entry(_MUJOCO, as_set={"mapping": "documented"}),
    "mujoco:default": Entry(_MUJOCO, law=None, as_set=_SHIPPED),
    "pybullet:default": Entry(_RIGID_BULLET, "rigid", None, _SHIPPED),
    **{
        f"{name}:step-{step:g}": Entry(where, as_set={"step_fraction": step, "convergence": None})
        for name, where in (("mujoco", _MUJOCO), ("pybullet", _PYBULLET))
        for step in STEPS
    },
    "drake-hunt-crossley": Entry("engines.drake:DrakeHuntCrossley", law="hunt-crossley"),
    "newton": Entry("engines.newton:Newton", law="compression-dashpot"),
}

_DESCRIPTIONS = {
    **{name: text for texts in _EXACT.values() for name, text in texts.items()},
    "mujoco": "MuJoCo, its contacts mapped to spring and dashpot",
    "pybullet": "PyBullet, its contacts mapped to spring and dashpot",
    "drake": "Drake in discrete time, its contacts mapped to spring and dashpot",
    "pymunk": "Pymunk (2-D): rigid contacts, iterated impulses",
    "dart": "DART: rigid contacts, one complementarity problem a step",
    "rapier": "Rapier: rigid contacts, without restitution in sub-steps, then restitution once",
    "pybullet-restitution": "PyBullet with coefficients of restitution: sequential impulses",
    "sapien": "SAPIEN (PhysX 5): rigid contacts, by its TGS solver",
    "mujoco-naive": "MuJoCo with stiffness and damping written into its solref as they are",
    "pybullet-naive": "PyBullet as documented: one stiffness and damping on both balls",
    "mujoco:documented": "MuJoCo with time constant and damping ratio of the contacts asked for, solimp as it ships",
    "mujoco:default": "MuJoCo as it ships: solref, solimp and a step of 2 ms, whatever contacts are asked for",
    "pybullet:default": "PyBullet as it ships, with coefficients of restitution, at a step of 1/240 s",
    **{
        f"{title.lower()}:step-{step:g}": f"{title}, mapped, at a step of {step:g} of the shorter contact period"
        for title in ("MuJoCo", "PyBullet")
        for step in STEPS
    },
    "drake-hunt-crossley": "Drake in continuous time, with Hunt and Crossley's contacts",
    "newton": "Newton (Warp) by its SemiImplicit solver: springs, and dashpots in compression only",
}


def solver_names(*, on_request: bool = False) -> tuple[str, ...]:
    """Names of the known solvers, in the order in which tables list them; `on_request` adds those run by name only."""
    others = (name for name in _plug_ins() if name not in _ENTRIES)
    rest = (name for name in _ENTRIES if on_request and name not in _USUAL)
    return (*_USUAL, *others, *rest)


def engine_free_names() -> tuple[str, ...]:
    """Names of all models and references of this project, those on request among them."""
    return tuple(name for name in solver_names(on_request=True) if is_ours(name) and not is_engine(name))


def is_ours(name: str) -> bool:
    """Whether a name is that of a solver of this project."""
    return name in _ENTRIES


def kind_of(name: str) -> Kind:
    """Tell the kind of a solver by its name."""
    return _known(name).kind


def is_engine(name: str) -> bool:
    """Whether a solver is an engine, of compliant or rigid contacts."""
    return kind_of(name) in ("compliant", "rigid")


def law_of(name: str) -> str | None:
    """Name of the exact solver of the law a solver has or is asked for; None if there is none."""
    return _known(name).law


def stated_law(name: str) -> str | None:
    """As `law_of`, for lists that people read: None too of one that cannot be loaded, for it has stated nothing."""
    return None if isinstance(_known(name), Unloadable) else law_of(name)


def is_mapped(name: str) -> bool:
    """Whether a solver has a mapping of its own, whatever is configured, and so not the contacts asked for."""
    return name in _ENTRIES and "mapping" in _ENTRIES[name].as_set


def description_of(name: str) -> str:
    """Say what a solver is, in a line: of another distribution's the first of its docstring."""
    solver = _known(name)
    if isinstance(solver, Entry | Unloadable):
        return _DESCRIPTIONS.get(name, "")
    return (solver.__doc__ or "").strip().partition("\n")[0]


def get_solver(name: str) -> Solver:
    """Construct a solver by its name; a ValueError that lists the known ones if no solver has it."""
    if name in _ENTRIES:
        entry = _ENTRIES[name]
        module, _, of = entry.where.partition(":")
        cls = getattr(import_module(f"impact_xval.compliant_baselines.{module}"), of)
        own = {"name": name, "law": entry.law, "as_set": entry.as_set, "__module__": cls.__module__}
        return type(of, (cls,), own)()
    points = _plug_ins().get(name)
    if points is None:
        raise ValueError(f"solver {name!r} is unknown; known: {', '.join(solver_names(on_request=True))}")
    return _loaded(name, points)


def origins() -> dict[str, str]:
    """Where every known solver comes from, by name: ``"impact-xval"``, or the distributions that provide it."""
    where = dict.fromkeys(solver_names(on_request=True), "impact-xval")
    for name, points in _plug_ins().items():
        provided = " and ".join(map(_origin, points))
        where[name] = f"impact-xval ({provided} ignored: the name is taken)" if is_ours(name) else provided
    return where


class Unloadable(Solver):
    """What stands for a solver of another distribution that cannot be loaded."""

    def __init__(self, name: str, problem: str) -> None:
        self.name, self._problem = name, problem

    def version(self) -> str:
        """No version."""
        return ""

    def unavailable(self) -> str:
        """Why it cannot be loaded."""
        return self._problem

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Answer none."""
        return [Outcome.failure(self.name, each, "unavailable", self._problem) for each in collisions]


def _known(name: str) -> Entry | Solver:
    """Find what states the kind and the law of a solver: its entry, or the solver of another distribution itself."""
    if name in _ENTRIES:
        return _ENTRIES[name]
    points = _plug_ins().get(name)
    return _loaded(name, points) if points else Unloadable(name, "")


def _plug_ins() -> dict[str, list[EntryPoint]]:
    """Entry points by the name of their solver, in the order of the names; several of one name is a mistake."""
    points = sorted(entry_points(group="impact_xval.solvers"), key=lambda point: (point.name, point.value))
    return {name: [*some] for name, some in groupby(points, key=lambda point: point.name)}


def _origin(point: EntryPoint) -> str:
    """Name and version of the distribution an entry point belongs to."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else "an unknown distribution"


def _loaded(name: str, points: Sequence[EntryPoint]) -> Solver:
    """Load and construct a solver of another distribution; one that says why not, if it cannot be."""
    if len(points) > 1:
        several = " and ".join(map(_origin, points))
        return Unloadable(name, f"{several} both provide {name!r}: uninstall one of them")
    (point,) = points
    try:
        solver = point.load()()
        if not isinstance(solver, Solver):
            raise TypeError(f"it is no {Solver.__module__}.Solver")
        if solver.name != name:
            raise TypeError(f"its name is {solver.name!r}")
    except Exception as error:  # whatever an import may do
        return Unloadable(name, f"{_origin(point)} provides {name!r} as {point.value}, but {said(error)}")
    return solver
