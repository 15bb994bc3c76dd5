"""The primary solver: the state transition model of simultaneous impacts (Jia, Mason and Erdmann, IJRR 32(1), 2013).

`Collision` and `Outcome` are the vocabulary; `solve` answers one collision, `solve_batch` arrays of them.
"""

from impact_xval.model.collision import (
    Collision,
    Event,
    ImpulseCurve,
    Outcome,
)
from impact_xval.model.inputs import SUPPLEMENT_CUTOFF, Cutoff
from impact_xval.model.solve import BatchOutcome, solve, solve_batch

__all__ = [
    "SUPPLEMENT_CUTOFF",
    "BatchOutcome",
    "Collision",
    "Cutoff",
    "Event",
    "ImpulseCurve",
    "Outcome",
    "solve",
    "solve_batch",
]
