"""The primary solver: the state transition model of simultaneous impacts (Jia, Mason and Erdmann, IJRR 32(1), 2013).

`Collision` and `Outcome` are the vocabulary; `solve` answers one collision, `solve_batch` arrays of them.
"""

from impact_xval.model.batch import BatchOutcome, solve_batch
from impact_xval.model.collision import (
    Collision,
    Event,
    Outcome,
    Path,
)
from impact_xval.model.inputs import SUPPLEMENT_CUTOFF, Cutoff
from impact_xval.model.solver import solve

__all__ = [
    "SUPPLEMENT_CUTOFF",
    "BatchOutcome",
    "Collision",
    "Cutoff",
    "Event",
    "Outcome",
    "Path",
    "solve",
    "solve_batch",
]
