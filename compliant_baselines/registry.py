"""Where solvers are found by name, and what each of them is.

A solver's module is imported when it is first asked for, so that an engine that is missing, or slow to
import, costs nothing to a caller who does not use it. Other distributions add solvers by entry points
(`plugins`); a name that is taken here stays what it is.

What a solver is, is said here once, and known without importing it. About the solver of another distribution nothing
can be known: it counts as an engine whose contacts are meant as those of `KELVIN_VOIGT`. So does a name in the table
of a run whose solver is not installed where the table is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Literal

from impact_xval.compliant_baselines import plugins
from impact_xval.compliant_baselines.solver import SolverBase

Kind = Literal["model", "reference", "engine"]

#: The law engines are mapped to, unless an entry says otherwise.
KELVIN_VOIGT = "kelvin-voigt"


@dataclass(frozen=True, slots=True)
class Entry:
    """A solver, as far as it can be told without importing it.

    Attributes
    ----------
    module, cls : str
        Where its class is; the module below `compliant_baselines`.
    kind : {"model", "reference", "engine"}
        ``model``: at the level of impulses, positions frozen. ``reference``: contacts in time, solved without an
        engine. ``engine``: an adapter of a physics engine.
    law : str
        Name of the exact solver whose contact law this one has, or is asked for: its own, for that solver.
    on_request : bool
        Whether it runs only where it is asked for by name.
    costly : bool
        Whether a step of it costs ten times that of the other engines.
    exportable : bool
        Whether the scene it runs can be written down, to be run without this package or to be examined.
    naive : bool
        Whether it is given the naive mapping whatever is configured, and so does not run what it is asked for.
    description : str
        What it is, in a line without a full stop, for the list of solvers.
    """

    module: str
    cls: str
    kind: Kind = "engine"
    law: str = KELVIN_VOIGT
    on_request: bool = False
    costly: bool = False
    exportable: bool = False
    naive: bool = False
    description: str = ""


_EXACT = "references"
_MUJOCO, _PYBULLET, _DRAKE = (f"engines.{name}" for name in ("mujoco", "pybullet", "drake"))

# In the order in which tables list the solvers; those on request after all others.
_ENTRIES: dict[str, Entry] = {
    "state-transition": Entry(
        _EXACT,
        "StateTransitionSolver",
        "model",
        "state-transition",
        description="the state-transition model, exact: impulses alone, positions stand still",
    ),
    "bistiffness": Entry(
        _EXACT,
        "BistiffnessSolver",
        "reference",
        "bistiffness",
        description="the model's law in time, exact: springs of two stiffnesses, positions that move",
    ),
    "kelvin-voigt": Entry(
        _EXACT,
        "KelvinVoigtSolver",
        "reference",
        description="spring and dashpot that never pull, exact: what engines are mapped to",
    ),
    "mujoco": Entry(
        _MUJOCO,
        "Mujoco",
        exportable=True,
        description="MuJoCo, its contacts mapped to spring and dashpot",
    ),
    "pybullet": Entry(
        _PYBULLET,
        "Pybullet",
        exportable=True,
        description="PyBullet, its contacts mapped to spring and dashpot",
    ),
    "drake": Entry(
        _DRAKE,
        "Drake",
        costly=True,
        description="Drake in discrete time, its contacts mapped to spring and dashpot",
    ),
    "kelvin-voigt-anchored": Entry(
        _EXACT,
        "AnchoredKelvinVoigtSolver",
        "reference",
        "kelvin-voigt-anchored",
        on_request=True,
        description="spring and dashpot, exact, ball on ball damped for the mass of the upper ball",
    ),
    "kelvin-voigt-textbook": Entry(
        _EXACT,
        "TextbookKelvinVoigtSolver",
        "reference",
        "kelvin-voigt-textbook",
        on_request=True,
        description="spring and dashpot, exact, damped as a contact that may pull",
    ),
    "hunt-crossley": Entry(
        _EXACT,
        "HuntCrossleySolver",
        "reference",
        "hunt-crossley",
        on_request=True,
        description="Hunt and Crossley's contacts on linear springs, damping in proportion to the depth",
    ),
    "liu-zhao-brogliato": Entry(
        _EXACT,
        "LiuZhaoBrogliatoSolver",
        "model",
        "liu-zhao-brogliato",
        on_request=True,
        description="the impact law of Liu, Zhao and Brogliato (2008) on the diagram of the model",
    ),
    "mujoco-naive": Entry(
        _MUJOCO,
        "NaiveMujoco",
        on_request=True,
        naive=True,
        description="MuJoCo with stiffness and damping written into its solref as they are",
    ),
    "pybullet-naive": Entry(
        _PYBULLET,
        "NaivePybullet",
        on_request=True,
        naive=True,
        description="PyBullet with one stiffness and damping on both balls",
    ),
    "drake-hunt-crossley": Entry(
        _DRAKE,
        "DrakeHuntCrossley",
        law="hunt-crossley",
        on_request=True,
        description="Drake in continuous time, with Hunt and Crossley's contacts",
    ),
}

#: What a name stands for that is not of this project.
_UNKNOWN = Entry("", "")


def solver_names(*, on_request: bool = False) -> tuple[str, ...]:
    """Names of the known solvers, installed or not, in the order in which tables list them.

    Parameters
    ----------
    on_request : bool
        Whether to add those that are no comparison's default.
    """
    usual = (name for name, entry in _ENTRIES.items() if not entry.on_request)
    others = (name for name in plugins.found() if name not in _ENTRIES)
    rest = (name for name, entry in _ENTRIES.items() if entry.on_request and on_request)
    return (*usual, *others, *rest)


def engine_names(*, on_request: bool = False) -> tuple[str, ...]:
    """Names of the engines that have an adapter here; with or without those that are no comparison's default."""
    engines = ((name, entry) for name, entry in _ENTRIES.items() if entry.kind == "engine")
    return tuple(name for name, entry in engines if on_request or not entry.on_request)


def engine_free_names() -> tuple[str, ...]:
    """Names of all models and references, those on request among them."""
    return tuple(name for name, entry in _ENTRIES.items() if entry.kind != "engine")


def exportable_names() -> tuple[str, ...]:
    """Names of the engines whose scene can be written down (`paste`)."""
    return tuple(name for name, entry in _ENTRIES.items() if entry.exportable)


def is_ours(name: str) -> bool:
    """Whether a name is that of a solver of this project."""
    return name in _ENTRIES


def kind_of(name: str) -> Kind:
    """Tell a model, a reference or an engine by its name; a solver that is not of this project is an engine."""
    return _ENTRIES.get(name, _UNKNOWN).kind


def law_of(name: str) -> str:
    """Name of the exact solver of the law a solver has or is asked for; `KELVIN_VOIGT` outside this project."""
    return _ENTRIES.get(name, _UNKNOWN).law


def is_costly(name: str) -> bool:
    """Whether a step costs ten times that of other engines; not known, and so not, outside this project."""
    return _ENTRIES.get(name, _UNKNOWN).costly


def is_naive(name: str) -> bool:
    """Whether a solver is given the naive mapping whatever is configured."""
    return _ENTRIES.get(name, _UNKNOWN).naive


def description_of(name: str) -> str:
    """Say what a solver is, in a line; empty outside this project."""
    return _ENTRIES.get(name, _UNKNOWN).description


def get_solver(name: str) -> SolverBase:
    """Construct a solver by its name.

    Raises
    ------
    ValueError
        If no solver has that name; the message lists those that exist.
    """
    if name in _ENTRIES:
        entry = _ENTRIES[name]
        return getattr(import_module(f"impact_xval.compliant_baselines.{entry.module}"), entry.cls)()
    points = plugins.found().get(name)
    if points is None:
        raise ValueError(f"solver {name!r} is unknown; known: {', '.join(solver_names(on_request=True))}")
    return plugins.ThirdPartySolver(name, points)


def origins() -> dict[str, str]:
    """Where every known solver comes from; entry points that have no effect are told apart.

    Returns
    -------
    dict
        By name: ``"impact-xval"``, or the distributions that provide it.
    """
    where = dict.fromkeys(solver_names(on_request=True), "impact-xval")
    for name, points in plugins.found().items():
        provided = " and ".join(map(plugins.origin, points))
        taken = name in _ENTRIES
        where[name] = f"impact-xval ({provided} ignored: the name is taken)" if taken else provided
    return where
