"""Cross-validation of physics engines against the state-transition model of simultaneous impacts.

This package has the names that a notebook needs. They are imported at first use, so that the command starts quickly.
The three folders beside this package are its layers: `impact_xval.experiments` imports
`impact_xval.compliant_baselines`, which imports `impact_xval.model`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from impact_xval.errors import ImpactXvalError

if TYPE_CHECKING:
    from impact_xval.compliant_baselines import get_solver
    from impact_xval.experiments.cells.compared import compare
    from impact_xval.model import (
        Collision,
        Collisions,
        GridOutcomes,
        Outcome,
        Outcomes,
        Path,
        solve,
        solve_batch,
    )

__all__ = [
    "Collision",
    "Collisions",
    "GridOutcomes",
    "ImpactXvalError",
    "Outcome",
    "Outcomes",
    "Path",
    "compare",
    "get_solver",
    "solve",
    "solve_batch",
]

#: Module of each name that `impact_xval.model` does not have.
_MODULES = {"get_solver": "compliant_baselines", "compare": "experiments.cells.compared"}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("impact-xval")
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES.get(name, 'model')}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
