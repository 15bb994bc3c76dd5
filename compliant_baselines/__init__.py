"""The compliant solvers the model is compared with, and the contract every solver keeps."""

from compliant_baselines.contract import Settings, Solver, SolverError
from compliant_baselines.registry import get_solver, solver_names

__all__ = ["Settings", "Solver", "SolverError", "get_solver", "solver_names"]
