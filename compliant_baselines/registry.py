"""Where solvers are found by name.

A solver's module is imported when it is first asked for, so that an engine that is missing, or slow to
import, costs nothing to a caller who does not use it. Other distributions add solvers by entry points
(`compliant_baselines.plugins`); a name that is taken here stays what it is.
"""

from __future__ import annotations

from importlib import import_module

from compliant_baselines import plugins
from compliant_baselines.contract import Solver

# name -> (module, class); in the order in which tables list the solvers
_SOLVERS: dict[str, tuple[str, str]] = {
    "state-transition": ("compliant_baselines.state_transition", "StateTransitionSolver"),
    "bistiffness": ("compliant_baselines.bistiffness", "BistiffnessSolver"),
    "kelvin-voigt": ("compliant_baselines.kelvin_voigt", "KelvinVoigtSolver"),
    "mujoco": ("compliant_baselines.mujoco_drop", "MujocoSolver"),
    "pybullet": ("compliant_baselines.pybullet_drop", "PybulletSolver"),
    "drake": ("compliant_baselines.drake_drop", "DrakeSolver"),
}

# Solvers that run only where they are asked for by name.
_ON_REQUEST: dict[str, tuple[str, str]] = {
    "kelvin-voigt-anchored": ("compliant_baselines.kelvin_voigt", "AnchoredKelvinVoigtSolver"),
    "kelvin-voigt-textbook": ("compliant_baselines.kelvin_voigt", "TextbookKelvinVoigtSolver"),
    "hunt-crossley": ("compliant_baselines.kelvin_voigt", "HuntCrossleySolver"),
    "liu-zhao-brogliato": ("compliant_baselines.state_transition", "LiuZhaoBrogliatoSolver"),
    "mujoco-naive": ("compliant_baselines.naive", "NaiveMujocoSolver"),
    "pybullet-naive": ("compliant_baselines.naive", "NaivePybulletSolver"),
    "drake-hunt-crossley": ("compliant_baselines.drake_continuous", "DrakeHuntCrossleySolver"),
    "oracle": ("compliant_baselines.oracle", "OracleSolver"),
}


def solver_names(*, on_request: bool = False) -> tuple[str, ...]:
    """Names of the known solvers, installed or not, in the order in which tables list them.

    Parameters
    ----------
    on_request : bool
        Whether to add those that are no comparison's default.
    """
    others = tuple(name for name in plugins.found() if name not in _known())
    return (*_SOLVERS, *others, *_ON_REQUEST) if on_request else (*_SOLVERS, *others)


def get_solver(name: str) -> Solver:
    """Construct a solver by its name.

    Raises
    ------
    ValueError
        If no solver has that name; the message lists those that exist.
    """
    own = _known()
    if name in own:
        module, cls = own[name]
        return getattr(import_module(module), cls)()
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
        where[name] = f"impact-xval ({provided} ignored: the name is taken)" if name in _known() else provided
    return where


def _known() -> dict[str, tuple[str, str]]:
    return {**_SOLVERS, **_ON_REQUEST}
