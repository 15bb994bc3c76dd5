"""The primary solver: the state transition model of simultaneous impacts (Jia, Mason and Erdmann, IJRR 32(1), 2013).

`Collision` and `Outcome` are the vocabulary; `solve` answers one collision, `solve_batch` arrays of them. `Column`,
`solve_column` and `solve_columns` are the same for N balls. What solves, and the compiler it needs, is imported when
it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from impact_xval.model.collision import (
    Collision,
    Event,
    ImpulseCurve,
    Outcome,
)
from impact_xval.model.columns.column import Column, ColumnOutcome, ColumnPath
from impact_xval.model.inputs import SUPPLEMENT_CUTOFF, Cutoff

if TYPE_CHECKING:
    from impact_xval.model.columns.solving import solve_column, solve_columns
    from impact_xval.model.solving import BatchOutcome, solve, solve_batch

__all__ = [
    "SUPPLEMENT_CUTOFF",
    "BatchOutcome",
    "Collision",
    "Column",
    "ColumnOutcome",
    "ColumnPath",
    "Cutoff",
    "Event",
    "ImpulseCurve",
    "Outcome",
    "solve",
    "solve_batch",
    "solve_column",
    "solve_columns",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = "columns.solving" if "column" in name else "solving"
    return getattr(import_module(f"{__name__}.{module}"), name)
