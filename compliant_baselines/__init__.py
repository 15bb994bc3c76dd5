"""The compliant solvers the model is compared with, and the contract every solver keeps."""

from impact_xval.compliant_baselines.registry import get_solver, solver_names
from impact_xval.compliant_baselines.solver import Settings, Solver, SolverError

__all__ = ["Settings", "Solver", "SolverError", "get_solver", "solver_names"]
