"""Where solvers are found by name.

A solver's module is imported when it is first asked for, so that an engine that is missing, or slow to
import, costs nothing to a caller who does not use it.
"""

from __future__ import annotations

from importlib import import_module

from compliant_baselines.contract import Solver

# name -> (module, class); in the order in which tables list the solvers
_SOLVERS: dict[str, tuple[str, str]] = {
    "state-transition": ("compliant_baselines.state_transition", "StateTransitionSolver"),
    "bistiffness": ("compliant_baselines.bistiffness", "BistiffnessSolver"),
    "kelvin-voigt": ("compliant_baselines.kelvin_voigt", "KelvinVoigtSolver"),
    "mujoco": ("compliant_baselines.mujoco_drop", "MujocoSolver"),
    "pybullet": ("compliant_baselines.pybullet_drop", "PybulletSolver"),
}

# Solvers that run only where they are asked for by name.
_ON_REQUEST: dict[str, tuple[str, str]] = {
    "kelvin-voigt-anchored": ("compliant_baselines.kelvin_voigt", "AnchoredKelvinVoigtSolver"),
    "kelvin-voigt-textbook": ("compliant_baselines.kelvin_voigt", "TextbookKelvinVoigtSolver"),
    "hunt-crossley": ("compliant_baselines.kelvin_voigt", "HuntCrossleySolver"),
    "liu-zhao-brogliato": ("compliant_baselines.state_transition", "LiuZhaoBrogliatoSolver"),
    "mujoco-naive": ("compliant_baselines.naive", "NaiveMujocoSolver"),
    "pybullet-naive": ("compliant_baselines.naive", "NaivePybulletSolver"),
    "oracle": ("compliant_baselines.oracle", "OracleSolver"),
}


def solver_names(*, on_request: bool = False) -> tuple[str, ...]:
    """Names of the known solvers, installed or not, in the order in which tables list them.

    Parameters
    ----------
    on_request : bool
        Whether to add those that are no comparison's default.
    """
    return (*_SOLVERS, *_ON_REQUEST) if on_request else tuple(_SOLVERS)


def get_solver(name: str) -> Solver:
    """Construct a solver by its name.

    Raises
    ------
    ValueError
        If no solver has that name; the message lists those that exist.
    """
    known = {**_SOLVERS, **_ON_REQUEST}
    if name not in known:
        raise ValueError(f"solver {name!r} is unknown; known: {', '.join(known)}")
    module, cls = known[name]
    return getattr(import_module(module), cls)()
