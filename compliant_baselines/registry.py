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
    "mujoco": ("compliant_baselines.mujoco_drop", "MujocoSolver"),
    "pybullet": ("compliant_baselines.pybullet_drop", "PybulletSolver"),
}


def solver_names() -> tuple[str, ...]:
    """Names of the known solvers, installed or not, in the order in which tables list them."""
    return tuple(_SOLVERS)


def get_solver(name: str) -> Solver:
    """Construct a solver by its name.

    Raises
    ------
    ValueError
        If no solver has that name; the message lists those that exist.
    """
    if name not in _SOLVERS:
        raise ValueError(f"solver {name!r} is unknown; known: {', '.join(solver_names())}")
    module, cls = _SOLVERS[name]
    return getattr(import_module(module), cls)()
