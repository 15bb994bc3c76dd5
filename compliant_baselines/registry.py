"""Where solvers are found by name, and what each of them is.

A solver's module is imported when it is first asked for, so that an engine that is missing, or slow to import, costs
nothing to a caller who does not use it. Another distribution adds a solver by an entry point in its `pyproject.toml`:

    [project.entry-points."impact_xval.solvers"]
    my-engine = "my_package.adapter:MyEngine"

One that cannot be loaded is ``unavailable``, with the reason; a name that is taken here stays what it is. Kind and law
of a solver of this project are known without importing it, those of another once its class is loaded. What cannot be
loaded, such as a solver in a table that is read where it is not installed, counts as an engine asked for
`KELVIN_VOIGT`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from impact_xval.compliant_baselines.answers import said
from impact_xval.compliant_baselines.solver import KELVIN_VOIGT, Kind, Settings, Solver
from impact_xval.model.collision import Collision, Outcome


@dataclass(frozen=True, slots=True)
class Entry:
    """A solver, as far as it can be told without importing it.

    Attributes
    ----------
    module, cls : str
        Where its class is; the module below `compliant_baselines`.
    kind, law : str
        As of `Solver`.
    on_request : bool
        Whether it runs only where it is asked for by name.
    costly : bool
        Whether a step of it costs ten times that of the other engines.
    exportable : bool
        Whether the scene it runs can be written down, to be run without this package or to be examined.
    as_set : mapping
        Settings that are its own, whatever is configured: of an engine as people use it.
    """

    module: str
    cls: str
    kind: Kind = "compliant"
    law: str | None = KELVIN_VOIGT
    on_request: bool = False
    costly: bool = False
    exportable: bool = False
    as_set: Mapping[str, Any] = field(default_factory=dict)


#: Steps of practice, over the shorter contact period, at which MuJoCo and PyBullet are solvers of their own.
STEPS = (0.01, 0.03, 0.1)

_SHIPPED = {"mapping": "shipped", "convergence": None}
_EXACT, _HUNT = "references", "hunt-crossley"
_ANCHORED, _TEXTBOOK, _LIU = "kelvin-voigt-anchored", "kelvin-voigt-textbook", "liu-zhao-brogliato"
_COMPRESSION = "compression-dashpot"
_MUJOCO, _PYBULLET, _DRAKE = (f"engines.{name}" for name in ("mujoco", "pybullet", "drake"))
_RIGID_LAWS = {
    "newton-restitution": "NewtonRestitution",
    "poisson-restitution": "PoissonRestitution",
    "sequential-top": "SequentialTop",
    "sequential-bottom": "SequentialBottom",
    "generalised-reflection": "GeneralisedReflection",
    "plastic-then-restitution": "PlasticThenRestitution",
}

#: Rigid engines, by name: module below `compliant_baselines.rigid`, and class.
_RIGID_ENGINES = {
    "pymunk": ("pymunk", "Pymunk"),
    "dart": ("dart", "Dart"),
    "rapier": ("rapier", "Rapier"),
    "pybullet-restitution": ("bullet", "PybulletRestitution"),
    "sapien": ("sapien", "Sapien"),
}

# In the order in which tables list the solvers; those on request after all others.
_ENTRIES: dict[str, Entry] = {
    "state-transition": Entry(_EXACT, "StateTransitionSolver", "model", "state-transition"),
    "bistiffness": Entry(_EXACT, "BistiffnessSolver", "reference", "bistiffness"),
    KELVIN_VOIGT: Entry(_EXACT, "KelvinVoigtSolver", "reference"),
    "mujoco": Entry(_MUJOCO, "Mujoco", exportable=True),
    "pybullet": Entry(_PYBULLET, "Pybullet", exportable=True),
    "drake": Entry(_DRAKE, "Drake", costly=True),
    _ANCHORED: Entry(_EXACT, "AnchoredKelvinVoigtSolver", "reference", _ANCHORED, on_request=True),
    _TEXTBOOK: Entry(_EXACT, "TextbookKelvinVoigtSolver", "reference", _TEXTBOOK, on_request=True),
    _COMPRESSION: Entry(_EXACT, "CompressionDashpotSolver", "reference", _COMPRESSION, on_request=True),
    _HUNT: Entry(_EXACT, "HuntCrossleySolver", "reference", _HUNT, on_request=True),
    _LIU: Entry(_EXACT, "LiuZhaoBrogliatoSolver", "model", _LIU, on_request=True),
    **{
        name: Entry("rigid.solvers", cls, "reference", name, on_request=True)
        for name, cls in _RIGID_LAWS.items()
    },
    **{
        name: Entry(f"rigid.{module}", cls, "rigid", None, on_request=True)
        for name, (module, cls) in _RIGID_ENGINES.items()
    },
    "mujoco-naive": Entry(_MUJOCO, "Mujoco", on_request=True, as_set={"mapping": "naive"}),
    "pybullet-naive": Entry(_PYBULLET, "Pybullet", on_request=True, as_set={"mapping": "naive"}),
    "mujoco:documented": Entry(_MUJOCO, "Mujoco", on_request=True, as_set={"mapping": "documented"}),
    "mujoco:default": Entry(_MUJOCO, "Mujoco", "compliant", None, on_request=True, as_set=_SHIPPED),
    "pybullet:default": Entry(
        "rigid.bullet", "PybulletRestitution", "rigid", None, on_request=True, as_set=_SHIPPED
    ),
    **{
        f"{name}:step-{step:g}": Entry(
            module, cls, on_request=True, as_set={"step_fraction": step, "convergence": None}
        )
        for name, module, cls in (("mujoco", _MUJOCO, "Mujoco"), ("pybullet", _PYBULLET, "Pybullet"))
        for step in STEPS
    },
    "drake-hunt-crossley": Entry(_DRAKE, "DrakeHuntCrossley", law=_HUNT, on_request=True),
    "newton": Entry("engines.newton", "Newton", law=_COMPRESSION, on_request=True),
}

_DESCRIPTIONS = {
    "state-transition": "the state-transition model, exact: impulses alone, positions stand still",
    "bistiffness": "the model's law in time, exact: springs of two stiffnesses, positions that move",
    KELVIN_VOIGT: "spring and dashpot that never pull, exact: what engines are mapped to",
    "mujoco": "MuJoCo, its contacts mapped to spring and dashpot",
    "pybullet": "PyBullet, its contacts mapped to spring and dashpot",
    "drake": "Drake in discrete time, its contacts mapped to spring and dashpot",
    _ANCHORED: "spring and dashpot, exact, ball on ball damped for the mass of the upper ball",
    _TEXTBOOK: "spring and dashpot, exact, damped as a contact that may pull",
    _COMPRESSION: "spring, and dashpot in compression only, exact",
    _HUNT: "Hunt and Crossley's contacts on linear springs, damping in proportion to the depth",
    _LIU: "the impact law of Liu, Zhao and Brogliato (2008) on the diagram of the model",
    "newton-restitution": "rigid, exact: Newton's restitution at all touching contacts at once",
    "poisson-restitution": "rigid, exact: compression at all contacts at once, then e times its impulses",
    "sequential-top": "rigid, exact: single impacts one after the other, the topmost first",
    "sequential-bottom": "rigid, exact: single impacts one after the other, the lowest first",
    "generalised-reflection": "rigid, exact: the generalised reflections of Smith et al. (2012), one e for all",
    "plastic-then-restitution": "rigid, exact: plastic at all contacts, then restitution of those that approached",
    "pymunk": "Pymunk (2-D): rigid contacts, iterated impulses",
    "dart": "DART: rigid contacts, one complementarity problem a step",
    "rapier": "Rapier: rigid contacts, without restitution in sub-steps, then restitution once",
    "sapien": "SAPIEN (PhysX 5): rigid contacts, by its TGS solver",
    "pybullet-restitution": "PyBullet with coefficients of restitution: sequential impulses",
    "mujoco-naive": "MuJoCo with stiffness and damping written into its solref as they are",
    "pybullet-naive": "PyBullet as documented: one stiffness and damping on both balls",
    "mujoco:documented": "MuJoCo with time constant and damping ratio of the contacts asked for, solimp as it ships",
    "mujoco:default": "MuJoCo as it ships: solref, solimp and a step of 2 ms, whatever contacts are asked for",
    "pybullet:default": "PyBullet as it ships, with coefficients of restitution, at a step of 1/240 s",
    **{
        f"{name}:step-{step:g}": f"{title}, mapped, at a step of {step:g} of the shorter contact period"
        for name, title in (("mujoco", "MuJoCo"), ("pybullet", "PyBullet"))
        for step in STEPS
    },
    "drake-hunt-crossley": "Drake in continuous time, with Hunt and Crossley's contacts",
    "newton": "Newton (Warp) by its SemiImplicit solver: springs, and dashpots in compression only",
}


def solver_names(*, on_request: bool = False) -> tuple[str, ...]:
    """Names of the known solvers, installed or not, in the order in which tables list them.

    Parameters
    ----------
    on_request : bool
        Whether to add those that are no comparison's default.
    """
    usual = (name for name, entry in _ENTRIES.items() if not entry.on_request)
    others = (name for name in _plug_ins() if name not in _ENTRIES)
    rest = (name for name, entry in _ENTRIES.items() if entry.on_request and on_request)
    return (*usual, *others, *rest)


def engine_names(*, on_request: bool = False) -> tuple[str, ...]:
    """Names of the engines that have an adapter here; with or without those that are no comparison's default."""
    ours = _ENTRIES.items()
    return tuple(name for name, entry in ours if is_engine(name) and (on_request or not entry.on_request))


def engine_free_names() -> tuple[str, ...]:
    """Names of all models and references of this project, those on request among them."""
    return tuple(name for name in _ENTRIES if not is_engine(name))


def exportable_names() -> tuple[str, ...]:
    """Names of the engines whose scene can be written down (`paste`)."""
    return tuple(name for name, entry in _ENTRIES.items() if entry.exportable)


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


def is_costly(name: str) -> bool:
    """Whether a step costs ten times that of other engines; not known, and so not, outside this project."""
    return name in _ENTRIES and _ENTRIES[name].costly


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
    """Construct a solver by its name.

    Raises
    ------
    ValueError
        If no solver has that name; the message lists those that exist.
    """
    if name in _ENTRIES:
        entry = _ENTRIES[name]
        cls = getattr(import_module(f"impact_xval.compliant_baselines.{entry.module}"), entry.cls)
        own = {"name": name, "law": entry.law, "as_set": entry.as_set}
        return type(cls.__name__, (cls,), own)() if entry.as_set else cls()
    points = _plug_ins().get(name)
    if points is None:
        raise ValueError(f"solver {name!r} is unknown; known: {', '.join(solver_names(on_request=True))}")
    return _loaded(name, points)


def origins() -> dict[str, str]:
    """Where every known solver comes from; entry points that have no effect are told apart.

    Returns
    -------
    dict
        By name: ``"impact-xval"``, or the distributions that provide it.
    """
    where = dict.fromkeys(solver_names(on_request=True), "impact-xval")
    for name, points in _plug_ins().items():
        provided = " and ".join(map(_origin, points))
        taken = name in _ENTRIES
        where[name] = f"impact-xval ({provided} ignored: the name is taken)" if taken else provided
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
    return _loaded(name, points) if points else Entry("", "")


def _plug_ins() -> dict[str, list[EntryPoint]]:
    """Entry points by the name of their solver, in the order of the names; several of one name is a mistake."""
    points: dict[str, list[EntryPoint]] = {}
    for point in sorted(
        entry_points(group="impact_xval.solvers"), key=lambda point: (point.name, point.value)
    ):
        points.setdefault(point.name, []).append(point)
    return points


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
