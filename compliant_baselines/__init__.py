"""Solvers that are compared with the state-transition model, and the base class that every solver derives from."""

from impact_xval.compliant_baselines.registry import get_solver, solver_names
from impact_xval.compliant_baselines.solver import Settings, Solver, SolverError

__all__ = ["Settings", "Solver", "SolverError", "get_solver", "solver_names"]
