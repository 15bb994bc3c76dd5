"""Contact graphs: bodies of any kind that meet at once, in exact event-driven motion (docs/graphs.md).

- `solving`: `solve_graph` and `solve_graphs` solve graphs given by a Delassus matrix. `collision`: `GraphCollision`,
  given by bodies and contacts. `named`: graphs by name. `outcome`: the model's results. `collision_outcome`: the result
  of any solver.
- `law`: the watched functions and the events of a contact. `motion`: the motion between events, and the start rule.
  `event`: the certified first event. `rigid`: contacts that are rigid. `grazing`: the distance from a jump.
- `kernel`: follows graphs to their ends. `state`: the record of a contact, and its energies. `record`: types that cross
  the kernel's boundary.
- `in_time`: graphs whose contacts have a depth.

From `model.chain` this package takes the order, the length and the evaluation of power series (`chain.series`), the
certified first root of a polynomial (`chain.roots`), turning points (`chain.grazing`), and the shares of energy below
which a contact counts as rigid (`chain.rigid`).
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from impact_xval.model.graph.collision import (
        BodyContact,
        GraphCollision,
        Plane,
        touching_balls,
    )
    from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
    from impact_xval.model.graph.named import GRAPHS, bernoulli, box, bridge, corner, graph_of_balls, rack
    from impact_xval.model.graph.outcome import ContactEvent, GraphOutcome, GraphOutcomes
    from impact_xval.model.graph.solving import solve_graph, solve_graph_collision, solve_graphs

__all__ = [
    "GRAPHS",
    "BodyContact",
    "ContactEvent",
    "GraphCollision",
    "GraphCollisionOutcome",
    "GraphOutcome",
    "GraphOutcomes",
    "Plane",
    "bernoulli",
    "box",
    "bridge",
    "corner",
    "graph_of_balls",
    "rack",
    "solve_graph",
    "solve_graph_collision",
    "solve_graphs",
    "touching_balls",
]

#: Module of each name above. Modules are imported at first use, because importing the compiler takes a while.
_MODULES = {
    "collision": ("BodyContact", "GraphCollision", "Plane", "touching_balls"),
    "collision_outcome": ("GraphCollisionOutcome",),
    "named": ("GRAPHS", "bernoulli", "box", "bridge", "corner", "graph_of_balls", "rack"),
    "outcome": ("ContactEvent", "GraphOutcome", "GraphOutcomes"),
    "solving": ("solve_graph", "solve_graph_collision", "solve_graphs"),
}


def __getattr__(name: str) -> object:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
