"""The state transition model of simultaneous impacts (Jia, Mason and Erdmann, IJRR 32(1), 2013).

- `Collision` is one collision, and `Outcome` is its result. `Collisions` and `Outcomes` hold many of them as arrays.
  `Path` holds velocities, impulses and forces during a collision.
- `solve` solves one collision. `solve_many` and `solve_batch` solve arrays of collisions.

The solvers, and the compiler that they need, are imported when they are first used. All other packages use this one.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from impact_xval.model.collision import Collision
from impact_xval.model.collisions import Collisions
from impact_xval.model.inputs import SUPPLEMENT_CUTOFF, Cutoff
from impact_xval.model.outcome import Outcome
from impact_xval.model.outcomes import GridOutcomes, Outcomes
from impact_xval.model.path import Path

if TYPE_CHECKING:
    from impact_xval.model.solving import solve, solve_batch, solve_many

__all__ = [
    "SUPPLEMENT_CUTOFF",
    "Collision",
    "Collisions",
    "Cutoff",
    "GridOutcomes",
    "Outcome",
    "Outcomes",
    "Path",
    "solve",
    "solve_batch",
    "solve_many",
]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.solving"), name)
