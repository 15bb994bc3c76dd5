"""Where solvers are found by name, and what each of them is.

A solver's module is imported when it is first asked for, so that an engine that is missing, or slow to
import, costs nothing to a caller who does not use it. Other distributions add solvers by entry points
(`contract.plugins`); a name that is taken here stays what it is.

What a solver is, is said here once, and known without importing it. About the solver of another distribution nothing
can be known: it counts as an engine whose contacts are meant as those of `KELVIN_VOIGT`. So does a name in the table
of a run whose solver is not installed where the table is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Literal

from impact_xval.compliant_baselines.contract import plugins
from impact_xval.compliant_baselines.contract.solver import Solver

Kind = Literal["model", "reference", "engine"]

#: The law engines are mapped to, unless an entry says otherwise.
KELVIN_VOIGT = "kelvin-voigt"


@dataclass(frozen=True, slots=True)
class Entry:
    """A solver, as far as it can be told without importing it.

    Attributes
    ----------
    module, cls : str
        Where its class is.
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
    """

    module: str
    cls: str
    kind: Kind
    law: str
    on_request: bool = False
    costly: bool = False
    exportable: bool = False
    naive: bool = False


def _model(module: str, cls: str, law: str, *, on_request: bool = False) -> Entry:
    return Entry(f"impact_xval.compliant_baselines.{module}", cls, "model", law, on_request)


def _reference(module: str, cls: str, law: str, *, on_request: bool = False) -> Entry:
    return Entry(f"impact_xval.compliant_baselines.{module}", cls, "reference", law, on_request)


def _engine(module: str, cls: str, law: str = KELVIN_VOIGT, **more: bool) -> Entry:
    return Entry(f"impact_xval.compliant_baselines.{module}", cls, "engine", law, **more)


# In the order in which tables list the solvers; those on request after all others.
_ENTRIES: dict[str, Entry] = {
    "state-transition": _model("contract.state_transition", "StateTransitionSolver", "state-transition"),
    "bistiffness": _reference("references.bistiffness", "BistiffnessSolver", "bistiffness"),
    "kelvin-voigt": _reference("references.kelvin_voigt", "KelvinVoigtSolver", KELVIN_VOIGT),
    "mujoco": _engine("engines.mujoco_drop", "MujocoSolver", exportable=True),
    "pybullet": _engine("engines.pybullet_drop", "PybulletSolver", exportable=True),
    "drake": _engine("engines.drake_drop", "DrakeSolver", costly=True),
    "kelvin-voigt-anchored": _reference(
        "references.kelvin_voigt", "AnchoredKelvinVoigtSolver", "kelvin-voigt-anchored", on_request=True
    ),
    "kelvin-voigt-textbook": _reference(
        "references.kelvin_voigt", "TextbookKelvinVoigtSolver", "kelvin-voigt-textbook", on_request=True
    ),
    "hunt-crossley": _reference(
        "references.kelvin_voigt", "HuntCrossleySolver", "hunt-crossley", on_request=True
    ),
    "liu-zhao-brogliato": _model(
        "contract.state_transition", "LiuZhaoBrogliatoSolver", "liu-zhao-brogliato", on_request=True
    ),
    "mujoco-naive": _engine("engines.naive", "NaiveMujocoSolver", on_request=True, naive=True),
    "pybullet-naive": _engine("engines.naive", "NaivePybulletSolver", on_request=True, naive=True),
    "drake-hunt-crossley": _engine(
        "engines.drake_continuous", "DrakeHuntCrossleySolver", "hunt-crossley", on_request=True
    ),
    "oracle": _model("contract.oracle", "OracleSolver", "state-transition", on_request=True),
}


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
    """Names of the engines that have an adapter here (`engines.engine`), in the order of the tables.

    Parameters
    ----------
    on_request : bool
        Whether to add those that are no comparison's default.
    """
    return tuple(
        name
        for name, entry in _ENTRIES.items()
        if entry.kind == "engine" and (on_request or not entry.on_request)
    )


def engine_free_names() -> tuple[str, ...]:
    """Names of all models and references, those on request among them."""
    return tuple(name for name, entry in _ENTRIES.items() if entry.kind != "engine")


def exportable_names() -> tuple[str, ...]:
    """Names of the engines whose scene can be written down (`calibration.scene_text`)."""
    return tuple(name for name, entry in _ENTRIES.items() if entry.exportable)


def kind_of(name: str) -> Kind:
    """Tell a model, a reference or an engine by its name; a solver that is not of this project is an engine."""
    return _ENTRIES[name].kind if name in _ENTRIES else "engine"


def law_of(name: str) -> str:
    """Name of the exact solver of the law a solver has or is asked for; `KELVIN_VOIGT` outside this project."""
    return _ENTRIES[name].law if name in _ENTRIES else KELVIN_VOIGT


def is_costly(name: str) -> bool:
    """Whether a step costs ten times that of other engines; not known, and so not, outside this project."""
    return name in _ENTRIES and _ENTRIES[name].costly


def is_naive(name: str) -> bool:
    """Whether a solver is given the naive mapping whatever is configured (`engines.naive`)."""
    return name in _ENTRIES and _ENTRIES[name].naive


def get_solver(name: str) -> Solver:
    """Construct a solver by its name.

    Raises
    ------
    ValueError
        If no solver has that name; the message lists those that exist.
    """
    if name in _ENTRIES:
        entry = _ENTRIES[name]
        return getattr(import_module(entry.module), entry.cls)()
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
