"""The primary solver: the state transition model of simultaneous impacts (Jia, Mason and Erdmann, IJRR 32(1), 2013).

`Collision` and `Outcome` are the vocabulary, `Collisions` and `Outcomes` many of them. `solve` answers one collision,
`solve_many` and `solve_batch` arrays of them. What solves, and the compiler it needs, is imported when it is first
used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from impact_xval.model.collision import Collision, Collisions, Outcome, Outcomes, Path
from impact_xval.model.inputs import SUPPLEMENT_CUTOFF, Cutoff

if TYPE_CHECKING:
    from impact_xval.model.solving import solve, solve_batch, solve_many

__all__ = [
    "SUPPLEMENT_CUTOFF",
    "Collision",
    "Collisions",
    "Cutoff",
    "Outcome",
    "Outcomes",
    "Path",
    "solve",
    "solve_batch",
    "solve_many",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.solving"), name)
