"""All names that the author of a solver for impact-xval needs to import (docs/adding-a-solver.md).

An adapter of a physics engine derives from `Engine` and makes a `World` for every `Scene`; `examples/toy_engine.py` is
a complete adapter. A solver of another kind derives from `OneByOne`, or from `Solver` if it solves many collisions at
once, and returns an `Outcome` for every `Collision`; `examples/anvil.py` is an example. `checks` returns tests of
whether a solver keeps the contract, which docs/adding-a-solver.md states. `radius_of`, `in_space` and `along_axes` help
an adapter to place balls and to turn coordinates into points in space and back.

These names will stay in this module. The modules behind them may move.
"""

from impact_xval.compliant_baselines.conformance import NonConformingError, checks
from impact_xval.compliant_baselines.engines.arrangement import along_axes, in_space
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Scene, World, radius_of
from impact_xval.compliant_baselines.solver import OneByOne, Settings, Solver, SolverError
from impact_xval.model.collision import Collision
from impact_xval.model.collisions import Collisions
from impact_xval.model.outcome import Outcome
from impact_xval.model.outcomes import Outcomes
from impact_xval.model.path import Path, Paths

__all__ = [
    "Collision",
    "Collisions",
    "Engine",
    "NonConformingError",
    "OneByOne",
    "Outcome",
    "Outcomes",
    "Path",
    "Paths",
    "Scene",
    "Settings",
    "Solver",
    "SolverError",
    "World",
    "along_axes",
    "checks",
    "in_space",
    "radius_of",
]
