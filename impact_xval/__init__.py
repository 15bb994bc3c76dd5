"""Cross-validation of physics engines against the state-transition model of simultaneous impacts.

The three folders beside this package are its floors, reached through it: `impact_xval.experiments` imports
`impact_xval.compliant_baselines`, which imports `impact_xval.model`.
"""

from impact_xval.compliant_baselines import get_solver
from impact_xval.model import Collision, solve, solve_batch

__all__ = ["Collision", "get_solver", "solve", "solve_batch"]
